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
from bridge.view.process import READY, start, stop
from bridge.view.scene import Scene
from drivers.frame import Floats

WIDTH, HEIGHT = 1280, 720
FINER = 2  # drawn so much larger and averaged: smooth edges


def snapshot(path: Path, info: ModelInfo, pose: Pose, truth: Floats | None) -> None:
    """Writes the view of a pose, with the true one (M, 3) where it is known, as a PNG.

    The file appears whole or not at all. Raises SinkError where it cannot be drawn or written.
    """
    if path.suffix.lower() != ".png":
        raise SinkError(f"{path}: a picture's name ends in .png")
    if not path.parent.is_dir():
        raise SinkError(f"cannot write {path}: no such folder")
    part = path.with_name(f".part-{path.name}")
    arguments = (str(part), info.labels, info.principal, pose, truth)
    try:
        stop(*start(_draw, *arguments))
        part.replace(path)
    except OSError as error:
        raise SinkError(f"cannot write {path}: {error.strerror}") from error
    finally:
        part.unlink(missing_ok=True)


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
