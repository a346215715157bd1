"""A recording of all poses: `c3d:out.c3d`, written when the session ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bridge.pose import Pose, Provenance
from bridge.sinks.sink import Sink, SinkContext, SinkError
from drivers.c3d_file import write_c3d
from drivers.frame import Floats, Layout
from drivers.url import Url

LONGEST_GAP = 1200  # frames; a larger jump of the index is another take, not lost frames


class C3dSink(Sink):
    """Keeps every pose. Lost markers, and frames that the stream lost, are missing samples."""

    waiting = None

    def __init__(self, url: Url, context: SinkContext) -> None:
        """Raises SinkError where the file could not be written later."""
        self.name = url.text
        self._path = Path(url.file_path())
        url.finish()
        folder = self._path.parent
        try:
            (folder / f".part-{self._path.name}").touch()
            (folder / f".part-{self._path.name}").unlink()
        except OSError as error:
            raise SinkError(f"cannot write {self._path}: {error.strerror}") from error
        self._context = context
        self._frames: list[Floats] = []
        self._last = 0
        self._closed = False

    def __call__(self, pose: Pose) -> None:
        gap = pose.index - self._last - 1
        if self._frames and 0 < gap <= LONGEST_GAP:
            self._frames += [np.full_like(pose.xyz, np.nan)] * gap
        lost = pose.provenance[:, None] == Provenance.LOST
        self._frames.append(np.where(lost, np.nan, pose.xyz))
        self._last = pose.index

    def close(self) -> None:
        """Writes the file, unless there was no pose. Raises OSError where it cannot."""
        if self._frames and not self._closed:
            layout = Layout(self._context.info.labels, self._context.rate)
            write_c3d(self._path, layout, np.stack(self._frames))
        self._closed = True
