"""Training of the networks: for all markers, for their velocities, and for markers that lack."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed

from bridge.body_frame import CONSTRUCTIONS, Construction
from bridge.model import ModelInfo
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.corpus import Corpus
from training.examples import Examples, Poses
from training.fitting import Fitted
from training.local_models import affine
from training.moments import columns_of, matrix, mean_and_covariance, mirrored_moments
from training.network import Adam, Gradient, Network, NetworkOptions
from training.networks import (
    POSE,
    STEP,
    UNIT,
    Networks,
    PoseNetwork,
    RecallNetwork,
    VelocityNetwork,
    faded,
    share,
)
from training.recipe import NetworkRecipe
from training.workers import single_threaded

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Next = Callable[[], tuple[Floats, Gradient]]  # inputs (n, D), and the gradient at their outputs

_SPREAD = 0.03  # m: the sigma that training begins with
_SURPRISE = 9.0  # squared error over variance: what is more counts as much
_PRIOR_BATCHES = 40
_RIDGE = 1e-6  # of the mean power of what a linear prior is fitted to: what holds it back
_SOON = 0.01  # of the share of the network: where its errors count no more than here
_SIGMA_SHARE = 0.1  # of the gradient: the markers come first


def fit_network(
    corpus: Corpus,
    segments: Indices,
    principal: tuple[str, ...],
    recipe: NetworkRecipe,
    seed: int,
) -> Fitted:
    """The networks that these segments of the corpus give."""
    construction = CONSTRUCTIONS[recipe.body_frame]
    tracked = (*principal, *construction.references)
    networks = fit_networks(_poses(corpus, segments), tracked, construction, recipe, seed)
    moments = corpus.moments[segments].sum(axis=0)
    features = construction.features(tracked)
    mean, covariance = mean_and_covariance(
        matrix(moments + mirrored_moments(moments)), columns_of(features)
    )
    unworn = tuple(label for label in MARKERS if label not in tracked)
    rows = np.repeat([3 * tracked.index(label) for label in features], 3)
    rows += np.tile(np.arange(3), len(features))
    # Of the prior, what an error of a feature moves, metres of metres.
    sensitivity = networks.pose.prior[rows][:, columns_of(unworn)].T / UNIT
    info = ModelInfo(
        estimator="best",
        labels=MARKERS,
        principal=principal,
        references=construction.references,
        history=0,
        mean=mean.reshape(-1, 3).tolist(),
        covariance=covariance.tolist(),
        sigma=[0.0] * len(unworn),
        sensitivity=sensitivity.astype(float).round(6).tolist(),
        body_frame=recipe.body_frame,
    )
    return Fitted(networks, info)


def _poses(corpus: Corpus, segments: Indices) -> Poses:
    used = np.isin(corpus.segment, segments)
    capture = corpus.capture[corpus.segment[used]]
    real = np.array([one.real for one in corpus.captures])[capture]
    return Poses(
        poses=corpus.poses[used],
        velocities=corpus.velocities[used],
        origin=corpus.origin[used],
        yaw=corpus.yaw[used],
        capture=capture,
        seconds=corpus.time[used],
        real=real,
    )


def fit_networks(
    poses: Poses,
    tracked: tuple[str, ...],
    construction: Construction,
    recipe: NetworkRecipe,
    seed: int,
) -> Networks:
    """The three networks for these tracked markers."""
    pose, velocity, recall = Parallel()(
        delayed(fit)(poses, tracked, construction, recipe, seed)
        for fit in (_fit_pose, _fit_velocity, _fit_recall)
    )
    return Networks(pose, velocity, recall)


@single_threaded
def _fit_pose(
    poses: Poses,
    tracked: tuple[str, ...],
    construction: Construction,
    recipe: NetworkRecipe,
    seed: int,
) -> PoseNetwork:
    examples, random = _examples(poses, tracked, construction, recipe, [seed, 0])
    inputs, count = 3 * len(tracked), recipe.pose.batch
    network = Network.random((inputs, *recipe.pose.hidden, POSE + len(MARKERS)), random)
    network.weights[-1][POSE:] = np.log(_SPREAD)
    empty = PoseNetwork(examples.mean.ravel(), np.zeros((inputs + 1, POSE), np.float32), network)
    equations = _LeastSquares()
    for _ in range(_PRIOR_BATCHES):
        batch = examples.whole(count)
        equations.add(affine(empty.inputs(batch.tracked)), batch.poses.reshape(count, -1))
    found = PoseNetwork(empty.mean, equations.solution(), network)
    wanted = np.array([label not in tracked for label in MARKERS], np.float32)[None]

    def following() -> tuple[Floats, Gradient]:
        batch = examples.whole(count)
        u = found.inputs(batch.tracked)
        target = batch.poses.reshape(count, -1) - found.linear(u)
        return u, _Loss(target, np.broadcast_to(wanted, (count, len(MARKERS))))

    _train(network, following, recipe.pose, random)
    return found


@single_threaded
def _fit_velocity(
    poses: Poses,
    tracked: tuple[str, ...],
    construction: Construction,
    recipe: NetworkRecipe,
    seed: int,
) -> VelocityNetwork:
    examples, random = _examples(poses, tracked, construction, recipe, [seed, 1])
    width, count = 3 * len(tracked), recipe.velocity.batch
    network = Network.random((2 * width, *recipe.velocity.hidden, POSE), random)
    empty = VelocityNetwork(examples.mean.ravel(), np.zeros((width, POSE), np.float32), network)
    rows = np.array([MARKERS.index(label) for label in tracked])

    def drawn(model: VelocityNetwork) -> tuple[Floats, Floats, Floats]:
        """Inputs, all velocities (n, 123) in the body's speed, and that speed (n, 1)."""
        batch = examples.whole(count)
        inputs, speed = model.inputs(batch.tracked, batch.velocities[:, rows])
        slip = random.standard_normal((count, width), dtype=np.float32)
        inputs[:, width:] += np.float32(recipe.examples.slip) * slip
        return inputs, batch.velocities.reshape(count, -1) / speed, speed

    # Errors count as far as they move the body: fast motions more, though not by the square.
    equations = _LeastSquares()
    speeds = []
    for _ in range(_PRIOR_BATCHES):
        inputs, wanted, speed = drawn(empty)
        equations.add(inputs[:, width:] * np.sqrt(speed), wanted * np.sqrt(speed))
        speeds.append(speed.mean())
    usual = np.float32(np.mean(speeds) * count)
    found = VelocityNetwork(empty.mean, equations.solution(), network)

    def following() -> tuple[Floats, Gradient]:
        inputs, wanted, speed = drawn(found)
        target = wanted - inputs[:, width:] @ found.prior
        weight = speed / usual
        return inputs, lambda outputs: (outputs - target) * weight

    _train(network, following, recipe.velocity, random)
    return found


@single_threaded
def _fit_recall(
    poses: Poses,
    tracked: tuple[str, ...],
    construction: Construction,
    recipe: NetworkRecipe,
    seed: int,
) -> RecallNetwork:
    examples, random = _examples(poses, tracked, construction, recipe, [seed, 2])
    count, width = recipe.recall.batch, 3 * len(tracked)
    empty = RecallNetwork(examples.mean.ravel(), np.zeros(0, np.float32), Network([]))
    equations = _LeastSquares()
    for _ in range(_PRIOR_BATCHES):
        batch, true = examples.missing(4 * count)
        inputs = empty.inputs(batch)
        off = true.reshape(4 * count, -1) - empty.begin(batch)
        weight = 1.0 / np.sqrt(share(batch.age) + np.float32(_SOON))
        equations.add(faded(inputs, batch.age) * weight, off * weight)
    sizes = (inputs.shape[1], *recipe.recall.hidden, width + len(tracked))
    network = Network.random(sizes, random)
    network.weights[-1][width:] = np.log(_SPREAD)
    found = RecallNetwork(empty.mean, equations.solution(), network)

    def following() -> tuple[Floats, Gradient]:
        batch, true = examples.missing(count)
        inputs = found.inputs(batch)
        known = found.begin(batch) + found.linear(inputs, batch.age)
        target = true.reshape(count, -1) - known
        return inputs, _Loss(target, 1.0 - batch.present, share(batch.age))

    _train(network, following, recipe.recall, random)
    return found


def _examples(
    poses: Poses,
    tracked: tuple[str, ...],
    construction: Construction,
    recipe: NetworkRecipe,
    seed: list[int],
) -> tuple[Examples, np.random.Generator]:
    """What a network is trained on, and the chance that is its own."""
    random = np.random.default_rng([*seed, 0])
    examples = Examples(poses, tracked, construction, recipe.examples, random)
    return examples, np.random.default_rng([*seed, 1])


def _train(
    network: Network, following: Next, options: NetworkOptions, random: np.random.Generator
) -> None:
    """Changes the network in place."""
    optimiser = Adam(network.weights, options.steps, options.rate)
    for _ in range(options.steps):
        inputs, gradient = following()
        optimiser.step(network.gradients(inputs, gradient, options.dropout, random))


class _LeastSquares:
    """The linear map from rows to targets: the noise of the examples holds it back."""

    def __init__(self) -> None:
        self._square: Array = np.zeros((1, 1))
        self._product: Array = np.zeros((1, 1))

    def add(self, rows: Floats, targets: Floats) -> None:
        """rows (n, D), targets (n, O)."""
        self._square = self._square + rows.T.astype(float) @ rows
        self._product = self._product + rows.T.astype(float) @ targets

    def solution(self) -> Floats:
        """(D, O)."""
        square, product = self._square, self._product
        ridge = _RIDGE * np.trace(square) / len(square) * np.eye(len(square))
        found: Floats = np.linalg.solve(square + ridge, product).astype(np.float32)
        return found


class _Loss:
    """Half the squared error of the markers wanted, and how unlikely it is by sigma.

    target: (n, 3W) metres, to which STEP * the first outputs, times their share (n, 1), come;
    errors count the more, the smaller the share, as little is off there. wanted: (n, W). The other
    W outputs, logarithms of sigma, learn by `_SIGMA_SHARE`.
    """

    def __init__(self, target: Floats, wanted: Floats, share: Floats | None = None) -> None:
        self._target = target / np.float32(STEP)
        self._wanted = wanted
        self._share = np.ones((len(target), 1), np.float32) if share is None else share

    def __call__(self, outputs: Floats) -> Floats:
        count, width = np.float32(len(outputs)), self._target.shape[1]
        error = self._share * outputs[:, :width] - self._target
        squared = (error**2).reshape(len(error), -1, 3).mean(axis=2) * np.float32(STEP**2)
        gradient = np.empty_like(outputs)
        wanted = np.repeat(self._wanted, 3, axis=1)
        gradient[:, :width] = error * wanted / count
        surprise = np.minimum(squared * np.exp(-2.0 * outputs[:, width:]), _SURPRISE)
        gradient[:, width:] = np.float32(_SIGMA_SHARE) * self._wanted * (1.0 - surprise) / count
        return gradient
