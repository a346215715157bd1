"""Every marker as Qualisys Track Manager sends it: `qtm-osc://127.0.0.1:7400`, in millimetres.

A bundle per frame, `/qtm/data` and `/qtm/3d/<label>` f f f, as in drivers/wire/osc_qtm.py. It is
never split: two bundles would be two frames of one number. A marker that is lost or hidden is NaN.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bridge.pose import Pose
from bridge.sinks.engine import Profile
from bridge.sinks.markers import MarkerSink
from bridge.sinks.sink import SinkContext
from drivers.coordinates import FRAMES
from drivers.url import Url, UrlError
from drivers.wire.osc_qtm import FRAME, QtmEncoder


class QtmOscSink(MarkerSink):
    """All markers for Max, TouchDesigner, TASCAR and whatever reads QTM."""

    profile = Profile(None, 0.0, FRAMES[FRAME])

    def __init__(self, url: Url, context: SinkContext) -> None:
        super().__init__(url, context)
        self._encoder = QtmEncoder()
        try:
            self._encoder.encode_layout(self._layout)
        except ValueError as error:
            self.close()
            raise UrlError(f"'{url.text}': {error}") from None

    def _datagrams(self, pose: Pose) -> Iterable[bytes]:
        xyz = self._xyz(pose)
        if not self._is_known(pose):
            xyz = np.full_like(xyz, np.nan)
        return (self._encoder.encode_frame(pose.index, self._seconds(pose), xyz),)
