"""A picture of the view, without a display."""

from __future__ import annotations

import os
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from bridge.model import ModelInfo
from bridge.pose import Pose
from bridge.sinks.sink import SinkError
from bridge.view.process import READY, require_open3d, start, stop
from bridge.view.scene import Scene
from drivers.files import whole_file
from drivers.frame import Floats

WIDTH, HEIGHT = 1280, 720
FINER = 2  # drawn so much larger and averaged: smooth edges


def snapshot(path: Path, info: ModelInfo, pose: Pose, truth: Floats | None) -> None:
    """Writes the view of a pose, with the true one (M, 3) where it is known, as a PNG.

    The file appears whole or not at all. Raises SinkError where it cannot be drawn or written.
    """
    check_picture(path)
    try:
        with whole_file(path) as part:
            stop(*start(_draw, str(part), info.labels, info.principal, pose, truth))
    except OSError as error:
        raise SinkError(f"cannot write {path}: {error.strerror}") from error


def check_picture(path: Path) -> None:
    """Raises SinkError where `snapshot` could not draw, or not write there."""
    if path.suffix.lower() != ".png":
        raise SinkError(f"{path}: a picture's name ends in .png")
    if not path.parent.is_dir():
        raise SinkError(f"cannot write {path}: no such folder")
    require_open3d()


def _draw(
    connection: Connection,
    path: str,
    labels: tuple[str, ...],
    principal: tuple[str, ...],
    pose: Pose,
    truth: Floats | None,
) -> None:
    # Where there is a display a hidden window may be smaller than asked for, or empty.
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        os.environ.pop(display, None)
    import open3d

    from bridge.view.window import Window

    window = Window(Scene(labels, principal), (WIDTH * FINER, HEIGHT * FINER), visible=False)
    window.draw(pose, truth)
    fine = window.picture().reshape(HEIGHT, FINER, WIDTH, FINER, 3)
    pixels: Any = (255 * fine.mean(axis=(1, 3))).round().astype(np.uint8)
    if not open3d.io.write_image(Path(path), open3d.geometry.Image(pixels)):
        raise OSError(f"{path} could not be written")
    connection.send(READY)
    window.close()
