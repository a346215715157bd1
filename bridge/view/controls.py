"""What the viewer has chosen, and the keys that choose it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bridge.view.camera import DEFAULT, VIEWPOINTS
from bridge.view.player import LivePlayer, Player


@dataclass(slots=True)
class Look:
    """How things are drawn. view: a name of VIEWPOINTS. follow: the camera goes and turns with the
    body. over: the true body is not beside the estimate but in its place. bones: the humanoid in
    place of the sticks between markers. trail: where hips and feet went. sigma: a marker is the
    larger the less sure it is. help: the keys are told.
    """

    view: str = DEFAULT
    follow: bool = True
    over: bool = False
    bones: bool = False
    trail: bool = True
    sigma: bool = True
    help: bool = True


class Controls:
    """Look and player, as the keys say. wants_picture, recording, closed: what else was asked."""

    def __init__(self, look: Look, player: Player) -> None:
        self.look = look
        self.player = player
        self.wants_picture = False
        self.recording = False
        self.closed = False
        self._keys = {code: key for key in keys_of(player) for code in key.codes}

    def press(self, code: int) -> None:
        """A key is down, by its code in GLFW. One that means nothing does nothing."""
        if code in self._keys:
            self._keys[code].act(self)


@dataclass(frozen=True, slots=True)
class Key:
    """codes: GLFW's, which are those of the places on a US keyboard. name, does: for the help."""

    codes: tuple[int, ...]
    name: str
    does: str
    act: Callable[[Controls], None]
    for_recordings: bool = False


def keys_of(player: Player) -> list[Key]:
    """Those that mean something there."""
    live = isinstance(player, LivePlayer)
    return [key for key in KEYS if not (live and key.for_recordings)]


def _switch(name: str) -> Callable[[Controls], None]:
    def act(controls: Controls) -> None:
        setattr(controls.look, name, not getattr(controls.look, name))

    return act


def _see(view: str) -> Callable[[Controls], None]:
    def act(controls: Controls) -> None:
        controls.look.view = view

    return act


def _take_picture(controls: Controls) -> None:
    controls.wants_picture = True


def _record(controls: Controls) -> None:
    controls.recording = not controls.recording


def _close(controls: Controls) -> None:
    controls.closed = True


_RIGHT, _LEFT, _DOWN, _UP, _PAGE_UP, _PAGE_DOWN, _HOME, _END = range(262, 270)
_ESCAPE = 256

KEYS: tuple[Key, ...] = (
    Key((ord(" "),), "Space", "pause", lambda c: c.player.toggle()),
    Key((_RIGHT,), "→", "step", lambda c: c.player.step(1)),
    Key((_LEFT,), "←", "back", lambda c: c.player.step(-1)),
    Key((_UP,), "↑", "+1 sec", lambda c: c.player.jump(1.0), True),
    Key((_DOWN,), "↓", "-1 sec", lambda c: c.player.jump(-1.0), True),
    Key((_PAGE_UP,), "PgUp", "+10 sec", lambda c: c.player.jump(10.0), True),
    Key((_PAGE_DOWN,), "PgDn", "-10 sec", lambda c: c.player.jump(-10.0), True),
    Key((_HOME,), "Home", "start", lambda c: c.player.seek(0.0), True),
    Key((_END,), "End", "end", lambda c: c.player.seek(c.player.length), True),
    Key((ord("."),), ">", "faster", lambda c: c.player.faster(1), True),
    Key((ord(","),), "<", "slower", lambda c: c.player.faster(-1), True),
    *(
        Key((ord(str(number)),), str(number), name, _see(name))
        for number, name in enumerate(VIEWPOINTS, 1)
    ),
    Key((ord("F"),), "F", "follow", _switch("follow")),
    Key((ord("O"),), "O", "truth over", _switch("over")),
    Key((ord("B"),), "B", "bones", _switch("bones")),
    Key((ord("T"),), "T", "trail", _switch("trail")),
    Key((ord("U"),), "U", "sigma", _switch("sigma")),
    Key((ord("S"),), "S", "picture", _take_picture),
    Key((ord("R"),), "R", "record", _record),
    Key((ord("H"),), "H", "help", _switch("help")),
    Key((ord("Q"), _ESCAPE), "Q", "close", _close),
)
