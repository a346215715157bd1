"""Recordings to look at: what of them is shown, and `markerbridge view`."""

from __future__ import annotations

from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.pose import Provenance
from bridge.sinks.sink import SinkError, ViewError
from bridge.truth import rms_mm
from bridge.view import command, process
from bridge.view.command import main
from bridge.view.pictures import Animation, save_picture
from bridge.view.recorded import Take, read_recording, recording_url
from bridge.view.scene import Worn
from drivers.c3d_file import C3dSource, read_c3d, write_c3d
from drivers.clock import VirtualClock
from drivers.errors import MarkerbridgeError, UsageError
from drivers.frame import Layout, MarkerFrame, SourceError
from drivers.marker_set import MARKERS
from drivers.session_log import LogWriter
from tests.bridge.test_log_sink import recorded, walk

MODEL = Model("default")


def read(address: object, model: Model | None = None) -> tuple[Take, Worn]:
    return read_recording(recording_url(str(address)), MODEL.info, model, lambda moments: moments)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of a walk with gaps."""
    path = tmp_path_factory.mktemp("clip") / "walk.c3d"
    write_c3d(path, Layout(MARKERS, 120.0), walk(240))
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "session.mcap"
    recorded(path)
    return path


def test_what_a_capture_has_is_measured_and_the_rest_lost(clip: Path) -> None:
    take, worn = read(clip)
    xyz = read_c3d(clip).xyz
    assert len(take) == len(xyz)
    assert worn == Worn()
    for index in (0, 100, 239):
        pose, truth = take[index]
        assert (pose.index, truth) == (index, None)
        assert pose.t - take[0].pose.t == pytest.approx(index / 120)
        np.testing.assert_array_equal(pose.xyz, xyz[index])
        lost = np.isnan(xyz[index, :, 0])
        np.testing.assert_array_equal(pose.provenance == Provenance.LOST, lost)
        np.testing.assert_array_equal(pose.provenance == Provenance.MEASURED, ~lost)


def test_with_a_model_a_capture_is_the_truth_beside_what_is_estimated(clip: Path) -> None:
    take, worn = read(f"c3d:{clip}", MODEL)
    assert worn == Worn.of(MODEL.info)
    capture = read_c3d(clip)
    estimator = PoseEstimator(MODEL)
    for index, frame in enumerate(C3dSource("", capture, VirtualClock(), float("inf"))):
        pose, truth = take[index]
        np.testing.assert_array_equal(pose.xyz, estimator.step(frame).xyz)
        np.testing.assert_array_equal(truth, capture.xyz[index])
    assert 0 < rms_mm(pose.xyz, truth) < 100


def test_a_logs_poses_are_shown_as_they_were_with_their_truth(log: Path) -> None:
    take, worn = read(log)
    assert worn == Worn(
        tuple(label for label in MODEL.info.labels if label in MODEL.info.principal),
        MODEL.info.references,
        ("C7",),
    )
    true = walk(120)
    assert len(take) == 120
    for index in (0, 60, 119):
        pose, truth = take[index]
        assert pose.index == index
        np.testing.assert_array_equal(truth, true[index])
        assert (pose.provenance == Provenance.ESTIMATED).sum() == len(MODEL.info.unworn)
    assert take[119].pose.t - take[0].pose.t == pytest.approx(119 / 120)


def test_a_log_can_be_estimated_anew(log: Path) -> None:
    (old, _), (new, _) = read(log), read(log, MODEL)
    assert len(old) == len(new)
    for index in (0, 60, 119):
        np.testing.assert_array_equal(old[index].pose.xyz, new[index].pose.xyz)
        np.testing.assert_array_equal(old[index].truth, new[index].truth)


@pytest.mark.parametrize("model", [None, MODEL])
def test_of_a_log_that_is_cut_short_it_is_said_once(log: Path, tmp_path, caplog, model) -> None:
    cut = tmp_path / "cut.mcap"
    whole = log.read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    take, _ = read(cut, model)
    assert take[0].truth is not None
    assert caplog.text.count("is not whole") == 1


def test_an_animation_is_as_long_as_asked_for(clip: Path, tmp_path: Path, capsys) -> None:
    path = tmp_path / "view.gif"
    options = ["--model", "default", "--seconds", "0.5", "--fps", "12", "--size", "160x90"]
    assert main([str(clip), "--animation", str(path), *options]) == 0
    with Image.open(path) as animation:
        assert (animation.n_frames, animation.size) == (6, (160, 90))
    assert f"{path}: 6 pictures of 160x90 pixels" in capsys.readouterr().err


@pytest.mark.parametrize("ending", [".gif", ".webp", ".png"])
def test_an_animation_keeps_its_time_in_every_format(tmp_path: Path, ending: str) -> None:
    animation = Animation()
    for number in range(30):
        picture = np.full((36, 64, 3), 20, np.uint8)
        picture[:, 2 * number : 2 * number + 4] = (255, 107, 13)  # what is imputed
        animation.add(picture, number / 30)
    animation.add(np.zeros((8, 8, 3), np.uint8), 1.0)  # the window was made smaller: left out
    path = tmp_path / f"view{ending}"
    animation.save(path)
    total = 0.0
    with Image.open(path) as read_back:
        assert read_back.n_frames == 30
        for number in range(30):
            read_back.seek(number)
            read_back.load()
            total += read_back.info["duration"]
            pixels = np.asarray(read_back.convert("RGB")).astype(int)
            assert np.abs(pixels[18, 2 * number + 1] - (255, 107, 13)).max() < 12
    assert total == pytest.approx(1000, abs=15)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_what_cannot_be_written_is_said(tmp_path: Path) -> None:
    animation = Animation()
    with pytest.raises(SinkError, match="no picture"):
        animation.save(tmp_path / "a.gif")
    animation.add(np.zeros((8, 8, 3), np.uint8), 0.0)
    for call in (
        lambda path: animation.save(path),
        lambda path: save_picture(path, np.zeros((8, 8, 3), np.uint8)),
    ):
        with pytest.raises(SinkError, match=r"cannot write .*No such file"):
            call(tmp_path / "no" / "a.png")


def broken(connection: Connection, *arguments: object) -> None:
    connection.send(process.READY)
    raise RuntimeError("the card is on fire")


def closed(connection: Connection, *arguments: object) -> None:
    connection.send(process.READY)


def test_the_command_ends_with_the_window_and_says_what_broke(clip: Path, monkeypatch) -> None:
    monkeypatch.setattr(command, "require_display", lambda: None)
    monkeypatch.setattr(command, "replay", closed)
    assert main([str(clip)]) == 0
    monkeypatch.setattr(command, "replay", broken)
    with pytest.raises(ViewError, match="RuntimeError: the card is on fire"):
        main([str(clip)])


def wrong(tmp_path: Path, clip: Path) -> list[tuple[list[str], type[MarkerbridgeError], str]]:
    """Options, the error, and words of its one line."""
    png = ["--png", str(tmp_path / "a.png")]
    text = tmp_path / "a.mcap"
    text.write_text("nothing")
    foreign = tmp_path / "foreign.c3d"
    write_c3d(foreign, Layout(("HIP", "NOSE"), 100.0), np.zeros((5, 2, 3), np.float32) + 1)
    frames = tmp_path / "frames.mcap"
    writer = LogWriter(frames, "test", VirtualClock())
    writer.add(MarkerFrame(0, 0.0, 0.0, Layout(("C7",), 120.0), np.zeros((1, 3), np.float32)))
    writer.close()
    return [
        (["no.c3d", *png], SourceError, "no.c3d: no such file"),
        (["no.mcap", *png], SourceError, "cannot read no.mcap: No such file"),
        ([str(text), *png], SourceError, "is no MCAP file"),
        (["osc://127.0.0.1:9100", *png], UsageError, "is no recording.*run SOURCE --to view:"),
        ([f"c3d:{clip}?colour=red", *png], UsageError, "unknown option colour"),
        ([str(foreign), *png], SourceError, "none of the 41 markers .*HIP, NOSE.*labels="),
        ([str(foreign), "--model", "default", *png], SourceError, "none of the markers that the"),
        ([str(frames), *png], SourceError, "holds no poses: --model default"),
        ([str(clip), "--at", "9s", *png], UsageError, r"--at 9s: .* ends at 1.99 s"),
        ([str(clip), "--png", "a.gif"], SinkError, r"a.gif: its name has to end in \.png"),
        ([str(clip), "--animation", "a.mp4"], SinkError, r"\.gif or \.webp or \.png"),
        ([str(clip), *png, "--animation", "a.gif"], UsageError, "one of them"),
        ([str(clip), *png, "--seconds", "2"], UsageError, "--seconds is for --animation"),
        ([str(clip), "--size", "64x64"], UsageError, "--size is for"),
        ([str(clip)], ViewError, "no display here.*--png F.png and --animation F.gif need none"),
    ]


def test_what_is_asked_for_in_vain_is_one_line(tmp_path: Path, clip: Path, monkeypatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    for argv, kind, words in wrong(tmp_path, clip):
        with pytest.raises(kind, match=words) as caught:
            main(argv)
        assert "\n" not in str(caught.value), argv
    assert not list(tmp_path.glob("*.png"))


@pytest.mark.parametrize(
    "options",
    [
        ["--at", "-1"],
        ["--size", "9x9"],
        ["--size", "big"],
        ["--fps", "0"],
        ["--fps", "51"],
        ["--at", "x"],
    ],
)
def test_values_that_cannot_be_meant_are_wrong_usage(options: list[str], capsys) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["a.c3d", *options])
    assert caught.value.code == 2
    assert f"argument {options[0]}: '{options[1]}'" in capsys.readouterr().err
