"""What sinks share that send all markers by their labels, in coordinates that the user chooses."""

from __future__ import annotations

import numpy as np

from bridge.pose import Pose
from bridge.sinks.engine import EngineSink
from bridge.sinks.sink import SinkContext
from bridge.sinks.trackers import bone_rows
from bridge.uncertainty import Points
from drivers.convention import Convention
from drivers.frame import Floats, Layout
from drivers.url import Url, UrlError
from drivers.wire.osc import LONGEST_LABEL


class MarkerSink(EngineSink):
    """Options: `frame`, `axes`, `unit` and `labels` (THEIRS:OURS), as on the wires in."""

    def __init__(self, url: Url, context: SinkContext) -> None:
        labels = context.info.labels
        self._convention = Convention.take(url, self.profile.frame)
        unknown = [ours for ours in self._convention.labels.values() if ours not in labels]
        if unknown:
            raise _wrong(url, f"the model has no marker {', '.join(unknown)}")
        for name in self._convention.labels:
            if not name.isprintable() or len(name) > LONGEST_LABEL:
                problem = f"a name is at most {LONGEST_LABEL} letters, all of them printable"
                raise _wrong(url, problem)
        try:
            self._layout = self._convention.layout_out(Layout(labels, context.rate))
        except ValueError as error:
            raise _wrong(url, str(error)) from None
        super().__init__(url, context)
        self.wants_posture = self.caution.moves
        self._points = Points(self.caution, bone_rows(labels))

    def _xyz(self, pose: Pose) -> Floats:
        """(M, 3) theirs; NaN where a marker is hidden."""
        found = self._points(pose.t, pose.xyz, pose.sigma, pose.posture)
        xyz = found.xyz
        if not found.shown.all():
            xyz = np.where(found.shown[:, None], xyz, np.float32(np.nan))
        return self._convention.xyz_out(xyz)


def _wrong(url: Url, problem: str) -> UrlError:
    return UrlError(f"'{url.text}': option labels is wrong: {problem}", "labels", problem)
