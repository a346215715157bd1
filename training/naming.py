"""Who performed a capture, from the file's name alone, as two databases write it."""

from __future__ import annotations

import re
from pathlib import PurePosixPath

_NAMES = (
    re.compile(r"(\d{2,3})_\d{2,3}\.c3d", re.IGNORECASE),  # CMU: subject_trial
    re.compile(r"HDM_([a-z]{2})_.+\.c3d", re.IGNORECASE),  # HDM05: performer, then what is in it
)


def subject_of(file: str) -> str | None:
    """The performer of `02/02_01.c3d` (CMU: "02") or `HDM_bd_05-01_01.c3d` (HDM05: "bd").

    None for any other name. The name may have folders before it, with slashes.
    """
    name = PurePosixPath(file).name
    for pattern in _NAMES:
        if match := pattern.fullmatch(name):
            return match[1].lower()
    return None
