import csv

import numpy as np
import pytest
from sklearn.decomposition import PCA

from bridge.body_frame import PAPER_FRAME, SIX_FRAME
from bridge.model import Model
from drivers.marker_set import MARKERS
from tests.training.conftest import PAPER_SIX
from tests.training.test_report_page import check_page
from training.dataset import load_training
from training.network import NetworkOptions
from training.poses import body_poses
from training.recipe import RECIPES, NetworkRecipe
from training.train_command import main


@pytest.fixture(scope="module")
def made(small_dir, tmp_path_factory):
    """The folder of a report, written by the command, and the model it is of."""
    folder = tmp_path_factory.mktemp("report")
    (small_dir / "real/broken.c3d").write_text("no capture")
    manifest = (small_dir / "manifest.csv").read_text()
    first = next(line for line in manifest.splitlines() if line.startswith("real/02_01.c3d"))
    (small_dir / "manifest.csv").write_text(manifest + first.replace("02_01", "broken") + "\n")
    argv = [str(small_dir), "--out", str(folder / "m.onnx"), "--principal", PAPER_SIX]
    try:
        assert main([*argv, "--report", str(folder / "page")]) == 0
    finally:
        (small_dir / "manifest.csv").write_text(manifest)
        (small_dir / "real/broken.c3d").unlink()
    return folder / "page", Model(folder / "m.onnx").info


@pytest.fixture(scope="module")
def takes(small_dir):
    return load_training(small_dir, pytest.fail)


def rows(folder, name):
    with (folder / f"{name}.csv").open(newline="") as file:
        _, *found = csv.reader(file)
    return found


def moving(take, frame=PAPER_FRAME):
    columns = [MARKERS.index(label) for label in frame.features(MARKERS)]
    poses = body_poses(take.xyz, frame)[:, columns]
    return poses.reshape(len(poses), -1).astype(float)


def covered(frames):
    return 100 * np.cumsum(PCA(svd_solver="full").fit(frames).explained_variance_ratio_)


def test_the_page_is_whole_and_says_what_was_trained_on(made, small_dir, takes):
    folder, _ = made
    page = check_page(folder / "index.html")
    assert f"markerbridge train {small_dir.name} --out m.onnx" in page.text
    assert str(small_dir.parent) not in page.text
    ((what, why),) = rows(folder, "left_out")
    assert what == "real/broken.c3d"
    assert "not a readable C3D file" in why
    assert rows(folder, "data") == [
        ["sequences", "4", "132"],
        ["frames", str(sum(len(body_poses(take.xyz)) for take in takes)), "151882"],
        ["performers", "4", "21"],
    ]
    assert [row[:3] for row in rows(folder, "captures")][:2] == [
        ["real/02_01.c3d", "02", "walking"],
        ["real/07_01.c3d", "07", "walking"],
    ]


def test_figure_3_is_scikit_learns_variance_of_all_frames(made, takes):
    found = [float(share) for _, share in rows(made[0], "variance")]
    expected = covered(np.concatenate([moving(take) for take in takes]))
    np.testing.assert_allclose(found, expected[: len(found)], atol=1e-6)


def test_figure_5_is_that_of_each_walk_and_of_all(made, takes):
    walks = [moving(take) for take in takes if "walk" in take.motion]
    found = np.array([[float(cell) for cell in row[1:]] for row in rows(made[0], "walks")])
    centred = np.concatenate([walk - walk.mean(axis=0) for walk in walks])
    expected = [covered(part)[:5] for part in [*walks, np.concatenate(walks), centred]]
    # About own means, scikit-learn's pool and ours weigh captures alike up to 1 / frames.
    np.testing.assert_allclose(found, expected, atol=0.01)
    two = found[: len(walks), 1]
    least, middle, most = map(float, rows(made[0], "walks_summary")[0][1:4])
    assert (least, middle, most) == pytest.approx((two.min(), np.median(two), two.max()))


def test_segments_are_those_that_the_cut_makes(made, takes):
    expected = []
    for take in takes:
        poses = body_poses(take.xyz)
        for part in RECIPES["local"].segmentation.cut(poses.reshape(len(poses), -1), take.rate):
            shares = covered(moving(take)[part])
            dimensions = [str(1 + int((shares < share).sum())) for share in (90, 95)]
            expected.append([take.name, str(part.start), str(part.stop - part.start), *dimensions])
    found = rows(made[0], "segments")
    assert found == expected
    frames = np.array([int(row[2]) for row in found])
    assert [float(row[1]) for row in rows(made[0], "segments_summary")] == pytest.approx(
        [len(frames), frames.mean(), frames.std(), np.median(frames), frames.min(), frames.max()]
    )
    walking = next(row for row in rows(made[0], "dimensions") if row[0] == "walking")
    of_walks = [int(row[4]) for row in found if "real/0" in row[0] or "walking" in row[0]]
    assert [float(cell) for cell in walking[-3:]] == [
        min(of_walks),
        np.median(of_walks),
        max(of_walks),
    ]


def test_every_frame_is_in_a_leaf_and_its_mirror_image_too(made):
    folder, info = made
    found = rows(folder, "leaves")
    assert len(found) == info.training["leaves"]
    assert sum(int(row[1]) for row in found) == info.training["segments"]
    assert sum(int(row[2]) for row in found) == info.training["segments"]
    assert sum(int(row[3]) for row in found) == 2 * info.training["frames"]


def test_errors_are_those_in_the_model_file(made):
    folder, info = made
    wrong = info.training["forest_error"]
    shown = [row[1] for row in rows(folder, "forest_error")]
    for cell, name in zip(shown, ("frames", "segments", "segments_known"), strict=True):
        expected = wrong[name]
        assert cell == "" if expected is None else float(cell) == pytest.approx(100 * expected)
    *folds, mean = rows(folder, "folds")
    assert {row[0]: float(row[1]) for row in folds} == {
        who: scores["rms_mm"] for who, scores in info.accuracy["folds"]["left_out"].items()
    }
    assert float(mean[1]) == info.accuracy["folds"]["mean"]["rms_mm"]


def test_a_folder_without_walks_one_segment_and_no_folds(small_dir, tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data/one.c3d").write_bytes((small_dir / "real/07_01.c3d").read_bytes())
    out = ["--out", str(tmp_path / "m.onnx"), "--principal", PAPER_SIX]
    assert main([str(tmp_path / "data"), *out, "--report", str(tmp_path / "page")]) == 0
    page = check_page(tmp_path / "page/index.html")
    assert "None of the captures is a walk" in page.text
    assert "nothing can be held out" in page.text


def test_of_networks_without_c7(small_dir, tmp_path, monkeypatch, takes):
    """All 41 markers move in their body frame; there are no clusters and no forest."""
    pose = NetworkOptions(hidden=(24, 16), steps=20, batch=32, dropout=0.25, rate=0.002)
    velocity = NetworkOptions(hidden=(8,), steps=10, batch=64, dropout=0.0, rate=0.003)
    recall = NetworkOptions(hidden=(9, 8, 7), steps=15, batch=16, dropout=0.5, rate=0.001)
    recipe = NetworkRecipe(pose=pose, velocity=velocity, recall=recall)
    monkeypatch.setitem(RECIPES, "best", recipe)
    out, folder = tmp_path / "m.onnx", tmp_path / "page"
    argv = [str(small_dir), "--estimator", "best", "--alone", "--no-folds", "--out", str(out)]
    argv += ["--principal", "LWRB,RWRB,LANK,RANK", "--report", str(folder)]
    assert main(argv) == 0
    page = check_page(folder / "index.html")
    assert "--estimator best --alone" in page.text
    assert "41 markers in the body frame" in page.text
    for left in ("Clusters", "Forest"):
        assert left not in page.text
    told = dict(rows(folder, "examples"))
    assert told["tracked markers"] == "LWRB, RWRB, LANK, RANK, LSHO, RSHO"
    told = {what: cells for what, *cells in rows(folder, "networks")}
    assert told["units of the hidden layers"] == ["24, 16", "8", "9, 8, 7"]
    for name, values in (
        ("units left out in training (%)", [25, 0, 50]),
        ("steps of training", [20, 10, 15]),
        ("examples in each", [32, 64, 16]),
        ("highest learning rate", [0.002, 0.003, 0.001]),
    ):
        assert [float(cell) for cell in told[name]] == values
    found = [float(share) for _, share in rows(folder, "variance")]
    expected = covered(np.concatenate([moving(take, SIX_FRAME) for take in takes]))
    np.testing.assert_allclose(found, expected[: len(found)], atol=1e-6)
