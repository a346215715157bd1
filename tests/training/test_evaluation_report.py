import json
import shutil

import numpy as np
import onnx
import pytest
from matplotlib.colors import to_hex

from bridge.estimator import PoseEstimator
from bridge.model import METADATA_KEY
from drivers.errors import MarkerbridgeError, UsageError
from drivers.marker_set import MARKERS
from tests.training.test_report_page import check_page, read_table
from training.dataset import load
from training.evaluate_command import HISTORIES, main
from training.evaluation import GAMMA_EDGES, Scores, evaluate, mean_scores, score
from training.report import paper
from training.report.body import body_figure
from training.report.evaluation import default_shown, marker_errors
from training.report.page import NEAREST, OURS
from training.report.plots import categories_figure, frames_figure, gamma_figure, latency_figure

TEST = "real/07_12.c3d"


@pytest.fixture(scope="module")
def model(mixture_model):
    """A mixture: of those the report tells most."""
    return mixture_model


@pytest.fixture(scope="module")
def takes(small_dir):
    return load(small_dir, None, pytest.fail)


@pytest.fixture(scope="module")
def made(model, small_dir, tmp_path_factory):
    """The report on the test split beside nearest neighbour search, and the same as JSON."""
    folder = tmp_path_factory.mktemp("made")
    argv = [model.path, small_dir, "--split", "test", "--train", small_dir]
    argv += ["--report", folder / "report", "--json", folder / "found.json"]
    assert main([str(word) for word in argv]) == 0
    return folder / "report" / "index.html", json.loads((folder / "found.json").read_text())


def columns(path):
    """A CSV by its first column, as numbers where they are; None where empty."""
    head, *rows = read_table(path)
    return {row[0]: dict(zip(head[1:], map(number, row[1:]), strict=True)) for row in rows}


def number(text):
    try:
        return float(text) if text else None
    except ValueError:
        return text


def test_the_page_is_whole_and_says_what_was_run(made, small_dir):
    path, _ = made
    page = check_page(path)
    run = columns(path.with_name("run.csv"))
    command = run["command"]["value"]
    assert command == (
        f"markerbridge evaluate mixture.onnx {small_dir.name} --split test "
        f"--train {small_dir.name} --report report --json found.json"
    )
    assert "1 sequences, 263 frames" in run["scored on"]["value"]
    assert "LFHD, RELB, LUPA, RSHN, LTOE, RTOE" in run["principal markers"]["value"]
    assert small_dir.name in run["nearest neighbour (NN)"]["value"]
    for folder in (small_dir.parent, path.parents[1]):
        assert str(folder) not in path.read_text()
    assert f"{TEST}: brisk walk, performer 07." in page.text


def test_the_tables_hold_the_figures_of_the_json(made):
    path, found = made
    head, *rows = read_table(path.with_name("paper.csv"))
    assert head[2:] == ["this model", "NN", "ratio", "paper", "paper's NN", "paper's ratio"]
    mean = found["mean"]
    ours = [[number(cell) for cell in row[2:]] for row in rows]
    assert ours[0] == [mean["rms_mm"], mean["nn_rms_mm"], mean["rms_ratio"], 45, 56, 45 / 56]
    assert ours[1] == [mean["jerk_mm"], mean["nn_jerk_mm"], mean["jerk_ratio"], *[None] * 3]
    # 1 mm in 1/120 s is 120 mm/s, which is 12 cm/s.
    assert ours[2][:2] == pytest.approx([12 * mean["jerk_mm"], 12 * mean["nn_jerk_mm"]])
    assert ours[3] == [None, None, None, 20, 76, 20 / 76]
    scores = ("rms_mm", "nn_rms_mm", "rms_ratio", "jerk_mm", "nn_jerk_mm", "jerk_ratio")
    (row,) = read_table(path.with_name("sequences.csv"))[1:]
    (sequence,) = found["sequences"]
    assert row[:2] == [TEST, "07"]
    assert [number(cell) for cell in row[-6:]] == [sequence[name] for name in scores]
    for name in ("categories", "performers"):
        for group, values in columns(path.with_name(f"{name}_errors.csv")).items():
            expected = [found[name][group][part] for part in ("sequences", "frames", *scores)]
            assert list(values.values()) == expected
    latency = columns(path.with_name("latency_ms.csv"))
    for name, value in found["latency_us"].items():
        assert 1000 * latency["this model"][f"{name} [ms]"] == pytest.approx(value, abs=0.06)
    assert latency["the paper (4.2)"]["mean [ms]"] == pytest.approx(1.5)


def test_errors_by_marker_are_root_mean_squares(made, model, takes):
    path, found = made
    take = next(take for take in takes if take.name == TEST)
    estimator = PoseEstimator(model)
    (result,) = score(estimator, [take])
    errors = dict(zip(model.info.unworn, marker_errors([result]), strict=True))
    told = columns(path.with_name("markers.csv"))
    assert set(told) == set(model.info.unworn)
    assert {name: row["RMS [mm]"] for name, row in told.items()} == pytest.approx(errors)
    values = [row["RMS [mm]"] for row in told.values()]
    assert values == sorted(values, reverse=True)
    for name, row in told.items():
        share = found["sigma"]["within_2"]["markers"][name]
        assert row["within 2 σ [%]"] == pytest.approx(100 * share)
    # Where no marker is missing, the mean square over markers is that over frames.
    clean = next(take for take in takes if not np.isnan(take.xyz).any())
    (result,) = evaluate(model, [clean])
    assert np.mean(marker_errors([result]) ** 2) == pytest.approx(np.mean(result.trace.rms**2))


def test_jerky_frames_are_counted_at_transitions(made, model, takes):
    path, _ = made
    tests = [take for take in takes if take.name == TEST]
    (plain,) = score(PoseEstimator(model, history=0), tests)
    (mixed,) = evaluate(model, tests)
    threshold = np.nanpercentile(plain.trace.jerk[~plain.transition], 99)
    head, *rows = read_table(path.with_name("jerky_frames.csv"))
    assert head[3] == "jerky frames"
    for row, result in zip(rows, (plain, mixed), strict=True):
        jerky = result.trace.jerk > threshold
        assert int(row[1]) == result.frames - 1
        assert float(row[2]) == pytest.approx(100 * result.transition[1:].mean())
        assert int(row[3]) == jerky.sum()
        at_transitions = result.transition[jerky]
        assert number(row[4]) == (
            pytest.approx(100 * at_transitions.mean()) if len(at_transitions) else None
        )
    assert f"{threshold:.1f} mm per 1/120 s" in path.read_text()


def test_histories_are_those_of_the_estimator(made, model, takes):
    _, *rows = read_table(made[0].parent / "histories.csv")
    tests = [take for take in takes if take.name == TEST]
    assert [int(row[0]) for row in rows] == list(HISTORIES)
    for length, *errors in (rows[0], rows[3]):
        expected = mean_scores(score(PoseEstimator(model, history=int(length)), tests))
        assert [float(cell) for cell in errors] == pytest.approx(
            [expected.rms_mm, expected.jerk_mm, expected.roughness]
        )


def test_hostile_names_odd_captures_and_no_training_poses(small_dir, tmp_path, capsys):
    data = tmp_path / "data"
    data.mkdir()
    name = "<script>&\"'$x$ {{ 1 }}, walk.c3d"
    shutil.copy(small_dir / TEST, data / name)
    (data / "<b>broken.c3d").write_bytes(b"no capture")
    argv = ["default", str(data), f"--report={tmp_path / 'report'}", "--gaps", "20%:10-100"]
    assert main(argv) == 0
    path = tmp_path / "report" / "index.html"
    assert str(path) in capsys.readouterr().out
    page = check_page(path)
    assert "no nearest neighbour" in page.text
    assert name in page.text
    assert str(tmp_path) not in path.read_text()
    ((left_out, why),) = read_table(path.with_name("left_out.csv"))[1:]
    assert left_out == "<b>broken.c3d"
    assert why
    assert "--gaps 20%:10-100" in columns(path.with_name("run.csv"))["command"]["value"]
    for row in read_table(path.with_name("paper.csv"))[1:]:
        assert row[3:5] == ["", ""]
    assert not {image["alt"] for image in page.all("img")} & {""}


@pytest.mark.parametrize("says", [True, False])
def test_what_the_model_says_of_its_training(says, model, small_dir, tmp_path):
    training = {
        "performers": ["02", "07"],
        "forest_error": {"frames": 0.0123, "segments": 0.25},
    }
    info = json.loads(model.info.to_json())
    info["training"] = training if says else {}
    graph = onnx.load(str(model.path))
    onnx.helper.set_model_props(graph, {METADATA_KEY: json.dumps(info)})
    onnx.save(graph, str(tmp_path / "told.onnx"))
    argv = [tmp_path / "told.onnx", small_dir, "--split", "test", "--report", tmp_path / "report"]
    main([str(word) for word in argv])
    page = check_page(tmp_path / "report" / "index.html")
    figures = columns(tmp_path / "report" / "figures.csv")
    row = figures["classifier error, frames [%]"]
    assert row["paper"] == pytest.approx(0.29)
    assert row["this model"] == (pytest.approx(1.23) if says else None)
    segments = figures["classifier error, whole segments [%]"]["this model"]
    assert segments == (pytest.approx(25) if says else None)
    groups = columns(tmp_path / "report" / "performers_errors.csv")
    assert list(groups) == ["seen" if says else "unknown"]
    for text in ("without measuring the error", "does not say whose motion"):
        assert (text in page.text) is not says


def test_captures_that_were_trained_on_are_told_of(small_dir, tmp_path, capsys):
    argv = ["default", str(small_dir), "--train", str(small_dir)]
    assert main([*argv, "--report", str(tmp_path / "report")]) == 0
    told = "4 of the 5 captures to be scored are among those of --train"
    assert told in capsys.readouterr().err
    page = check_page(tmp_path / "report/index.html")
    assert "4 of the captures scored are among the training captures" in page.text
    assert main([*argv, "--split", "test"]) == 0
    assert "among those of --train" not in capsys.readouterr().err


def test_show_chooses_the_sequences(small_dir, tmp_path):
    for name, source in (("a.c3d", TEST), ("b.c3d", "real/07_01.c3d"), ("c.c3d", TEST)):
        (tmp_path / "data").mkdir(exist_ok=True)
        shutil.copy(small_dir / source, tmp_path / "data" / name)
    report = tmp_path / "report"
    argv = ["default", str(tmp_path / "data"), "--report", str(report), "--show", "c.c3d,a.c3d"]
    assert main(argv) == 0
    page = check_page(report / "index.html")
    drawn = [image["alt"] for image in page.all("img") if ", performer " in image["alt"]]
    assert [text.partition(":")[0] for text in drawn] == ["c.c3d", "a.c3d"]


def test_calibrated_and_with_a_marker_hidden(small_dir, tmp_path):
    """What is too short is told; the figures of the hidden marker are in the page as well."""
    for folder in ("data", "report"):
        (tmp_path / folder).mkdir()
    shutil.copy(small_dir / TEST, tmp_path / "data" / "walk.c3d")
    argv = ["default", str(tmp_path / "data"), "--hide", "RANK@2.5s", "--calibrate", "1s"]
    argv += ["--report", str(tmp_path / "report"), "--json", str(tmp_path / "found.json")]
    assert main(argv) == 0
    page = check_page(tmp_path / "report" / "index.html")
    assert "Too short for that: walk.c3d." in page.text
    hidden = json.loads((tmp_path / "found.json").read_text())["hidden"]
    assert hidden["windows"] == 0


def test_hidden_markers_are_told_by_age_and_at_their_return(small_dir, tmp_path):
    argv = ["default", str(small_dir), "--split", "test", "--hide", "all@0.5s"]
    argv += ["--report", str(tmp_path / "report"), "--json", str(tmp_path / "found.json")]
    assert main(argv) == 0
    hidden = json.loads((tmp_path / "found.json").read_text())["hidden"]
    rows = [*hidden["markers"], hidden["mean"]]
    _, *told = read_table(tmp_path / "report" / "hidden.csv")
    expected = [
        [row["marker"], at["age_s"], at["error_mm"], at["unworn_rms_mm"]]
        for row in rows
        for at in row["ages"]
    ]
    assert [[line[0], *map(number, line[1:4])] for line in told] == expected
    shares = [100 * at["within_2"] for row in rows for at in row["ages"]]
    assert [number(line[5]) for line in told] == pytest.approx(shares)
    _, *told = read_table(tmp_path / "report" / "returning.csv")
    names = [*(row["marker"] for row in rows), "none"]
    parts = [*(row["returning"] for row in rows), hidden["unhidden"]]
    assert [line[0] for line in told] == names
    assert [[number(cell) for cell in line[3:6]] for line in told] == [
        [part[name] for name in ("mean_mm", "p99_mm", "max_mm")] for part in parts
    ]
    page = check_page(tmp_path / "report" / "index.html")
    assert "Each tracked marker in turn hidden for 0.5 s" in page.text


def test_a_network_has_no_mixture_to_tell_of(network_model, small_dir, tmp_path):
    argv = [network_model.path, small_dir, "--split", "test", "--train", small_dir]
    argv += ["--report", tmp_path / "report"]
    assert main([str(word) for word in argv]) == 0
    page = check_page(tmp_path / "report" / "index.html")
    run = columns(tmp_path / "report" / "run.csv")
    assert run["model"]["value"] == "network.onnx (estimator best, a network)"
    assert "mixture" not in run
    for text in ("Transitions", "Length of the history", "without measuring the error"):
        assert text not in page.text
    for name in ("histories", "jerky_frames"):
        assert not (tmp_path / "report" / f"{name}.csv").exists()
    assert columns(tmp_path / "report" / "figures.csv")["local models"]["this model"] is None


def test_wrong_usage_ends_before_the_work(small_dir, tmp_path):
    data, report = str(small_dir), str(tmp_path / "report")
    with pytest.raises(UsageError, match=r"no gone\.c3d among .*real/07_12\.c3d"):
        main(["default", data, "--report", report, "--show", f"{TEST},gone.c3d"])
    with pytest.raises(UsageError, match="needs --report"):
        main(["default", data, "--show", TEST])
    (tmp_path / "file").write_text("")
    with pytest.raises(MarkerbridgeError, match="no report in"):
        main(["default", data, "--report", str(tmp_path / "file")])


def test_one_of_each_of_the_largest_kinds_is_shown(model, takes):
    results = evaluate(model, takes)
    assert len(takes) == 5
    walks = sorted(
        (result for result in results if "16_07" not in result.file),
        key=lambda result: result.scores.rms_mm,
    )
    assert default_shown(results) == [walks[1].file, "real/16_07.c3d"]


def test_frames_are_drawn_over_time_with_the_papers_means(model, takes):
    (result,) = evaluate(model, takes[:1])
    rms, jerk = frames_figure(result).axes
    lines = {line.get_label(): line for line in rms.get_lines()}
    ours = lines["this model"]
    np.testing.assert_array_equal(ours.get_ydata(), result.trace.rms)
    np.testing.assert_allclose(ours.get_xdata(), np.arange(result.frames) / 120)
    (drawn,) = jerk.get_lines()
    np.testing.assert_array_equal(drawn.get_ydata(), result.trace.jerk)
    assert lines["paper, its method: 45 mm"].get_ydata()[0] == 45
    assert lines["paper, nearest neighbour: 56 mm"].get_ydata()[0] == 56
    assert "mm per marker" in rms.get_ylabel()
    assert "mm per 1/120 s" in jerk.get_ylabel()
    assert jerk.get_xlabel() == "time [s]"


def test_bars_are_the_means_of_the_kinds():
    groups = {
        "walking": Scores(40.0, 30.0, 2.0, 1.0, 60.0, 9.0),
        "jumping": Scores(90.0, 80.0, 5.0, 1.0, None, None),
    }
    rms, jerk = categories_figure(groups).axes
    for axes, expected in ((rms, [40, 90, 60, np.nan]), (jerk, [2, 5, 9, np.nan])):
        np.testing.assert_equal([bar.get_width() for bar in axes.patches], expected)
        assert [label.get_text() for label in axes.get_yticklabels()] == list(groups)
        assert "[mm per" in axes.get_xlabel()
    assert [line.get_xdata()[0] for line in rms.get_lines()] == [paper.RMS_MM, paper.NN_RMS_MM]
    alone = {"walking": Scores(40.0, 30.0, 2.0, 1.0)}
    assert len(categories_figure(alone).axes[0].patches) == 1


def test_velocity_errors_are_drawn_apart():
    counts = np.zeros((2, len(GAMMA_EDGES) - 1), np.int64)
    counts[0, :3] = (500, 30, 2)
    counts[1, 1:40] = 7
    figure = gamma_figure({"without": counts, "with": 2 * counts}, jerky=12.5)
    for axes, factor in zip(figure.axes, (1, 2), strict=True):
        others, at_change = axes.patches
        np.testing.assert_array_equal(others.get_data().values, factor * counts[0])
        np.testing.assert_array_equal(at_change.get_data().values, factor * counts[1])
        assert axes.get_yscale() == "log"
        assert axes.get_xlim() == (0, 40)
        assert axes.get_xlabel() == "velocity error γ [mm per 1/120 s]"
        assert axes.get_lines()[0].get_xdata()[0] == 12.5
    colours = [to_hex(part) for part in (others.get_facecolor(), at_change.get_edgecolor())]
    assert [colour.upper() for colour in colours] == [OURS, NEAREST]


def test_latencies_are_counted_in_milliseconds():
    seconds = np.linspace(0.0001, 0.002, 1000)
    (axes,) = latency_figure(seconds).axes
    assert axes.patches[0].get_data().values.sum() == 1000
    marks = [line.get_xdata()[0] for line in axes.get_lines()]
    assert marks == pytest.approx([*np.percentile(1000 * seconds, (50, 99)), 1.5])
    assert "[ms]" in axes.get_xlabel()
    assert latency_figure(np.full(3, 0.001)).axes[0].patches[0].get_data().values.sum() == 3


def test_the_body_has_each_marker_once_in_each_view(model):
    tracked, unworn = model.info.tracked, model.info.unworn
    figure = body_figure({name: float(n) for n, name in enumerate(unworn)}, tracked, "RMS [mm]")
    *views, bar = figure.axes
    assert bar.get_ylabel() == "RMS [mm]"
    for axes in views:
        _, white, discs = axes.collections
        assert len(white.get_offsets()) == len(tracked)
        assert len(discs.get_offsets()) == len(unworn)
        np.testing.assert_array_equal(discs.get_array(), np.arange(len(unworn)))
        assert "[m]" in axes.get_xlabel()
    named = [text.get_text() for axes in views for text in axes.texts]
    assert sorted(named) == sorted(MARKERS)
    # From the front the left hand is on the right; from its left the body faces left.
    front, side = (
        dict(zip(unworn, axes.collections[2].get_offsets().tolist(), strict=True)) for axes in views
    )
    assert front["LFIN"][0] > front["RFIN"][0]
    assert side["CLAV"][0] < side["T10"][0]
    assert front["LFIN"][1] == side["LFIN"][1]
