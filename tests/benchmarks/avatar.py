"""Draws what an engine shows: `python -m tests.benchmarks.avatar PICTURE CLIP@FRAME ...`.

Of each capture the markers at that frame (left ones blue, right ones red), and beside them an
avatar that is moved over the VMC protocol by what the default model estimates from the markers
that it tracks.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from bridge.estimator import PoseEstimator
from bridge.humanoid.solver import HumanoidSolver
from bridge.model import Model
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkContext
from drivers.c3d_file import C3dSource, Clip, read_c3d
from drivers.clock import VirtualClock
from drivers.frame import Layout
from tests.receivers.programs import Avatar, avatar

BEFORE = 240  # frames that the estimator has seen before


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path)
    parser.add_argument("moments", nargs="+", metavar="CLIP@FRAME")
    options = parser.parse_args()
    drawn = []
    with avatar("markers") as page:
        for moment in options.moments:
            path, _, frame = moment.rpartition("@")
            drawn.append(draw(page, Path(path), int(frame)))
    strip = Image.fromarray(np.concatenate(drawn, axis=1))
    strip.save(options.picture, optimize=True)


def draw(page: Avatar, path: Path, frame: int) -> np.ndarray:
    """(height, width, 3): the avatar at a frame of a capture, its markers beside it."""
    model = Model("default")
    info = model.info
    clip = read_c3d(path, info.labels)
    first = max(0, frame - BEFORE)
    rows = [info.labels.index(label) for label in info.tracked]
    worn = Clip(path, Layout(info.tracked, clip.layout.rate), clip.xyz[first : frame + 1, rows])
    estimator, solver = PoseEstimator(model), HumanoidSolver(info)
    for seen in C3dSource("clip", worn, VirtualClock()):
        pose = estimator.step(seen)
        pose = replace(pose, posture=solver.solve(pose))
    hips = page.drawn(0).rest["hips"][1]
    context = SinkContext(info, lambda index: None)
    sink = open_sink(f"vmc://127.0.0.1:{page.port}?hips={hips}m", context)
    sink(replace(pose, xyz=clip.xyz[frame]))
    sink.close()
    return page.drawn(1).picture


if __name__ == "__main__":
    main()
