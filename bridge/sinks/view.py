"""The Open3D view as a sink: `view:`."""

from __future__ import annotations

from select import select

from bridge.pose import Pose
from bridge.sinks.sink import Sink, SinkClosed, SinkContext, SinkError, ViewError
from bridge.view.live import show
from bridge.view.process import hear, require_display, require_open3d, start, stop
from drivers.url import Url

HANGS = 1.0  # s without reading a pose after which the window hangs


class ViewSink(Sink):
    """A window in a process of its own, which draws the newest of what has come. Closing it ends
    nothing else.
    """

    name = "view"
    one_body = True
    waiting = 12  # so that a busy machine drops none

    def __init__(self, url: Url, context: SinkContext) -> None:
        """Raises ViewError where Open3D, its libraries or a display are missing."""
        url.finish()
        self._truth = context.truth
        self._newest: int | None = None  # index of the last frame
        self._hangs = False
        require_open3d()
        require_display()
        self._process, self._connection = start(show, context.info)

    def __call__(self, pose: Pose) -> None:
        if not self._process.is_alive():
            raise self._ended()
        # Never into a pipe that is full: nobody knows how long that would take. One that is
        # writable has room for far more than a pose. One that hangs is not waited for again.
        patience = 0.0 if self._hangs else HANGS
        self._hangs = not select([], [self._connection], [], patience)[1]
        if self._hangs:
            raise ViewError("the window hangs; the session goes on without it")
        # A pose comes again where no frame does: what is true by then nobody knows.
        truth = None if pose.index == self._newest else self._truth(pose.index)
        self._newest = pose.index
        try:
            self._connection.send((pose, truth))
        except OSError:  # it ends just now
            raise self._ended() from None

    def _ended(self) -> SinkError:
        """That the process ended, and why: what it said, if anything."""
        try:
            hear(self._process, self._connection)
        except ViewError as error:
            if self._process.exitcode != 0:
                return ViewError(f"{error}; the session goes on without it")
        return SinkClosed("the window was closed; the session goes on without it")

    def close(self) -> None:
        if self._hangs:
            self._process.kill()
        stop(self._process, self._connection)
