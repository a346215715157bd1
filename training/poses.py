"""Captures as poses in the body frame (paper section 4.1): what everything is trained on."""

from __future__ import annotations

import numpy as np

from bridge.body_frame import PAPER_FRAME, BodyFrame, Construction
from drivers.frame import Floats
from drivers.marker_set import MARKERS


def body_poses(xyz: Floats, construction: Construction = PAPER_FRAME) -> Floats:
    """The complete frames of one take, (N, 41, 3) metres in the world, in the body frame.

    Frames that lack any marker are left out: a model learns from whole poses.
    """
    body = BodyFrame(MARKERS, construction=construction)
    poses = np.empty_like(xyz)
    for index, frame in enumerate(xyz):
        body.update(frame)
        poses[index] = body.to_body(frame)
    complete: Floats = poses[~np.isnan(poses).any(axis=(1, 2))]
    return complete
