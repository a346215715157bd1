"""What is written on the glass: meter, meaning of the colours, keys, where a recording is."""

from __future__ import annotations

import numpy as np

from bridge.pose import Provenance
from bridge.view.camera import VIEWPOINTS, Camera
from bridge.view.colours import (
    CYAN,
    GOLD,
    GREEN,
    GREY,
    ICE,
    ORANGE,
    PALE,
    WHITE,
    Colour,
)
from bridge.view.controls import Controls, keys_of
from bridge.view.lettering import ADVANCE
from bridge.view.player import LivePlayer, Moment, Player
from bridge.view.scene import Worn
from bridge.view.sheet import Sheet

FULL_SCALE = 200.0  # mm: the meter's end

_TRACK: Colour = (0.20, 0.225, 0.27)
_INK: Colour = (0.86, 0.89, 0.93)
_FAINT: Colour = (0.55, 0.59, 0.65)
_RED: Colour = (0.95, 0.25, 0.25)

# Heights of the picture.
_MARGIN = 0.03
_LARGE, _SMALL = 0.034, 0.0165
_LINE = 0.032
_METER, _METER_HALF, _METER_THICK = 0.354, 0.286, 0.025
_NARROW = 1.3  # where there is no room beside the meter
_BAR = 0.012
_MOST = 9999.0  # mm: the largest error that is written

_KINDS = (
    (Provenance.MEASURED, "measured", ICE),
    (Provenance.IMPUTED, "imputed", ORANGE),
    (Provenance.ESTIMATED, "estimated", CYAN),
    (Provenance.LOST, "lost", GREY),
)


class Panel:
    """Writes on a sheet what a moment and the controls have to say.

    worn: whose discs are explained. note: what is said for a while.
    """

    def __init__(self, sheet: Sheet, worn: Worn) -> None:
        self.note = ""
        self._sheet = sheet
        self._discs = [
            (name, colour)
            for labels, name, colour in (
                (worn.principal, "principal", WHITE),
                (worn.references if len(worn.references) > 1 else (), "reference", PALE),
                (worn.origin, "origin", GREEN),
            )
            if labels
        ]

    def update(
        self, moment: Moment | None, error: float | None, controls: Controls, camera: Camera
    ) -> None:
        self._sheet.begin(camera)
        if moment:
            self._legend(moment)
        if error is not None:
            self._meter(error)
        self._state(controls)
        bottom = -0.5 + _MARGIN
        if controls.look.help:
            bottom = self._help(controls.player, bottom)
        if not isinstance(controls.player, LivePlayer) and controls.player.length:
            self._time(controls.player, bottom)
        self._sheet.end(camera)

    def _legend(self, moment: Moment) -> None:
        x = -self._sheet.width / 2 + _MARGIN
        y = (0.5 if self._sheet.width > _NARROW else _METER - 0.06) - _MARGIN - _SMALL
        counts = np.bincount(moment.pose.provenance, minlength=len(_KINDS))
        rows = [(f"{counts[kind]:2} {name}", colour) for kind, name, colour in _KINDS]
        if moment.truth is not None:
            rows.append(("   true", GOLD))
        rows += [(f"   {name}", colour) for name, colour in self._discs]
        for text, colour in rows:
            self._sheet.disc(x + _SMALL / 2, y + _SMALL / 2, 0.6 * _SMALL, colour)
            self._sheet.text(text.upper(), x + 1.9 * _SMALL, y, _SMALL, _FAINT)
            y -= _LINE

    def _meter(self, error: float) -> None:
        """A bar of 200 mm full scale, its figure, and a scale."""
        sheet, half = self._sheet, _METER_THICK / 2
        low, high = _METER - half, _METER + half
        share = min(error / FULL_SCALE, 1.0)
        hue = np.clip([2 * share, 2 - 2 * share, 0.15], 0.15, 0.9)
        sheet.box(-_METER_HALF, low, _METER_HALF, high, _TRACK)
        sheet.box(-_METER_HALF, low, _METER_HALF * (2 * share - 1), high, tuple(hue))
        for place in np.linspace(-_METER_HALF, _METER_HALF, 5):
            sheet.box(place - 0.001, low - 0.008, place + 0.001, low, _INK)
        for place, text in zip((-1, 0, 1), ("0", "100", "200"), strict=True):
            sheet.text(text, place * _METER_HALF, low - 0.036, 0.022, _INK, 0.5)
        sheet.text(f"RMS {min(error, _MOST):.0f} mm", 0.0, high + 0.022, _LARGE, _INK, 0.5)

    def _state(self, controls: Controls) -> None:
        """What is not as usual, at the upper right, and the note in the middle."""
        player, look = controls.player, controls.look
        said: list[tuple[str, Colour]] = []
        if player.moment is None:
            said.append(("WAITING FOR POSES", _INK))
        if controls.recording:
            said.append(("RECORDING", _RED))
        if not player.playing:
            said.append(("END" if player.ended else "PAUSED", _INK))
        if player.speed != 1:
            said.append((f"SPEED {player.speed:g}x", _INK))
        if not look.follow:
            said.append(("CAMERA STANDS", _FAINT))
        y = 0.5 - _MARGIN - _SMALL
        self._sheet.text(self.note.upper(), 0.0, y, _SMALL, _INK, 0.5)
        for text, colour in said:
            self._sheet.text(text, self._sheet.width / 2 - _MARGIN, y, _SMALL, colour, 1.0)
            y -= _LINE

    def _time(self, player: Player, bottom: float) -> None:
        """A bar as long as the recording, and where it is."""
        half = self._sheet.width / 2 - _MARGIN
        share = player.seconds / player.length
        sheet = self._sheet
        sheet.box(-half, bottom, half, bottom + _BAR, _TRACK)
        at = half * (2 * share - 1)
        sheet.box(-half, bottom, at, bottom + _BAR, _INK)
        sheet.box(at - 0.003, bottom - 0.006, at + 0.003, bottom + _BAR + 0.006, WHITE)
        y = bottom + _BAR + 0.016
        sheet.text(f"{player.seconds:.2f} s", -half, y, _SMALL, _INK)
        sheet.text(f"{player.length:.2f} s", half, y, _SMALL, _FAINT, 1.0)

    def _help(self, player: Player, bottom: float) -> float:
        """The keys, in as few lines as there is room for; how high they reach."""
        views = f"1-{len(VIEWPOINTS)}"
        entries = []
        for key in keys_of(player):
            name, does = (views, "views") if key.does in VIEWPOINTS else (key.name, key.does)
            if (name, does) not in entries:
                entries.append((name, does))
        advance = ADVANCE / 6 * _SMALL
        room = int((self._sheet.width - 2 * _MARGIN) / advance)
        lines: list[list[tuple[str, str]]] = [[]]
        used = 0
        for name, does in entries:
            length = len(name) + 1 + len(does) + 2
            if used + length - 2 > room:
                lines.append([])
                used = 0
            lines[-1].append((name, does))
            used += length
        y = bottom + _LINE * (len(lines) - 1)
        for line in lines:
            x = -self._sheet.width / 2 + _MARGIN
            for name, does in line:
                self._sheet.text(name.upper(), x, y, _SMALL, _INK)
                self._sheet.text(does.upper(), x + advance * (len(name) + 1), y, _SMALL, _FAINT)
                x += advance * (len(name) + len(does) + 3)
            y -= _LINE
        return bottom + _LINE * len(lines) + 0.008
