"""The model that ships: its size, its accuracy, and the runtime against plain numpy."""

import json
from importlib.resources import files

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from drivers.frame import Layout, MarkerFrame
from drivers.marker_set import MARKERS
from training.dataset import load
from training.evaluation import evaluate, report
from training.nearest_neighbour import NearestNeighbour
from training.poses import body_poses
from training.reference import ReferenceModel, ReferenceNetworks

MODELS = files("bridge") / "models"


@pytest.fixture(scope="module")
def model():
    return Model("default")


@pytest.fixture(scope="module")
def tests(data_dir):
    return load(data_dir, "test", print)


class InNumpy:
    """What the estimator needs of a model, with the reference doing the work."""

    def __init__(self, model, path):
        self.info, self.leaves, self.width = model.info, model.leaves, model.width
        self._reference = (ReferenceModel if model.leaves else ReferenceNetworks)(path)

    def networks(self, count):
        return self

    def estimate(self, tracked, velocity):
        frames = zip(tracked, velocity, strict=True)
        return [self._reference.estimate(*frame) for frame in frames]

    def recall(self, tracked, present, memory):
        return self._reference.recall(tracked, present, memory)

    def mixture(self, history):
        return MixtureInNumpy(self._reference, self.width, history)


class MixtureInNumpy:
    """As `bridge.model.BoundMixture`, with the reference doing the work."""

    def __init__(self, reference, width, history):
        self._reference, self.history = reference, history
        self.x = np.zeros((1, width), np.float32)

    def run(self):
        self.z, self.p = self._reference.run(self.x, self.history)


def poses(model, take, measured):
    estimator = PoseEstimator(model)
    layout = Layout(model.info.tracked, take.rate)
    return np.array(
        [
            estimator.step(MarkerFrame(i, i / take.rate, i / take.rate, layout, xyz)).xyz
            for i, xyz in enumerate(measured)
        ]
    )


def test_it_is_small_and_says_who_it_is(model):
    assert len((MODELS / "default.onnx").read_bytes()) < 20_000_000
    assert model.info.estimator == "best"


def test_it_says_what_reports_tell_of_its_training(model):
    """Who is known to it, and how it was made."""
    training = model.info.training
    assert {"02", "07", "16", "85", "bd"} <= set(training["performers"])
    assert "unknown" not in training["performers"]
    assert training["recipe"]["pose"]["steps"] >= 1000
    assert model.info.accuracy["folds"]["people"]


def test_its_record_is_that_of_this_file(model):
    record = json.loads((MODELS / "default.json").read_text())
    assert record["training"] == model.info.training
    assert record["accuracy"] == model.info.accuracy
    assert record["file"]["bytes"] == len((MODELS / "default.onnx").read_bytes())


@pytest.mark.parametrize("missing", ["none", "some", "all"])
@pytest.mark.parametrize("kind", ["default", "mixture"])
def test_the_runtime_agrees_with_plain_numpy_on_every_test_frame(
    model, mixture_model, tests, kind, missing
):
    model = model if kind == "default" else mixture_model
    path = MODELS / "default.onnx" if kind == "default" else mixture_model.path
    random = np.random.default_rng(0)
    tracked = [MARKERS.index(label) for label in model.info.tracked]
    for take in tests:
        measured = take.xyz[:, tracked].copy()
        if missing == "some":
            measured[random.random(measured.shape[:2]) < 0.3] = np.nan
        if missing == "all":  # for half a second, each second
            measured[np.arange(len(measured)) % 120 < 60] = np.nan
        found = poses(model, take, measured)
        np.testing.assert_allclose(found, poses(InNumpy(model, path), take, measured), atol=1e-4)


def test_its_accuracy_is_what_it_says_and_beats_the_nearest_neighbour(model, tests, train_takes):
    train = [body_poses(take.xyz) for take in train_takes]
    results = evaluate(model, tests, baseline=NearestNeighbour(np.concatenate(train), model.info))
    mean = report(results, model.info)["mean"]
    said = model.info.accuracy["test"]
    assert {name: mean[name] for name in said} == pytest.approx(said, abs=0.02)
    assert mean["rms_ratio"] <= 0.52
    assert mean["jerk_ratio"] <= 0.18
