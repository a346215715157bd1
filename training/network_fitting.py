"""Training of the network that estimates all markers from those present."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed

from bridge.body_frame import CONSTRUCTIONS, Construction
from bridge.model import ModelInfo
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.corpus import Corpus
from training.examples import Examples
from training.fitting import Fitted
from training.moments import columns_of, matrix, mean_and_covariance, mirrored_moments
from training.network import Adam, Network
from training.recipe import NetworkRecipe
from training.regressor import POSE, STEP, Networks, Regressor
from training.workers import single_threaded

Indices = npt.NDArray[np.int64]

_SPREAD = 0.03  # m: the sigma that training begins with
_SURPRISE = 9.0  # squared error over variance: what is more counts as much
_PRIOR_BATCHES = 40
WHOLE = 0.1  # of the examples of the network for frames that lack markers
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
    features = columns_of(construction.features(tracked))
    used = np.isin(corpus.segment, segments)
    capture = corpus.capture[corpus.segment[used]]
    real = np.array([one.real for one in corpus.captures])[capture]
    whole, part = Parallel()(
        delayed(train_regressor)(
            corpus.poses[used], capture, real, tracked, construction, recipe, seed, share
        )
        for share in (1.0, WHOLE)
    )
    moments = corpus.moments[segments].sum(axis=0)
    mean, covariance = mean_and_covariance(matrix(moments + mirrored_moments(moments)), features)
    info = ModelInfo(
        estimator="best",
        labels=MARKERS,
        principal=principal,
        references=construction.references,
        history=0,
        mean=mean.reshape(-1, 3).tolist(),
        covariance=covariance.tolist(),
        sigma=[0.0] * (len(MARKERS) - len(tracked)),
        sensitivity=[],
        body_frame=recipe.body_frame,
    )
    return Fitted(Networks(whole, part), info)


@single_threaded
def train_regressor(
    poses: Floats,
    capture: Indices,
    real: npt.NDArray[np.bool_],
    tracked: tuple[str, ...],
    construction: Construction,
    recipe: NetworkRecipe,
    seed: int,
    whole: float,
) -> Regressor:
    """Learns from poses (N, 41, 3), metres, in the body frame.

    capture: (N,), which of them are of one capture, in order. real: (N,), which are of real ones;
    whole: the share of examples that lack no marker.
    """

    def examples(number: int) -> Examples:
        random = np.random.default_rng([seed, number])
        return Examples(poses, capture, real, tracked, construction, recipe.examples, whole, random)

    features = construction.features(tracked)
    rows = np.repeat([tracked.index(label) for label in features], 3)
    mean = poses[:, [MARKERS.index(label) for label in features]].mean(axis=0).ravel()
    skip = np.zeros((len(rows) + len(tracked) + 1, POSE), np.float32)
    untrained = Regressor(mean, rows, skip, recipe.share)
    prior = _linear_prior(untrained, examples(recipe.members), recipe.network.batch)
    regressor = replace(untrained, skip=prior)
    members = (
        _train_member(regressor, examples(number), recipe, [seed, number])
        for number in range(recipe.members)
    )
    return replace(regressor, members=tuple(members))


def _train_member(
    regressor: Regressor, examples: Examples, recipe: NetworkRecipe, seed: list[int]
) -> Network:
    options, random = recipe.network, np.random.default_rng([*seed, 1])
    inputs, outputs = len(regressor.skip) - 1, POSE + len(MARKERS)
    network = Network.random((inputs, *options.hidden, outputs), random)
    network.weights[-1][POSE:] = np.log(_SPREAD)
    optimiser = Adam(network.weights, options.steps, options.rate)
    for _ in range(options.steps):
        batch = examples.draw(options.batch)
        u = regressor.inputs(batch.features, batch.present)
        target = batch.poses.reshape(len(u), -1) - regressor.prior(u)
        gradient = _Loss(target, batch.wanted)
        optimiser.step(network.gradients(u, gradient, options.dropout, random))
    return network


def _linear_prior(regressor: Regressor, examples: Examples, count: int) -> Floats:
    """Least squares: the noise of the examples holds it back."""
    square = np.zeros((len(regressor.skip),) * 2)
    product = np.zeros(regressor.skip.shape)
    for _ in range(_PRIOR_BATCHES):
        batch = examples.draw(count)
        u = regressor.inputs(batch.features, batch.present)
        affine = np.hstack([u, np.ones((len(u), 1), np.float32)]).astype(float)
        square += affine.T @ affine
        product += affine.T @ batch.poses.reshape(len(u), -1)
    found: Floats = np.linalg.lstsq(square, product)[0].astype(np.float32)
    return found


class _Loss:
    """Half the squared error of the markers wanted, and how unlikely it is by sigma.

    The second trains the last layer's share in sigma alone: see `_SIGMA_SHARE`.
    """

    def __init__(self, target: Floats, wanted: Floats) -> None:
        self._target = target / np.float32(STEP)
        self._wanted = wanted

    def __call__(self, outputs: Floats) -> Floats:
        count = np.float32(len(outputs))
        error = outputs[:, :POSE] - self._target
        squared = (error**2).reshape(len(error), -1, 3).mean(axis=2) * np.float32(STEP**2)
        gradient = np.empty_like(outputs)
        gradient[:, :POSE] = error * np.repeat(self._wanted, 3, axis=1) / count
        surprise = np.minimum(squared * np.exp(-2.0 * outputs[:, POSE:]), _SURPRISE)
        gradient[:, POSE:] = np.float32(_SIGMA_SHARE) * self._wanted * (1.0 - surprise) / count
        return gradient
