"""The view by what can be seen in it, and by what happens where it cannot be shown."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bridge.model import Model
from bridge.pose import Pose, Provenance
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkContext, SinkError, ViewError
from bridge.view import process
from bridge.view.scene import CYAN, GOLD, GREEN, GREY, ORANGE, WHITE, Camera, Scene
from bridge.view.snapshot import snapshot
from simulators.performer import load_performer
from tests.end_to_end.peers import wait_for

INFO = Model("default").info
TRUE = load_performer("walk").pose(40)
WIDTH, HEIGHT = 1280, 720


def pose(error: float = 0.0, provenance: dict[str, Provenance] | None = None) -> Pose:
    """The performer with every marker `error` metres aside."""
    kinds = np.full(len(INFO.labels), Provenance.ESTIMATED, np.uint8)
    for label in INFO.tracked:
        kinds[INFO.labels.index(label)] = Provenance.MEASURED
    for label, kind in (provenance or {}).items():
        kinds[INFO.labels.index(label)] = kind
    aside = np.float32([0, 0, error])
    return Pose(1, 0.0, TRUE + aside, kinds, np.full(len(kinds), 0.01, np.float32))


def picture(folder: Path, shown: Pose, truth: np.ndarray | None) -> np.ndarray:
    path = folder / "view.png"
    snapshot(path, INFO, shown, truth)
    assert [entry.name for entry in folder.iterdir()] == ["view.png"]
    pixels = np.asarray(Image.open(path))
    assert pixels.shape == (HEIGHT, WIDTH, 3)
    return pixels / 255


def like(pixels: np.ndarray, colour: tuple[float, float, float]) -> np.ndarray:
    """Where a picture has a colour, brighter or darker, (H, W)."""
    wanted = np.array(colour) / np.linalg.norm(colour)
    brightness = np.linalg.norm(pixels, axis=2)
    close = pixels @ wanted > 0.985 * np.maximum(brightness, 1e-6)
    return close & (brightness > 0.4)


def discs(pixels: np.ndarray, colour: tuple[float, float, float]) -> float:
    """How many discs' worth of flat pixels of exactly this colour there are below the meter."""
    flat = (np.abs(pixels - colour).max(axis=2) < 0.02)[160:]
    return float(flat.sum() / (np.pi * 8.5**2))


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    return picture(tmp_path_factory.mktemp("both"), pose(0.05), TRUE)


def test_the_true_body_is_gold_on_the_left_and_the_estimate_cyan_on_the_right(both) -> None:
    gold, cyan = like(both, GOLD)[160:], like(both, CYAN)[160:]
    assert gold.sum() > 2000
    assert cyan.sum() > 2000
    assert np.argwhere(gold)[:, 1].max() < WIDTH / 2 < np.argwhere(cyan)[:, 1].min()


def test_principal_markers_are_white_discs_and_the_origin_a_green_one(both) -> None:
    assert 4 < discs(both, WHITE) < 7  # of six, hidden ones and edges apart
    assert 0.5 < discs(both, GREEN) < 1.2


def test_the_whole_body_is_in_the_picture(both) -> None:
    for colour in (GOLD, CYAN):
        rows, columns = np.nonzero(like(both, colour))
        assert 20 < columns.min() < columns.max() < WIDTH - 20
        assert rows.max() < HEIGHT - 20
        assert rows.max() - rows[rows > 160].min() > HEIGHT / 2


def bar(pixels: np.ndarray) -> int:
    """Length of the meter's bar in pixels: what in its row is brighter than its track."""
    row = pixels[105, 434:846]
    return int((row.max(axis=1) > 0.5).sum())


def test_the_meter_shows_the_error_to_a_full_scale_of_200_mm(tmp_path, both) -> None:
    lengths = [bar(both)]
    for error in (0.1, 0.15, 0.4):
        folder = tmp_path / str(error)
        folder.mkdir()
        lengths.append(bar(picture(folder, pose(error), TRUE)))
    np.testing.assert_allclose(lengths, [103, 206, 309, 412], atol=4)


@pytest.mark.parametrize("error", [0.888, 8.888, 1e6])
def test_the_meter_has_room_for_any_error(error: float) -> None:
    scene = Scene(INFO.labels, INFO.principal)
    scene.update(pose(error), TRUE, Camera(*np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])))
    assert np.isfinite(scene.flat.points).all()


def test_without_a_truth_there_is_one_body_in_the_middle_and_no_meter(tmp_path) -> None:
    pixels = picture(tmp_path, pose(), None)
    assert not like(pixels, GOLD).any()
    columns = np.argwhere(like(pixels, CYAN))[:, 1]
    assert columns.min() < WIDTH / 2 < columns.max()
    assert bar(pixels) == 0


def test_imputed_and_lost_markers_have_their_colours(tmp_path) -> None:
    pixels = picture(
        tmp_path, pose(provenance={"LWRB": Provenance.IMPUTED, "RSHN": Provenance.LOST}), None
    )
    assert 0.5 < discs(pixels, ORANGE) < 1.3
    assert 0.3 < discs(pixels, GREY) < 1.3


def test_a_pose_with_nothing_known_is_drawn_as_nothing(tmp_path) -> None:
    nothing = np.full_like(TRUE, np.nan)
    lost = np.full(len(TRUE), Provenance.LOST, np.uint8)
    pixels = picture(tmp_path, Pose(0, 0.0, nothing, lost, nothing[:, 0]), None)
    assert not like(pixels, CYAN).any()


def test_a_picture_that_cannot_be_written_is_refused(tmp_path) -> None:
    with pytest.raises(SinkError, match=r"name ends in \.png"):
        snapshot(tmp_path / "view.gif", INFO, pose(), None)
    with pytest.raises(SinkError, match="no such folder"):
        snapshot(tmp_path / "no" / "view.png", INFO, pose(), None)


def test_without_open3d_one_line_says_what_to_install(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(process, "find_spec", lambda name: None)
    for call in (
        lambda: snapshot(tmp_path / "view.png", INFO, pose(), None),
        lambda: open_sink("view:", SinkContext(INFO, lambda index: None)),
    ):
        with pytest.raises(ViewError, match=r"pip install 'markerbridge\[view\]'") as caught:
            call()
        assert "\n" not in str(caught.value)


def lacks_a_library(connection: Connection) -> None:
    raise OSError("libGL.so.1: cannot open shared object file: No such file or directory")


def dies(connection: Connection) -> None:
    os.abort()


@pytest.mark.parametrize(
    ("target", "words"), [(lacks_a_library, r"libGL\.so\.1"), (dies, "its process ended with -6")]
)
def test_where_a_library_is_missing_one_line_says_which_packages(target, words) -> None:
    with pytest.raises(ViewError, match=words) as caught:
        process.start(target)
    assert "apt-get install libegl1 libgl1 libusb-1.0-0" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_a_display_there_is_no_window(monkeypatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    for _ in range(2):
        with pytest.raises(ViewError, match="no display here"):
            open_sink("view:", SinkContext(INFO, lambda index: None))
        monkeypatch.setenv("DISPLAY", ":4711")


@pytest.fixture
def display(monkeypatch, tmp_path) -> Iterator[str]:
    """A screen of its own."""
    assert shutil.which("Xvfb"), "install Debian's xvfb: the README's second command does"
    reader, writer = os.pipe()
    command = ["Xvfb", "-displayfd", str(writer), "-screen", "0", "1400x900x24"]
    with (tmp_path / "log").open("w") as log:
        server = subprocess.Popen(command, pass_fds=[writer], stderr=log)
    os.close(writer)
    with os.fdopen(reader) as number:
        name = f":{number.readline().strip()}"
    monkeypatch.setenv("DISPLAY", name)
    yield name
    server.terminate()
    server.wait()


def test_the_window_draws_what_it_is_given_and_ends_with_the_sink(display) -> None:
    sink = open_sink("view:", SinkContext(INFO, lambda index: TRUE))
    for _ in range(30):
        sink(pose())
    child = sink._process
    began = time.monotonic()
    sink.close()
    assert time.monotonic() - began < 5
    assert child.exitcode == 0
    sink.close()


def test_a_window_that_dies_ends_nothing_but_itself(display) -> None:
    sink = open_sink("view:", SinkContext(INFO, lambda index: TRUE))
    sink(pose())
    sink._process.kill()
    wait_for(lambda: not sink._process.is_alive(), "the window's end")
    with pytest.raises(ViewError, match="the session goes on without it"):
        sink(pose())
    sink.close()


def breaks(connection: Connection, labels: tuple[str, ...], principal: tuple[str, ...]) -> None:
    connection.send(process.READY)
    connection.recv()
    raise RuntimeError("the card is on fire")


def test_what_went_wrong_in_the_window_is_said(display, monkeypatch) -> None:
    monkeypatch.setattr("bridge.sinks.view.show", breaks)
    sink = open_sink("view:", SinkContext(INFO, lambda index: TRUE))
    sink(pose())
    wait_for(lambda: not sink._process.is_alive(), "the window's end")
    with pytest.raises(ViewError, match="RuntimeError: the card is on fire; the session goes on"):
        sink(pose())
    sink.close()
