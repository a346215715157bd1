"""How often the forest names the wrong leaf (paper 4.2), on poses that it has not been grown on.

The paper does not say which were held out. Poses between those of training are all but their
copies; whole segments are new motion, if the leaf's only segment is among them it cannot be named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from training.fitting import Rows
from training.forest import ForestOptions, grow_forest

HELD = 0.2  # share held out


@dataclass(frozen=True, slots=True)
class ForestError:
    """Shares of wrong answers. frames: on poses held out at random. segments: on all poses of
    segments held out at random. segments_known: of these, only where the leaf has other segments;
    None where there is none.
    """

    frames: float
    segments: float
    segments_known: float | None


def forest_error(rows: Rows, options: ForestOptions, seed: int) -> ForestError | None:
    """Measures both, with a forest each. A pose's mirror image is held out with it.

    None where there is only one segment.
    """
    random = np.random.default_rng(seed)
    segments = np.unique(rows.segment)
    if len(segments) < 2:
        return None
    poses = np.unique(rows.pose)
    frames, _ = _wrong(rows, np.isin(rows.pose, _some(poses, random)), options, seed)
    wrong, known = _wrong(rows, np.isin(rows.segment, _some(segments, random)), options, seed)
    return ForestError(
        float(frames.mean()),
        float(wrong.mean()),
        float(wrong[known].mean()) if known.any() else None,
    )


def _some(numbers: npt.NDArray[np.int64], random: np.random.Generator) -> npt.NDArray[np.int64]:
    return random.choice(numbers, max(1, round(HELD * len(numbers))), replace=False)


def _wrong(
    rows: Rows, held: npt.NDArray[np.bool_], options: ForestOptions, seed: int
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Of each row held out: whether its leaf is named wrongly; whether others have that leaf."""
    known = np.unique(rows.leaf[~held])
    votes = np.zeros((held.sum(), len(known)))
    for part in grow_forest(rows.x[~held], rows.leaf[~held], options, seed):
        votes += len(part.estimators_) * part.predict_proba(rows.x[held])
    wrong = known[votes.argmax(axis=1)] != rows.leaf[held]
    return wrong, np.isin(rows.leaf[held], known)
