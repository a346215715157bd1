"""Parts of the body by name, and the markers on them: what is hidden together."""

from __future__ import annotations

_ARM = ("UPA", "ELB", "FRM", "WRA", "WRB", "FIN")
_HAND = ("WRA", "WRB", "FIN")
_LEG = ("THI", "KNE", "SHN", "ANK", "HEE", "TOE", "MT5")
_FOOT = ("ANK", "HEE", "TOE", "MT5")


def _on(side: str, names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(side + name for name in names)


BODY_PARTS: dict[str, tuple[str, ...]] = {
    "head": ("LFHD", "RFHD", "LBHD", "RBHD"),
    "trunk": ("C7", "T10", "CLAV", "STRN", "RBAC", "LSHO", "RSHO"),
    "chest": ("CLAV", "STRN"),
    "back": ("C7", "T10", "RBAC", "LBWT", "RBWT"),
    "hips": ("LFWT", "RFWT", "LBWT", "RBWT"),
    "left arm": _on("L", _ARM),
    "right arm": _on("R", _ARM),
    "left hand": _on("L", _HAND),
    "right hand": _on("R", _HAND),
    "left leg": _on("L", _LEG),
    "right leg": _on("R", _LEG),
    "left foot": _on("L", _FOOT),
    "right foot": _on("R", _FOOT),
}
