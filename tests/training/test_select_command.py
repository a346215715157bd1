import csv
import json
import os
import re
import signal
import subprocess
import sys

import pytest

from bridge.model import Model
from drivers.errors import MarkerbridgeError, UsageError
from tests.training.conftest import PAPER_SIX
from tests.training.small_models import networks_recipe
from training.network import NetworkOptions
from training.recipe import RECIPES
from training.select_command import main
from training.train_command import main as train

CODE = "import sys; from training.select_command import main; sys.exit(main(sys.argv[1:]))"
FEW = ["--runs", "30", "--restarts", "2"]


@pytest.fixture(scope="module")
def compared(small_dir, tmp_path_factory):
    """The folder of a report with a comparison, and its JSON."""
    folder = tmp_path_factory.mktemp("compared")
    out = folder / "found.json"
    argv = [str(small_dir), *FEW, "--report", str(folder / "report"), "--json", str(out)]
    assert main([*argv, "--compare", PAPER_SIX]) == 0
    return folder / "report", json.loads(out.read_text())


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_shares_are_those_of_the_runs_kept(compared):
    folder, found = compared
    lines = (folder / "runs.csv").read_text().splitlines()[2:]
    runs = [line.partition(",")[2].split() for line in lines]
    assert len(runs) == found["runs"] == 30
    everything = {label for run in runs for label in run}
    assert found["shares"] == {
        label: pytest.approx(sum(label in run for run in runs) / 30) for label in everything
    }
    assert found["sizes"] == {
        str(size): pytest.approx(sum(len(run) == size for run in runs) / 30)
        for size in {len(run) for run in runs}
    }
    assert sum(one["share"] for one in found["sets"]) == pytest.approx(1)
    assert found["clusters"] == found["components"] + 1


def test_compare_tells_what_training_reaches(compared, small_dir, tmp_path):
    """The automatic set is what `train` chooses, and both score it alike on the same folds."""
    _, found = compared
    automatic, manual = found["compared"]
    out = tmp_path / "model.onnx"
    assert train([str(small_dir), "--out", str(out)]) == 0
    info = Model(out).info
    assert tuple(automatic["principal"]) == tuple(found["chosen"]) == info.principal
    assert ",".join(manual["principal"]) == PAPER_SIX
    told = info.accuracy["folds"]
    for scores, reached in (
        (automatic["mean"], told["mean"]),
        *((automatic["left_out"][name], scores) for name, scores in told["left_out"].items()),
    ):
        assert scores == {name: pytest.approx(value, abs=0.006) for name, value in reached.items()}
    assert set(automatic["left_out"]) == set(manual["left_out"]) == {"02", "07", "16"}
    assert manual["mean"]["rms_all_mm"] != automatic["mean"]["rms_all_mm"]


def test_the_report_tells_the_same(compared, small_dir):
    folder, found = compared
    shares = {row["marker"]: row for row in rows(folder / "shares.csv")}
    assert list(shares) == list(found["shares"])
    for label, share in found["shares"].items():
        assert float(shares[label]["runs [%]"]) == pytest.approx(100 * share)
        assert (shares[label]["taken by training"] == "yes") == (label in found["chosen"])
    means = {row["set"]: float(row["RMS, all 41 [mm]"]) for row in rows(folder / "compared.csv")}
    assert list(means) == ["automatic", "manual 1"]
    assert list(means.values()) == [one["mean"]["rms_all_mm"] for one in found["compared"]]
    performers = {row["left out"]: row for row in rows(folder / "performers.csv")}
    for name, scores in found["compared"][1]["left_out"].items():
        assert float(performers[name]["manual 1"]) == scores["rms_all_mm"]
    page = (folder / "index.html").read_text()
    for name in ("figure_4", "body", "comparison"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert f"{name}.png" in page
    assert f"markerbridge select-markers {small_dir.name} --runs 30" in page
    assert str(small_dir.parent) not in page


def test_without_a_report_it_is_a_table(small_dir, capsys):
    assert main([str(small_dir), *FEW]) == 0
    told = capsys.readouterr()
    assert "principal markers: " in told.out
    assert "runs %" in told.out
    assert told.err.splitlines()[-1].startswith("100 % 30 of 30 runs")


def test_what_ctrl_c_and_kill_leave_goes_on(compared, small_dir, tmp_path):
    """Both end a real process in the middle of its runs; what they leave together is what a study
    that was never stopped has.
    """
    folder, found = compared
    report, out = tmp_path / "report", tmp_path / "found.json"
    argv = [str(small_dir), "--restarts", "2", "--report", str(report)]
    for how, enough in ((signal.SIGINT, 20), (signal.SIGKILL, 40)):
        process = subprocess.Popen(
            [sys.executable, "-c", CODE, *argv, "--runs", "100000"],
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        with process:
            for line in process.stderr:
                done = re.search(r"(\d+) of 100000 runs", line)
                if done and int(done[1]) >= enough:
                    break
            os.killpg(process.pid, how)  # as a terminal does: the workers get it too
            rest = process.stderr.read()
        assert process.returncode != 0
        assert ("the same command goes on there" in rest) == (how == signal.SIGINT)
    whole = (folder / "runs.csv").read_bytes()
    assert (report / "runs.csv").read_bytes().startswith(whole)
    assert main([*argv, "--runs", "30", "--json", str(out)]) == 0
    assert json.loads(out.read_text()) == found | {"compared": None}


def test_other_options_want_another_folder(compared, small_dir):
    folder, _ = compared
    before = (folder / "runs.csv").read_bytes()
    with pytest.raises(MarkerbridgeError, match="choose another folder"):
        main([str(small_dir), *FEW, "--seed", "1", "--report", str(folder)])
    assert (folder / "runs.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("sets", "told"),
    [
        ("LFHD,RTOE;LFHD,NOSE", "--compare: NOSE not in the marker set"),
        ("LFHD,C7", "--compare: C7 are references"),
        ("LFHD,RTOE;", "--compare: .*not in the marker set"),
    ],
)
def test_sets_that_cannot_be_compared(small_dir, sets, told):
    with pytest.raises(UsageError, match=told):
        main([str(small_dir), "--compare", sets])


def test_other_wrong_usage(small_dir, tmp_path, capsys):
    for wrong in (["--runs", "0"], ["--restarts", "-1"], ["--runs", "many"], ["--seed", "x"]):
        with pytest.raises(SystemExit) as leaving:
            main([str(small_dir), *wrong])
        assert leaving.value.code == 2
        assert "error:" in capsys.readouterr().err
    with pytest.raises(MarkerbridgeError, match="no C3D file"):
        main([str(tmp_path)])
    with pytest.raises(MarkerbridgeError, match="no such folder"):
        main([str(small_dir), "--json", str(tmp_path / "no" / "found.json")])
    (tmp_path / "file").touch()
    with pytest.raises(MarkerbridgeError, match="no report in"):
        main([str(small_dir), "--report", str(tmp_path / "file")])


def test_one_capture_is_no_comparison(small_dir, tmp_path):
    (tmp_path / "one.c3d").write_bytes((small_dir / "real/02_01.c3d").read_bytes())
    with pytest.raises(MarkerbridgeError, match="--compare needs more than one capture"):
        main([str(tmp_path), "--compare", "LFHD,RTOE"])


@pytest.fixture(scope="module")
def searched(small_dir, tmp_path_factory):
    """The folder of a report on the search, and its JSON."""
    folder = tmp_path_factory.mktemp("searched")
    out = folder / "found.json"
    argv = [str(small_dir), "--by", "error", "--count", "3", "--must", "LTOE", "--top", "2"]
    argv += ["--compare", PAPER_SIX, "--report", str(folder / "report"), "--json", str(out)]
    assert main(argv) == 0
    return folder / "report", json.loads(out.read_text())


def test_by_error_the_estimator_decides_among_the_best(searched, compared):
    _, found = searched
    assert found["by"] == "error"
    assert found["wishes"]["must"] == ["LTOE"]
    sets = {one["name"]: one for one in found["sets"]}
    assert list(sets) == [*(f"best {number}" for number in range(1, 6)), "by variance", "manual 1"]
    best = [sets["best 1"], sets["best 2"]]
    assert best[0]["error_mm"] <= best[1]["error_mm"] <= sets["best 3"]["error_mm"]
    assert all(len(one["markers"]) == 3 and "LTOE" in one["markers"] for one in best)
    assert sets["best 3"]["scores"] is None
    reached = {
        tuple(one["markers"]): one["scores"]["mean"]["rms_all_mm"]
        for one in (*best, sets["by variance"], sets["manual 1"])
    }
    assert found["chosen"] in [one["markers"] for one in best]
    assert reached[tuple(found["chosen"])] == min(reached[tuple(one["markers"])] for one in best)
    # The sets beside it do here as they do where markers are chosen by variance.
    _, by_variance = compared
    for one in by_variance["compared"]:
        assert reached[tuple(one["principal"])] == one["mean"]["rms_all_mm"]
    assert [len(one["markers"]) for one in found["by_size"]] == [1, 2, 3]
    assert found["by_size"][-1]["markers"] == sets["best 1"]["markers"]


def test_the_report_on_the_search_tells_the_same(searched, small_dir):
    folder, found = searched
    sets = {row["set"]: row for row in rows(folder / "sets.csv")}
    assert list(sets) == [one["name"] for one in found["sets"]]
    for one in found["sets"]:
        row = sets[one["name"]]
        assert float(row["closed form [mm]"]) == one["error_mm"]
        assert row["markers"] == ", ".join(one["markers"])
        assert (row["chosen"] == "yes") == (one["markers"] == found["chosen"])
    sizes = rows(folder / "by_size.csv")
    assert [float(row["closed form [mm]"]) for row in sizes] == [
        one["error_mm"] for one in found["by_size"]
    ]
    means = rows(folder / "compared.csv")
    assert means[0]["principal markers"] == ", ".join(found["chosen"])  # comes first
    assert {row["set"] for row in means} == {"best 1", "best 2", "by variance", "manual 1"}
    page = (folder / "index.html").read_text()
    for name in ("number", "comparison"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert f"{name}.png" in page
    assert "--count 3 --must LTOE" in page
    assert str(small_dir.parent) not in page


def test_alone_the_estimator_does_what_training_does(small_dir, tmp_path, capsys):
    """The shoulders count among the markers, give the body frame and are no principal ones."""
    out, model = tmp_path / "found.json", tmp_path / "model.onnx"
    argv = [str(small_dir), "--by", "error", "--alone", "--pairs", "--count", "4", "--top", "1"]
    page = tmp_path / "page"
    argv += ["--json", str(out), "--compare", "LSHO,RSHO,C7,LTOE", "--report", str(page)]
    assert main(argv) == 0
    found = json.loads(out.read_text())
    assert {"LSHO", "RSHO"} < {*found["chosen"]}
    assert found["references"] == ["LSHO", "RSHO"]
    principal = [label for label in found["chosen"] if label not in found["references"]]
    assert f"principal markers: {', '.join(principal)}\n" in capsys.readouterr().out
    sets = {one["name"]: one for one in found["sets"]}
    assert sets["best 1"]["markers"] == found["chosen"]
    assert sets["best 1"]["scores"]["principal"] == principal
    assert sets["manual 1"]["scores"]["principal"] == ["C7", "LTOE"]
    by_variance = sets["by variance"]["markers"]
    assert by_variance[:2] == ["LSHO", "RSHO"]
    assert not {"LSHO", "RSHO"} & {*by_variance[2:]}
    assert sets["best 2"]["scores"] is None
    assert rows(page / "compared.csv")[0]["principal markers"] == ", ".join(principal)
    assert "LSHO and RSHO are worn beside all" in (page / "index.html").read_text()
    argv = [str(small_dir), "--alone", "--principal", ",".join(principal), "--out", str(model)]
    assert train(argv) == 0
    told = Model(model).info.accuracy["folds"]["mean"]
    assert sets["best 1"]["scores"]["mean"] == {
        name: pytest.approx(value, abs=0.006) for name, value in told.items()
    }


def test_networks_score_sets_as_well(small_dir, tmp_path, monkeypatch):
    options = NetworkOptions(hidden=(16,), steps=30, batch=32)
    monkeypatch.setitem(RECIPES, "best", networks_recipe(options))
    out = tmp_path / "found.json"
    argv = [str(small_dir), "--by", "error", "--alone", "--count", "3", "--top", "1"]
    assert main([*argv, "--estimator", "best", "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    assert found["estimator"] == "best"
    scores = found["sets"][0]["scores"]
    assert scores["principal"] == [one for one in found["chosen"] if one not in ("LSHO", "RSHO")]
    assert set(scores["left_out"]) == {"02", "07", "16"}
    assert all(10 < one["rms_all_mm"] < 500 for one in scores["left_out"].values())


def test_without_top_nothing_is_trained(small_dir, capsys):
    argv = [str(small_dir), "--by", "error", "--count", "2", "--clothes", "--top", "0"]
    assert main(argv) == 0
    told = capsys.readouterr()
    assert "principal markers: " in told.out
    assert told.err.splitlines()[-1].startswith("100 % search 8 of 8")


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["--pairs"], "--pairs goes with --by error"),
        (["--count", "6"], "--count goes with --by error"),
        (["--by", "error", "--runs", "3"], "--runs goes with --by variance"),
        (["--by", "error", "--must", "NOSE"], "--must: NOSE not in the marker set"),
        (["--by", "error", "--never", "C7"], "--never: C7 are references"),
        (["--by", "error", "--count", "40"], "--count 40: the wishes leave 38 markers"),
        (["--by", "error", "--compare", "C7,LTOE"], "--compare: C7 are references"),
        (["--by", "error", "--alone", "--count", "2"], "--count 2: the shoulders alone"),
        (["--by", "error", "--alone", "--compare", "C7,LTOE"], "--compare: .*LSHO and RSHO"),
        (["--by", "error", "--alone", "--compare", "LSHO,RSHO,X"], "--compare: X not in the"),
    ],
)
def test_wishes_that_cannot_be_meant(small_dir, argv, told):
    with pytest.raises(UsageError, match=told):
        main([str(small_dir), *argv])


def test_one_capture_has_nobody_to_leave_out(small_dir, tmp_path):
    (tmp_path / "one.c3d").write_bytes((small_dir / "real/02_01.c3d").read_bytes())
    with pytest.raises(MarkerbridgeError, match="--by error needs more than one capture"):
        main([str(tmp_path), "--by", "error"])
