"""The Open3D view as a sink: `view:`."""

from __future__ import annotations

from select import select

from bridge.pose import Pose
from bridge.sinks.sink import Sink, SinkContext, ViewError
from bridge.view.live import show
from bridge.view.process import hear, require_display, require_open3d, start, stop
from drivers.url import Url

HANGS = 1.0  # s without reading a pose after which the window hangs


class ViewSink(Sink):
    """A window in a process of its own; the newest pose wins. Closing it ends nothing else."""

    waiting = 1

    def __init__(self, url: Url, context: SinkContext) -> None:
        """Raises ViewError where Open3D, its libraries or a display are missing."""
        url.finish()
        self.name = url.text
        self._truth = context.truth
        self._hangs = False
        require_open3d()
        require_display()
        self._process, self._connection = start(show, context.info)

    def __call__(self, pose: Pose) -> None:
        if not self._process.is_alive():
            raise ViewError(f"{self._reason()}; the session goes on without it")
        # Never into a pipe that is full: nobody knows how long that would take. One that is
        # writable has room for far more than a pose.
        self._hangs = not select([], [self._connection], [], HANGS)[1]
        if self._hangs:
            raise ViewError("the window hangs; the session goes on without it")
        self._connection.send((pose, self._truth(pose.index)))

    def _reason(self) -> str:
        """Why the process ended: what it said, if anything."""
        try:
            hear(self._process, self._connection)
        except ViewError as error:
            return str(error)
        return "it ended"

    def close(self) -> None:
        if self._hangs:
            self._process.kill()
        stop(self._process, self._connection)
