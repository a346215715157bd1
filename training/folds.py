"""Who is left out in turn, to see how well a model does on people it has never seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from training.dataset import UNKNOWN, Capture

MAX_FOLDS = 8


@dataclass(frozen=True, slots=True)
class Fold:
    """name: who or what is left out. people: it is performers, else only files. dropped: names of
    the captures that training must not see. scored: the real ones among them, to score the model
    on.
    """

    name: str
    people: bool
    dropped: frozenset[str]
    scored: tuple[Capture, ...]


def leave_out(captures: Sequence[Capture]) -> list[Fold]:
    """Folds that leave performers out, each with every capture, real or not, known to be theirs.

    Only where fewer than two performers are known are files left out instead. At most MAX_FOLDS;
    none for a single file.
    """
    real = [capture for capture in captures if capture.real]
    performers = sorted({capture.subject for capture in real} - {UNKNOWN})
    people = len(performers) > 1
    if people:
        groups = [set(performers[part::MAX_FOLDS]) for part in range(MAX_FOLDS)]
        held = [[one for one in captures if one.subject in group] for group in groups]
        names = [", ".join(sorted(group)) for group in groups]
    elif len(captures) > 1:
        held = [real[part::MAX_FOLDS] for part in range(MAX_FOLDS)]
        names = [", ".join(capture.name for capture in group) for group in held]
    else:
        return []
    return [
        Fold(
            name,
            people,
            frozenset(one.name for one in group),
            tuple(one for one in group if one.real),
        )
        for name, group in zip(names, held, strict=True)
        if group
    ]
