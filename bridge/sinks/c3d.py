"""A recording of all poses: `c3d:out.c3d`, written when the session ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bridge.pose import Pose, Provenance
from bridge.sinks.sink import Sink, SinkContext, SinkError
from drivers.c3d_file import MAX_FRAMES, write_c3d
from drivers.files import numbered, of_performer
from drivers.frame import Floats, Layout
from drivers.url import Url

LONGEST_GAP = 1200  # frames; a larger jump of the index is another take, not lost frames


def lost_between(last: int, index: int) -> int:
    """Frames that never came between two indices: none where it is another take."""
    gap = index - last - 1
    return gap if 0 < gap <= LONGEST_GAP else 0


class C3dSink(Sink):
    """Keeps every pose. Lost markers, and frames that the stream lost, are missing samples.

    A C3D file ends at 65,535 frames, nine minutes at 120 Hz: then it is written, and a longer take
    goes on in `out-2.c3d`.
    """

    waiting = None

    def __init__(self, url: Url, context: SinkContext) -> None:
        """Raises SinkError where the file could not be written later."""
        self.name = url.text
        self._path = of_performer(Path(url.file_path()), context.performer)
        url.finish()
        if self._path.is_dir():
            raise SinkError(f"cannot write {self._path}: it is a folder")
        probe = self._path.with_name(f".part-{self._path.name}")
        try:
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise SinkError(f"cannot write {self._path}: {error.strerror}") from error
        self._context = context
        self._frames: list[Floats] = []
        self._last = 0
        self._files = 0

    def __call__(self, pose: Pose) -> None:
        if self._frames:
            for _ in range(lost_between(self._last, pose.index)):
                self._keep(np.full_like(pose.xyz, np.nan))
        lost = pose.provenance[:, None] == Provenance.LOST
        self._keep(np.where(lost, np.nan, pose.xyz))
        self._last = pose.index

    def close(self) -> None:
        """Writes what was kept, unless there is nothing. Raises OSError where it cannot."""
        if not self._frames:
            return
        path = numbered(self._path, self._files + 1)
        layout = Layout(self._context.info.labels, self._context.rate)
        write_c3d(path, layout, np.stack(self._frames))
        self._files += 1
        self._frames = []

    def _keep(self, xyz: Floats) -> None:
        self._frames.append(xyz)
        if len(self._frames) == MAX_FRAMES:
            self.close()
