"""Pictures of the view without a display."""

from __future__ import annotations

from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from bridge.model import ModelInfo
from bridge.pose import Pose
from bridge.sinks.sink import SinkError
from bridge.view.camera import SIZE
from bridge.view.controls import Look
from bridge.view.player import Moment, Player
from bridge.view.process import READY, hear, require_open3d, start, stop
from bridge.view.scene import Worn
from drivers.frame import Floats

FINER = 2  # drawn so much larger and averaged: smooth edges


class Film(NamedTuple):
    """What to take of a recording: from `at` on, seconds from its beginning. pictures: how many,
    at so many a second; one: a PNG. size: pixels.
    """

    path: Path
    at: float = 0.0
    pictures: int = 1
    fps: float = 20.0
    size: tuple[int, int] = SIZE


def snapshot(path: Path, info: ModelInfo, pose: Pose, truth: Floats | None) -> None:
    """Writes the view of a pose, with the true one (M, 3) where it is known, as a PNG.

    The file appears whole or not at all. Raises SinkError where it cannot be drawn or written.
    """
    check_picture(path, (".png",))
    film(Film(path), info, Worn.of(info), Player([Moment(pose, truth)]), Look(help=False))


def film(
    order: Film,
    info: ModelInfo,
    worn: Worn,
    player: Player,
    look: Look,
    progress: Callable[[int], None] = lambda number: None,
) -> None:
    """Writes a picture or an animation of what a player shows, whole or not at all.

    progress: told how many are drawn. Raises SinkError where it cannot be drawn or written.
    """
    process, connection = start(_shoot, order, info, worn, player, look)
    try:
        for _ in range(order.pictures):
            progress(hear(process, connection))
        hear(process, connection)
    finally:
        stop(process, connection)


def check_picture(path: Path, endings: tuple[str, ...]) -> None:
    """Raises SinkError where `film` could not draw, or not write there."""
    if path.suffix.lower() not in endings:
        raise SinkError(f"{path}: its name has to end in {' or '.join(endings)}")
    if not path.parent.is_dir():
        raise SinkError(f"cannot write {path}: no such folder")
    require_open3d()


def _shoot(
    connection: Connection, order: Film, info: ModelInfo, worn: Worn, player: Player, look: Look
) -> None:
    from bridge.view.pictures import Animation, save_picture
    from bridge.view.viewer import Viewer

    viewer = Viewer(info, worn, player, look, size=order.size, visible=False, finer=FINER)
    connection.send(READY)
    animation = Animation()
    for number in range(order.pictures):
        player.seek(order.at + number / order.fps * player.speed)
        viewer.draw()
        if order.pictures > 1:
            animation.add(viewer.picture(), number / order.fps)
        connection.send(number + 1)
    if order.pictures > 1:
        animation.save(order.path)
    else:
        save_picture(order.path, viewer.picture())
    connection.send(READY)
    viewer.close()
