"""The 41 markers of the CMU marker set (Vicon's plug-in set as the CMU lab places it)."""

from __future__ import annotations

_CENTRE = ("LFHD", "RFHD", "LBHD", "RBHD", "C7", "T10", "CLAV", "STRN", "RBAC")
_PAIRED_ARM = ("SHO", "UPA", "ELB", "FRM", "WRA", "WRB", "FIN")
_PAIRED_LEG = ("THI", "KNE", "SHN", "ANK", "HEE", "TOE", "MT5")

MARKERS: tuple[str, ...] = (
    *_CENTRE,
    *(f"L{name}" for name in _PAIRED_ARM),
    *(f"R{name}" for name in _PAIRED_ARM),
    *("LFWT", "RFWT", "LBWT", "RBWT"),
    *(f"L{name}" for name in _PAIRED_LEG),
    *(f"R{name}" for name in _PAIRED_LEG),
)
