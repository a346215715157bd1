"""What may be chosen in training but the data, the markers and the seed; two sets of choices."""

from __future__ import annotations

from dataclasses import dataclass, field

from training.forest import ForestOptions
from training.segmentation import Segmentation


@dataclass(frozen=True, slots=True)
class Recipe:
    """How to train. Which values, and why: docs/decisions/0011-local-estimator.md.

    plain: the method as the paper has it (maps of the principal markers alone, without a constant,
    and the forest's vote); else affine maps of all tracked markers, held back by `share` and
    `noise` (see `local_models.shrunk`), and the forest's probabilities. mirror: each segment is
    learned the other way round as well. covariance_weight: w of the segment features. tolerance:
    see `DivisiveKMeans`. forest_step: seconds between the frames that the forest is trained on,
    neighbours being all but equal. forest_rows: about how many frames that is at most, mirror
    images apart, which bounds the size of the model; of more captures, fewer of each are taken.
    noise: metres. history: frames of 1/120 s.
    """

    plain: bool
    mirror: bool
    forest: ForestOptions
    segmentation: Segmentation = field(default_factory=Segmentation)
    covariance_weight: float = 0.5
    tolerance: float = 0.6
    forest_step: float = 1 / 30
    forest_rows: int = 50_000
    share: float = 0.03
    noise: float = 0.01
    history: int = 10


RECIPES = {
    "local": Recipe(plain=False, mirror=True, forest=ForestOptions(trees=50, leaf=10)),
    # Maps that nothing holds back need large leaves. The paper's forest is grown on all frames.
    "paper": Recipe(
        plain=True,
        mirror=False,
        forest=ForestOptions(trees=50, leaf=1),
        tolerance=1.6,
        forest_step=1 / 120,
        forest_rows=200_000,
    ),
}
