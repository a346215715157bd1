"""The Open3D view as a sink: `view:`."""

from __future__ import annotations

from bridge.pose import Pose
from bridge.sinks.sink import Sink, SinkContext, ViewError
from bridge.view.live import show
from bridge.view.process import has_display, require_open3d, start, stop
from drivers.url import Url


class ViewSink(Sink):
    """A window in a process of its own; the newest pose wins. Closing it ends nothing else."""

    waiting = 1

    def __init__(self, url: Url, context: SinkContext) -> None:
        """Raises ViewError where Open3D, its libraries or a display are missing."""
        url.finish()
        self.name = url.text
        self._truth = context.truth
        info = context.info
        require_open3d()
        if not has_display():
            raise ViewError("no view: no display here (DISPLAY is not set, or nobody answers)")
        self._process, self._connection = start(show, info.labels, info.principal)

    def __call__(self, pose: Pose) -> None:
        if not self._process.is_alive():
            raise ViewError(f"{self._reason()}; the session goes on without it")
        self._connection.send((pose, self._truth(pose.index)))

    def _reason(self) -> str:
        """Why the process ended: what it said, if anything."""
        try:
            return str(self._connection.recv()) if self._connection.poll() else "it ended"
        except (EOFError, OSError):
            return "the window is closed"

    def close(self) -> None:
        stop(self._process, self._connection)
