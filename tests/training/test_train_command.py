import hashlib
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

from bridge.model import Model
from drivers.c3d_file import read_c3d, write_c3d
from drivers.errors import MarkerbridgeError, UsageError
from tests.training.conftest import PAPER_SIX
from training.dataset import Capture, training_captures
from training.folds import leave_out
from training.train_command import main


@pytest.fixture(scope="module")
def trained(small_dir, tmp_path_factory):
    """A model with folds, trained by the command in a process of its own, and its stderr."""
    out = tmp_path_factory.mktemp("trained") / "model.onnx"
    argv = ["train", str(small_dir), "--out", str(out), "--principal", PAPER_SIX]
    done = subprocess.run(
        [sys.executable, "-m", "bridge.cli", *argv], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return out, done.stderr


def test_the_model_file_says_what_it_is(trained, small_dir):
    info = Model(trained[0]).info
    assert info.principal == tuple(PAPER_SIX.split(","))
    assert info.references == ("C7", "LSHO", "RSHO")
    assert (info.estimator, info.history) == ("local", 10)
    assert info.training["sequences"] == 4
    assert info.training["frames"] == 343 + 316 + 422 + 358  # as captured, without mirror images
    assert info.training["seed"] == 0
    assert info.training["leaves"] == Model(trained[0]).leaves
    assert set(info.training["versions"]) == {"markerbridge", "numpy", "onnx", "scikit-learn"}
    assert len(info.training["data"]) == 64
    assert info.training["performers"] == ["02", "07", "16"]
    assert 0 <= info.training["forest_error"]["frames"] < info.training["forest_error"]["segments"]
    assert set(info.accuracy["folds"]["left_out"]) == {"02", "07", "16"}
    assert info.accuracy["test"]["rms_mm"] > 10


def test_sigma_is_the_error_on_people_left_out(trained):
    """One number per marker; together they make the error of the folds, within the two means."""
    info = Model(trained[0]).info
    total = 1000 * (3 * sum(s**2 for s in info.sigma) / len(info.sigma)) ** 0.5
    assert total == pytest.approx(info.accuracy["folds"]["mean"]["rms_mm"], rel=0.3)
    assert total >= info.accuracy["folds"]["mean"]["rms_mm"]


def test_the_record_beside_it_names_no_path(trained, small_dir):
    out, _ = trained
    text = out.with_suffix(".json").read_text()
    record = json.loads(text)
    assert record["command"].startswith(f"markerbridge train {small_dir.name} --out model.onnx")
    assert record["accuracy"] == Model(out).info.accuracy
    assert record["file"] == {"bytes": out.stat().st_size}
    assert str(small_dir.parent) not in text
    assert str(out.parent) not in text


def test_in_a_pipe_progress_is_plain_lines(trained):
    lines = trained[1].splitlines()
    assert any(line.startswith("100 %") for line in lines)
    assert "\x1b" not in trained[1]
    assert "without 07: RMS" in trained[1]


@pytest.mark.parametrize("estimator", ["local", "paper"])
def test_same_seed_same_file(small_dir, tmp_path, estimator):
    digests = []
    for name, seed in (("a", "0"), ("b", "0"), ("c", "1")):
        out = tmp_path / f"{name}.onnx"
        argv = ["--out", str(out), "--principal", PAPER_SIX, "--no-folds", "--seed", seed]
        assert main([str(small_dir), "--estimator", estimator, *argv]) == 0
        digests.append(hashlib.sha256(out.read_bytes()).hexdigest())
    assert digests[0] == digests[1] != digests[2]


def test_the_plain_estimator_is_the_papers(small_dir, tmp_path):
    out = tmp_path / "paper.onnx"
    argv = ["--out", str(out), "--principal", "LFHD,RTOE", "--no-folds", "--history", "20"]
    assert main([str(small_dir), "--estimator", "paper", *argv]) == 0
    model = Model(out)
    assert model.width == 6  # the principal markers alone
    assert model.info.history == 20
    assert model.info.accuracy["folds"] is None


def test_without_manifest_it_chooses_markers_and_leaves_files_out(small_dir, tmp_path):
    out = tmp_path / "model.onnx"
    assert main([str(small_dir / "real"), "--out", str(out)]) == 0
    info = Model(out).info
    assert info.training["sequences"] == 4  # of a folder without splits, all
    assert set(info.accuracy["folds"]["left_out"]) == {"02", "07", "16"}  # by the files' names
    assert info.accuracy["test"] is None
    assert 3 <= len(info.principal) <= 10
    assert not set(info.principal) & set(info.references)


def test_captures_without_whole_poses_are_left_out_by_name(small_dir, tmp_path, capsys):
    folder = tmp_path / "data"
    folder.mkdir()
    whole = read_c3d(small_dir / "real/02_01.c3d")
    blind = whole.xyz.copy()
    blind[5:, 3] = np.nan
    write_c3d(folder / "blind.c3d", whole.layout, blind)
    out = str(tmp_path / "m.onnx")
    with pytest.raises(MarkerbridgeError, match="no capture has enough frames"):
        main([str(folder), "--out", out, "--principal", PAPER_SIX, "--no-folds"])
    write_c3d(folder / "whole.c3d", whole.layout, whole.xyz)
    assert main([str(folder), "--out", out, "--principal", PAPER_SIX, "--no-folds"]) == 0
    assert "left out: blind.c3d: fewer than 10 frames" in capsys.readouterr().err
    assert Model(out).info.training["sequences"] == 1


def test_a_fold_with_nothing_to_score_is_left_out(small_dir, tmp_path, capsys):
    folder = tmp_path / "data"
    folder.mkdir()
    for name in ("02_01", "07_01", "16_07"):
        shutil.copy(small_dir / f"real/{name}.c3d", folder)
    (folder / "05_01.c3d").write_text("no capture")
    out = tmp_path / "m.onnx"
    assert main([str(folder), "--out", str(out), "--principal", PAPER_SIX]) == 0
    assert "without 05: nothing to score" in capsys.readouterr().err
    folds = Model(out).info.accuracy["folds"]
    assert set(folds["left_out"]) == {"02", "07", "16"}
    assert folds["people"]


def test_folds_of_files_are_not_said_to_be_of_people(small_dir, tmp_path, capsys):
    folder = tmp_path / "data"
    folder.mkdir()
    shutil.copy(small_dir / "real/02_01.c3d", folder / "walk.c3d")
    shutil.copy(small_dir / "real/16_07.c3d", folder / "jump.c3d")
    out = tmp_path / "m.onnx"
    argv = [str(folder), "--out", str(out), "--principal", PAPER_SIX]
    assert main([*argv, "--report", str(tmp_path / "page")]) == 0
    assert "files left out" in capsys.readouterr().err
    assert not Model(out).info.accuracy["folds"]["people"]
    assert "Files left out" in (tmp_path / "page/index.html").read_text()


def test_a_fold_drops_all_that_is_known_of_its_performer(data_dir):
    takes = training_captures(data_dir)
    by_name = {take.name: take for take in takes}
    folds = {fold.name: fold for fold in leave_out(takes)}
    assert set(folds) == {"01", "02", "07", "135", "16", "85", "bd", "mm"}
    for performer, fold in folds.items():
        assert {take.name for take in takes if take.subject == performer} == fold.dropped
        assert fold.scored
        assert all(take.real and take.name in fold.dropped for take in fold.scored)
    assert any(not by_name[name].real for name in folds["02"].dropped)


def test_many_performers_share_folds():
    many = [Capture(f"{n}.c3d", f"p{n % 20}", "", "", real=True) for n in range(40)]
    folds = leave_out(many)
    assert len(folds) == 8
    names = [name for fold in folds for name in fold.dropped]
    assert sorted(names) == sorted(take.name for take in many)
    assert leave_out(many[:1]) == []


@pytest.mark.parametrize(
    ("principal", "told"),
    [
        ("LFHD,NOSE", "NOSE not in the marker set"),
        ("LFHD,C7", "C7 are references"),
        ("LFHD,LFHD", "named twice"),
        ("", "not in the marker set"),
    ],
)
def test_markers_that_cannot_be_principal(small_dir, tmp_path, principal, told):
    with pytest.raises(UsageError, match=told):
        main([str(small_dir), "--out", str(tmp_path / "m.onnx"), "--principal", principal])


def test_other_wrong_usage(small_dir, tmp_path, capsys):
    out = str(tmp_path / "m.onnx")
    for wrong in (
        [str(small_dir)],
        [str(small_dir), "--out", out, "--estimator", "magic"],
        [str(small_dir), "--out", out, "--history", "-1"],
        [str(small_dir), "--out", out, "--history", "9999"],
        [str(small_dir), "--out", out, "--cluster", "http://somewhere"],
    ):
        with pytest.raises(SystemExit) as leaving:
            main(wrong)
        assert leaving.value.code == 2
        assert "error:" in capsys.readouterr().err
    with pytest.raises(UsageError, match=r"ends in \.onnx"):
        main([str(small_dir), "--out", str(tmp_path / "m.json")])


def test_what_cannot_be_written_or_read(small_dir, tmp_path):
    with pytest.raises(MarkerbridgeError, match="no such folder"):
        main([str(small_dir), "--out", str(tmp_path / "no" / "m.onnx"), "--no-folds"])
    with pytest.raises(MarkerbridgeError, match="no C3D file"):
        main([str(tmp_path), "--out", str(tmp_path / "m.onnx")])
    assert list(tmp_path.iterdir()) == []


WITHOUT = """
import sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "{missing}":
            raise ModuleNotFoundError("No module named " + name, name=name)

sys.meta_path.insert(0, Finder())
from bridge.cli import main
sys.exit(main(["train", ".", "--out", "m.onnx"]))
"""


@pytest.mark.parametrize("missing", ["sklearn", "onnx", "threadpoolctl", "joblib"])
def test_without_the_training_libraries_it_says_what_to_install(missing):
    code = WITHOUT.format(missing=missing)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "pip install 'markerbridge[train]'" in done.stderr
