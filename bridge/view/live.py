"""The view's window, in its own process: draws the newest pose until it is closed."""

from __future__ import annotations

import os
from multiprocessing.connection import Connection
from pathlib import Path

from bridge.pose import Pose
from bridge.view.process import READY
from bridge.view.scene import Scene
from bridge.view.window import Window
from drivers.frame import Floats

SIZE = (1280, 720)
IDLE = 1 / 60  # s between looks at the mouse while no pose comes

Drawn = tuple[Pose, Floats | None]  # a pose, and the true one where it is known


def show(connection: Connection, labels: tuple[str, ...], principal: tuple[str, ...]) -> None:
    """Draws what comes over the connection; ends with the window or the connection."""
    if not Path("/dev/dri").exists():
        # No graphics card: smooth edges take Mesa 50 ms a frame instead of 16, on every core.
        os.environ.setdefault("DRI_NO_MSAA", "1")
    window = Window(Scene(labels, principal), SIZE, visible=True)
    connection.send(READY)
    is_open = True
    while is_open:
        drawn: Drawn | None = None
        if connection.poll(IDLE):
            drawn = connection.recv()
            while connection.poll():  # the newest wins
                drawn = connection.recv()
        is_open = window.draw(*drawn) if drawn else window.refresh()
    window.close()
