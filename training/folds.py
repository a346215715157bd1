"""Who is left out in turn, to see how well a model does on people it has never seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from training.dataset import UNKNOWN, Take

MAX_FOLDS = 8


@dataclass(frozen=True, slots=True)
class Fold:
    """name: who or what is left out. dropped: names of the takes that training must not see.
    scored: real captures among them, to score the model on.
    """

    name: str
    dropped: frozenset[str]
    scored: tuple[Take, ...]


def leave_out(takes: Sequence[Take]) -> list[Fold]:
    """Folds that leave performers out, each with every take, real or not, known to be theirs.

    Only where fewer than two performers are known are files left out instead. At most MAX_FOLDS;
    none for a single file.
    """
    real = [take for take in takes if take.real]
    performers = sorted({take.subject for take in real} - {UNKNOWN})
    if len(performers) > 1:
        groups = [set(performers[part::MAX_FOLDS]) for part in range(MAX_FOLDS)]
        held = [[take for take in takes if take.subject in group] for group in groups]
        names = [", ".join(sorted(group)) for group in groups]
    elif len(takes) > 1:
        held = [real[part::MAX_FOLDS] for part in range(MAX_FOLDS)]
        names = [", ".join(take.name for take in group) for group in held]
    else:
        return []
    return [
        Fold(name, frozenset(take.name for take in group), tuple(t for t in group if t.real))
        for name, group in zip(names, held, strict=True)
        if group
    ]
