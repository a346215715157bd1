"""The view's window, in its own process: draws the newest pose until it is closed."""

from __future__ import annotations

import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from bridge.model import ModelInfo
from bridge.view.controls import Look
from bridge.view.player import LivePlayer, Moment, Player
from bridge.view.process import READY
from bridge.view.scene import Worn

if TYPE_CHECKING:
    from bridge.view.viewer import Viewer

FRAME = 1 / 60  # s from one picture to the next


def show(connection: Connection, info: ModelInfo) -> None:
    """Draws the moments that come over the connection; ends with the window or the connection."""
    from bridge.view.viewer import Viewer

    player = LivePlayer()
    viewer = Viewer(info, Worn.of(info), player)
    connection.send(READY)

    def take(seconds: float) -> None:
        while connection.poll():
            player.add(Moment(*connection.recv()))

    _run(viewer, take)


def replay(connection: Connection, info: ModelInfo, worn: Worn, player: Player, look: Look) -> None:
    """Plays a recording until the window is closed, or the connection."""
    from bridge.view.viewer import Viewer

    viewer = Viewer(info, worn, player, look)
    connection.send(READY)

    def take(seconds: float) -> None:
        if connection.poll():
            connection.recv()  # EOFError: nobody wants it any more
        player.advance(seconds)

    _run(viewer, take)


def _run(viewer: Viewer, take: Callable[[float], None]) -> None:
    """Draws picture by picture, at most 60 a second. take: told how long ago it was called."""
    last = due = time.monotonic()
    try:
        while viewer.draw():
            due = max(due + FRAME, time.monotonic() - FRAME)
            time.sleep(max(0.0, due - time.monotonic()))
            now = time.monotonic()
            take(now - last)
            last = now
    finally:
        viewer.close()
