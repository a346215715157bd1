"""Captures as poses in the body frame (paper section 4.1): what everything is trained on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bridge.body_frame import PAPER_FRAME, BodyFrame, Construction
from drivers.frame import Floats
from drivers.marker_set import MARKERS


def body_poses(xyz: Floats, construction: Construction = PAPER_FRAME) -> Floats:
    """The complete frames of one take, (N, 41, 3) metres in the world, in the body frame.

    Frames that lack any marker are left out: a model learns from whole poses.
    """
    return moving_poses(xyz, 1.0, construction).poses


@dataclass(frozen=True, slots=True, eq=False)
class MovingPoses:
    """Complete frames of one take, n of them. frame: (n,), their numbers in the take. poses:
    (n, 41, 3) metres, in the body frame. velocities: (n, 41, 3) m/s, in the world since the frame
    before, told in the body's axes. origin: (n, 3) metres and yaw: (n,), the body frame in the
    world.
    """

    frame: npt.NDArray[np.int64]
    poses: Floats
    velocities: Floats
    origin: npt.NDArray[np.float64]
    yaw: npt.NDArray[np.float64]


def moving_poses(xyz: Floats, rate: float, construction: Construction) -> MovingPoses:
    """The complete frames of a take (N, 41, 3) in the world, at `rate` Hz."""
    body = BodyFrame(MARKERS, construction=construction)
    poses = np.empty_like(xyz)
    velocities = np.empty_like(xyz)
    origin, yaw = np.empty((len(xyz), 3)), np.empty(len(xyz))
    steps = np.diff(xyz, axis=0, prepend=np.full_like(xyz[:1], np.nan)) * np.float32(rate)
    for index, frame in enumerate(xyz):
        body.update(frame)
        poses[index] = body.to_body(frame)
        velocities[index] = steps[index] @ body.rotation
        origin[index], yaw[index] = body.origin, body.yaw
    frames = np.flatnonzero(~np.isnan(poses).any(axis=(1, 2)))
    # After a frame that lacks markers, and at first, the velocity is that of the next step; where
    # that is not known either, the body is at rest.
    following = np.minimum(frames + 1, len(xyz) - 1)
    unknown = np.isnan(velocities[frames]).any(axis=(1, 2), keepdims=True)
    moving = np.where(unknown, velocities[following], velocities[frames])
    moving[np.isnan(moving).any(axis=(1, 2))] = 0.0
    return MovingPoses(frames, poses[frames], moving, origin[frames], yaw[frames])
