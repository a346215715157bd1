"""What may be chosen in training but the data, the markers and the seed; three sets of choices."""

from __future__ import annotations

from dataclasses import dataclass, field

from bridge.body_frame import PAPER_FRAME
from training.examples import ExampleOptions
from training.forest import ForestOptions
from training.network import NetworkOptions
from training.segmentation import Segmentation


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """How to read captures, whatever is trained on them.

    body_frame: the name of its construction. pose_step: seconds between the poses that are kept,
    neighbours being all but equal. pose_rows: about how many poses are kept at most, mirror images
    apart, which bounds memory and the size of a forest; of more captures, fewer of each are kept.
    """

    segmentation: Segmentation = field(default_factory=Segmentation)
    body_frame: str = PAPER_FRAME.name
    pose_step: float = 1 / 30
    pose_rows: int = 50_000


@dataclass(frozen=True, slots=True, kw_only=True)
class MixtureRecipe(Recipe):
    """How to train local models and their mixture. Which values, and why:
    docs/decisions/0011-local-estimator.md.

    plain: the method as the paper has it (maps of the principal markers alone, without a constant,
    and the forest's vote); else affine maps of all tracked markers, held back by `share` and
    `noise` (see `local_models.shrunk`), and the forest's probabilities. mirror: each segment is
    learned the other way round as well. covariance_weight: w of the segment features. tolerance:
    see `DivisiveKMeans`. noise: metres. history: frames of 1/120 s.
    """

    plain: bool
    mirror: bool
    forest: ForestOptions
    covariance_weight: float = 0.5
    tolerance: float = 0.6
    share: float = 0.03
    noise: float = 0.01
    history: int = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkRecipe(Recipe):
    """How to train a network on top of a linear prior. Which values, and why:
    docs/decisions/0016-network.md.

    pose, velocity, recall: each network's, see `training.networks`.
    """

    pose: NetworkOptions = field(default_factory=lambda: NetworkOptions(hidden=(320, 320, 320)))
    velocity: NetworkOptions = field(
        default_factory=lambda: NetworkOptions(hidden=(160, 160, 160), steps=3000)
    )
    recall: NetworkOptions = field(default_factory=NetworkOptions)
    examples: ExampleOptions = field(default_factory=ExampleOptions)


RECIPES: dict[str, MixtureRecipe | NetworkRecipe] = {
    "best": NetworkRecipe(pose_rows=200_000),
    "local": MixtureRecipe(plain=False, mirror=True, forest=ForestOptions(trees=50, leaf=10)),
    # Maps that nothing holds back need large leaves. The paper's forest is grown on all frames.
    "paper": MixtureRecipe(
        plain=True,
        mirror=False,
        forest=ForestOptions(trees=50, leaf=1),
        tolerance=1.6,
        pose_step=1 / 120,
        pose_rows=200_000,
    ),
}
