"""Which of the 41 markers are joined by sticks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_TRUNK = """
    LFHD-RFHD RFHD-RBHD RBHD-LBHD LBHD-LFHD LBHD-C7 RBHD-C7
    C7-LSHO C7-RSHO CLAV-LSHO CLAV-RSHO C7-T10 CLAV-STRN C7-RBAC RBAC-T10
    T10-LBWT T10-RBWT STRN-LFWT STRN-RFWT LFWT-RFWT RFWT-RBWT RBWT-LBWT LBWT-LFWT
"""
_SIDE = """
    SHO-UPA UPA-ELB ELB-FRM FRM-WRA FRM-WRB WRA-WRB WRA-FIN WRB-FIN
    FWT-THI BWT-THI THI-KNE KNE-SHN SHN-ANK ANK-HEE HEE-MT5 MT5-TOE TOE-ANK
"""

STICKS: tuple[tuple[str, str], ...] = (
    *((a, b) for a, b in (stick.split("-") for stick in _TRUNK.split())),
    *((s + a, s + b) for s in "LR" for a, b in (stick.split("-") for stick in _SIDE.split())),
)


def stick_rows(labels: tuple[str, ...]) -> npt.NDArray[np.intp]:
    """(S, 2) rows of the markers at the two ends of each stick that `labels` allow."""
    rows = {label: row for row, label in enumerate(labels)}
    ends = [(rows[a], rows[b]) for a, b in STICKS if a in rows and b in rows]
    return np.array(ends, dtype=np.intp).reshape(-1, 2)
