"""`train --alone`: models of those who wear no C7, by networks and by local models."""

import hashlib

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.pose import Provenance
from drivers.c3d_file import read_c3d
from drivers.errors import UsageError
from drivers.frame import Layout, MarkerFrame
from drivers.marker_set import MARKERS
from tests.training.small_models import networks_recipe
from training.network import NetworkOptions
from training.recipe import RECIPES
from training.train_command import main

FOUR = "LWRB,RWRB,LANK,RANK"
TRACKED = (*FOUR.split(","), "LSHO", "RSHO")
AT = [MARKERS.index(label) for label in TRACKED]
SMALL = networks_recipe(NetworkOptions(hidden=(32,), steps=150, batch=128))


@pytest.fixture(scope="module", params=["best", "local"])
def alone(request, small_dir, tmp_path_factory):
    """A model without C7, written by the command."""
    out = tmp_path_factory.mktemp("alone") / "model.onnx"
    argv = [str(small_dir), "--out", str(out), "--estimator", request.param, "--alone"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(RECIPES, "best", SMALL)
        assert main([*argv, "--principal", FOUR, "--no-folds"]) == 0
    return Model(out)


@pytest.fixture(scope="module")
def walk(small_dir):
    """Frames of a capture that is not trained on, with all markers."""
    xyz = read_c3d(small_dir / "real/07_12.c3d", MARKERS).xyz[10:170]
    assert not np.isnan(xyz).any()
    return xyz


def poses(model, tracked):
    """Of tracked markers (N, 6, 3), which are all that the stream carries."""
    estimator, layout = PoseEstimator(model), Layout(TRACKED, 120.0)
    return [
        estimator.step(MarkerFrame(index, index / 120, index / 120, layout, xyz))
        for index, xyz in enumerate(tracked)
    ]


def positions(model, tracked):
    return np.array([pose.xyz for pose in poses(model, tracked)])


def rms_mm(found, truth):
    return 1000 * np.sqrt(((found - truth) ** 2).sum(axis=-1).mean(axis=-1)).mean()


def test_the_model_file_says_what_is_worn(alone):
    info = alone.info
    assert info.body_frame == "six"
    assert info.references == ("LSHO", "RSHO")
    assert info.tracked == info.features == TRACKED
    assert "C7" in info.unworn
    assert len(info.unworn) == 35
    assert alone.width == 18
    # Midway between the shoulders is the origin, and x is their line.
    left, right = info.mean[-2:]
    np.testing.assert_allclose(left, -np.array(right), atol=1e-6)
    assert left[0] < -0.1
    assert abs(left[1]) < 1e-6


def test_six_markers_make_a_whole_body(alone, walk):
    found = poses(alone, walk[:, AT])
    for pose in found:
        assert np.isfinite(pose.xyz).all()
        assert np.isfinite(pose.sigma).all()
        assert (pose.provenance[AT] == Provenance.MEASURED).all()
        assert (np.delete(pose.provenance, AT) == Provenance.ESTIMATED).all()
    xyz = np.array([pose.xyz for pose in found])
    error = rms_mm(xyz, walk)
    # A body that stands still in its mean pose where the shoulders say is far worse.
    middle = walk[:, AT[-2:]].mean(axis=1, keepdims=True)
    stiff = rms_mm(middle + (walk - middle).mean(axis=0), walk)
    assert 5 < error < 0.8 * stiff
    assert error < 120


def test_where_somebody_walks_does_not_change_the_walk(alone, walk):
    cos, sin = np.cos(2.2), np.sin(2.2)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    shift = np.array([3.0, -1.0, 0.2])
    here = positions(alone, walk[:, AT])
    there = positions(alone, (walk[:, AT] @ turn + shift).astype(np.float32))
    np.testing.assert_allclose(there, here @ turn + shift, atol=2e-3)


@pytest.mark.parametrize("lost", [("LSHO",), ("LSHO", "RSHO"), ("RANK",)])
def test_markers_missing_for_long_are_guessed_with_the_rest(alone, walk, lost):
    holed = walk[:, AT].copy()
    rows = [TRACKED.index(label) for label in lost]
    holed[30:, rows] = np.nan
    found = poses(alone, holed)
    at = [MARKERS.index(label) for label in lost]
    for index, pose in enumerate(found):
        expected = Provenance.MEASURED if index < 30 else Provenance.IMPUTED
        assert (pose.provenance[at] == expected).all()
        assert np.isfinite(pose.xyz).all()
    assert (found[-1].sigma[at] > found[0].sigma[at]).all()
    assert rms_mm(np.array([pose.xyz for pose in found]), walk) < 250


def test_shoulders_that_were_never_seen(alone, walk):
    """The mean of the training poses stands in: the pose is whole, and near."""
    holed = walk[:, AT].copy()
    holed[:, -2:] = np.nan
    assert rms_mm(positions(alone, holed), walk) < 400


def test_without_a_wish_the_markers_are_chosen_in_that_frame(small_dir, tmp_path, monkeypatch):
    monkeypatch.setitem(RECIPES, "best", SMALL)
    out = tmp_path / "m.onnx"
    argv = [str(small_dir), "--out", str(out), "--alone", "--estimator", "best", "--no-folds"]
    assert main(argv) == 0
    info = Model(out).info
    assert len(info.tracked) == 6
    assert info.references == ("LSHO", "RSHO")
    assert not {*info.principal} & {*info.references}


def test_same_seed_same_networks(small_dir, tmp_path, monkeypatch):
    few = NetworkOptions(hidden=(8,), steps=10, batch=32)
    monkeypatch.setitem(RECIPES, "best", networks_recipe(few))
    digests = []
    for name, seed in (("a", "0"), ("b", "0"), ("c", "1")):
        out = tmp_path / f"{name}.onnx"
        argv = [str(small_dir), "--out", str(out), "--alone", "--estimator", "best", "--no-folds"]
        assert main([*argv, "--principal", FOUR, "--seed", seed]) == 0
        digests.append(hashlib.sha256(out.read_bytes()).hexdigest())
    assert digests[0] == digests[1] != digests[2]


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["--alone", "--principal", "LSHO,LWRB"], "--principal: LSHO are references"),
        (["--estimator", "best", "--history", "3"], "--history: `best` has none"),
    ],
)
def test_wrong_usage(small_dir, tmp_path, argv, told):
    with pytest.raises(UsageError, match=told):
        main([str(small_dir), "--out", str(tmp_path / "m.onnx"), *argv])


def test_c7_may_be_principal(small_dir, tmp_path):
    """It is a marker like any other there."""
    out = tmp_path / "m.onnx"
    argv = [str(small_dir), "--out", str(out), "--alone", "--principal", "C7,LTOE", "--no-folds"]
    assert main(argv) == 0
    assert Model(out).info.features == ("C7", "LTOE", "LSHO", "RSHO")
