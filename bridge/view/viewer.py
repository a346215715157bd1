"""The view as a whole: a window, what is in it, and whoever sits before it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path

from bridge.model import ModelInfo
from bridge.sinks.sink import SinkError
from bridge.view.camera import SIZE, VIEWPOINTS
from bridge.view.colours import BACKGROUND
from bridge.view.controls import Controls, Look
from bridge.view.panel import Panel
from bridge.view.pictures import Animation, Pixels, save_picture, smaller
from bridge.view.player import Player
from bridge.view.scene import Scene, Worn
from bridge.view.sheet import Sheet
from bridge.view.window import Window

NOTE = 4.0  # s that a note stands
ANIMATION_FRAME = 0.05  # s
ANIMATION_HEIGHT = 360
LONGEST = 60.0  # s of an animation


class Viewer:
    """info, worn: of whom. player: what is shown. finer: drawn so much larger and averaged, for
    smooth edges. Pictures and animations that a key asks for go into the current folder.
    """

    def __init__(
        self,
        info: ModelInfo,
        worn: Worn,
        player: Player,
        look: Look | None = None,
        *,
        size: tuple[int, int] = SIZE,
        visible: bool = True,
        finer: int = 1,
    ) -> None:
        self.controls = Controls(look or Look(), player)
        self._scene = Scene(info, worn)
        sheet = Sheet()
        self._panel = Panel(sheet, worn)
        meshes = [self._scene.mesh, sheet.mesh]
        size = (size[0] * finer, size[1] * finer)
        self._window = Window(meshes, BACKGROUND, size, visible, self.controls.press)
        self._finer = finer
        self._view = ""
        self._noted = 0.0
        self._animation: Animation | None = None
        self._began = self._due = 0.0
        self._saving: threading.Thread | None = None

    def draw(self) -> bool:
        """Shows the player's moment as the controls say; False once it was closed."""
        controls, look = self.controls, self.controls.look
        if look.view != self._view:
            viewpoint = VIEWPOINTS[look.view]
            self._window.look(viewpoint.eye, viewpoint.aim)
            self._view = look.view
        if self._panel.note and time.monotonic() > self._noted + NOTE:
            self._panel.note = ""
        camera = self._window.camera
        moment = controls.player.moment
        if moment:
            trail = controls.player.trail() if look.trail else []
            playing = controls.player.playing
            self._scene.update(moment, trail, look, camera, playing=playing)
        self._panel.update(moment, self._scene.error, controls, camera)
        is_open = self._window.draw()
        self._take()
        return is_open and not controls.closed

    def picture(self) -> Pixels:
        """What was drawn last, (height, width, 3)."""
        fine = self._window.picture()
        return smaller(fine, self._finer)

    def close(self) -> None:
        self._end_animation()
        if self._saving:
            self._saving.join()
        self._window.close()

    def _take(self) -> None:
        """Takes the pictures that were asked for."""
        controls, now = self.controls, time.monotonic()
        if controls.wants_picture:
            controls.wants_picture = False
            self._save(".png", partial(save_picture, pixels=self.picture()))
        if controls.recording:
            if not self._animation:
                self._animation, self._began, self._due = Animation(), now, now
            if now >= self._due:
                # What is late is not made up for.
                self._due = max(self._due, now - ANIMATION_FRAME) + ANIMATION_FRAME
                fine = self._window.picture()
                times = max(1, round(len(fine) / ANIMATION_HEIGHT))
                self._animation.add(smaller(fine, times), now - self._began)
            controls.recording = now < self._began + LONGEST
        if not controls.recording:
            self._end_animation()

    def _end_animation(self) -> None:
        if self._animation:
            self._save(".gif", self._animation.save)
            self._animation = None

    def _save(self, ending: str, save: Callable[[Path], None]) -> None:
        """Saves under a name that says when, on a thread of its own: the window goes on."""
        path = Path(f"{datetime.now():markerbridge-%Y-%m-%d-%H.%M.%S}{ending}")

        def work() -> None:
            try:
                save(path)
                self._say(f"saved {path.name}")
            except SinkError as error:
                self._say(str(error))

        if self._saving:
            self._saving.join()  # one after the other
        self._saving = threading.Thread(target=work, name="pictures")
        self._saving.start()

    def _say(self, note: str) -> None:
        self._noted = time.monotonic()
        self._panel.note = note
