"""The view by what can be seen in it, and by what happens where it cannot be shown."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bridge.model import Model
from bridge.pose import Pose, Provenance
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkClosed, SinkContext, SinkError, ViewError
from bridge.view import camera as view_camera
from bridge.view import process
from bridge.view.camera import DEFAULT, VIEWPOINTS, looking
from bridge.view.colours import (
    CYAN,
    GOLD,
    GREEN,
    GREY,
    ICE,
    ORANGE,
    PALE,
    WHITE,
)
from bridge.view.controls import Controls, Look
from bridge.view.panel import Panel
from bridge.view.player import Moment, Player
from bridge.view.scene import Scene, Worn
from bridge.view.sheet import Sheet
from bridge.view.snapshot import snapshot
from drivers.frame import Floats
from simulators.performer import load_performer
from tests.bridge.display import press, screen
from tests.end_to_end.peers import wait_for

INFO = Model("default").info
WORN = Worn.of(INFO)
WALKER = load_performer("walk")
TRUE = WALKER.pose(40)
WIDTH, HEIGHT = 1280, 720
PLAIN = Look(help=False, sigma=False, trail=False)
_AT = VIEWPOINTS[DEFAULT]
SEEN = view_camera.Camera.of(looking(_AT.eye, _AT.aim), WIDTH / HEIGHT)
BODY = slice(160, 660)  # rows of the picture between the meter and the time

Pixels = np.ndarray
Camera = Callable[..., Pixels]


def pose(
    error: float = 0.0,
    provenance: dict[str, Provenance] | None = None,
    *,
    xyz: Floats = TRUE,
    sigma: float = 0.0,
) -> Pose:
    """The performer with every marker `error` metres aside."""
    kinds = np.full(len(INFO.labels), Provenance.ESTIMATED, np.uint8)
    for label in INFO.tracked:
        kinds[INFO.labels.index(label)] = Provenance.MEASURED
    for label, kind in (provenance or {}).items():
        kinds[INFO.labels.index(label)] = kind
    aside = np.float32([0, 0, error])
    return Pose(1, 0.0, xyz + aside, kinds, np.full(len(kinds), sigma, np.float32))


def draw(connection: Connection) -> None:
    """A hidden window that draws what it is asked for: the view's process, for many pictures."""
    from bridge.view.viewer import Viewer

    viewers: dict[Worn, Viewer] = {}
    connection.send(process.READY)
    while True:
        worn, moments, index, look, keys = connection.recv()
        if worn not in viewers:
            viewers[worn] = Viewer(INFO, worn, Player([]), visible=False)
        viewer = viewers[worn]
        if index == 0:
            # Nothing goes on from the picture before.
            viewer._scene._last, viewer._scene._beside = None, False
        viewer.controls.look = look
        player = viewer.controls.player
        player.moments, player.playing = moments, True
        player.seek(moments[index].pose.t - moments[0].pose.t)
        for key in keys:
            viewer.controls.press(ord(key))
        viewer.draw()
        connection.send(viewer.picture())


@pytest.fixture(scope="module")
def camera() -> Iterator[Camera]:
    child, connection = process.start(draw)

    def take(
        shown: Pose | list[Moment],
        truth: Floats | None = None,
        look: Look = PLAIN,
        *,
        worn: Worn = WORN,
        keys: str = "",
        index: int = 0,
    ) -> Pixels:
        moments = [Moment(shown, truth)] if isinstance(shown, Pose) else shown
        connection.send((worn, moments, index, look, keys))
        return process.hear(child, connection) / 255

    yield take
    process.stop(child, connection)


def read(path: Path) -> Pixels:
    with Image.open(path) as image:
        return np.asarray(image) / 255


def like(pixels: Pixels, colour: tuple[float, float, float]) -> np.ndarray:
    """Where a picture has a colour, brighter or darker, between meter and time, (H, W)."""
    wanted = np.array(colour) / np.linalg.norm(colour)
    brightness = np.linalg.norm(pixels, axis=2)
    close = pixels @ wanted > 0.985 * np.maximum(brightness, 1e-6)
    close &= brightness > 0.4
    close[: BODY.start] = close[BODY.stop :] = False
    close[:, :200] = False  # what the colours mean
    return close


def discs(pixels: Pixels, colour: tuple[float, float, float]) -> float:
    """How many discs' worth of flat pixels of exactly this colour there are on the bodies."""
    flat = (np.abs(pixels - colour).max(axis=2) < 0.02)[BODY, 200:]
    return float(flat.sum() / (np.pi * 7.8**2))


def written(pixels: Pixels, rows: slice, columns: slice = slice(None)) -> int:
    """How many pixels there are as bright as writing."""
    return int((pixels[rows, columns].min(axis=2) > 0.4).sum())


@pytest.fixture(scope="module")
def both(camera: Camera) -> Pixels:
    return camera(pose(0.05), TRUE)


@pytest.fixture(scope="module")
def alone(camera: Camera) -> Pixels:
    return camera(pose())


def test_the_true_body_is_gold_on_the_left_and_the_estimate_cyan_on_the_right(both: Pixels) -> None:
    gold, cyan = like(both, GOLD), like(both, CYAN)
    assert gold.sum() > 2000
    assert cyan.sum() > 2000
    assert np.argwhere(gold)[:, 1].max() < WIDTH / 2 < np.argwhere(cyan)[:, 1].min()


def test_the_true_body_may_be_over_the_estimate(camera: Camera) -> None:
    pixels = camera(pose(0.05), TRUE, replace(PLAIN, over=True))
    gold, cyan = np.argwhere(like(pixels, GOLD))[:, 1], np.argwhere(like(pixels, CYAN))[:, 1]
    assert abs(gold.mean() - cyan.mean()) < 20


def test_principal_markers_are_white_discs_references_pale_and_the_origin_green(both) -> None:
    assert 4 < discs(both, WHITE) < 7  # of six, hidden ones and edges apart
    assert 1.3 < discs(both, PALE) < 2.3
    assert 0.5 < discs(both, GREEN) < 1.2


def test_who_wears_no_c7_has_the_origin_between_the_shoulders(camera: Camera) -> None:
    shoulders = ("LSHO", "RSHO")
    worn = Worn.among(("LWRB", "RWRB", "LANK", "RANK", *shoulders))
    assert worn == Worn(("LWRB", "RWRB", "LANK", "RANK"), shoulders, shoulders)
    pixels = camera(pose(), worn=worn)
    assert 0.5 < discs(pixels, GREEN) < 1.2
    assert 1.3 < discs(pixels, PALE) < 2.3
    row, column = np.argwhere(np.abs(pixels - GREEN).max(axis=2)[:, 200:] < 0.02).mean(axis=0)
    pale = np.argwhere(np.abs(pixels - PALE).max(axis=2)[:, 200:] < 0.02)
    assert pale[:, 1].min() < column < pale[:, 1].max()
    assert pale[:, 0].min() - 5 < row < pale[:, 0].max() + 5


def test_a_capture_without_a_model_has_no_discs(camera: Camera) -> None:
    kinds = dict.fromkeys(INFO.labels, Provenance.MEASURED)
    pixels = camera(pose(provenance=kinds), worn=Worn())
    assert discs(pixels, GREEN) == discs(pixels, PALE) == 0
    assert like(pixels, ICE).sum() > 2000  # spheres


def test_the_whole_body_is_in_the_picture(both: Pixels) -> None:
    for colour in (GOLD, CYAN):
        rows, columns = np.nonzero(like(both, colour))
        assert 220 < columns.min() < columns.max() < WIDTH - 20
        assert rows.min() > BODY.start + 10
        assert rows.max() < BODY.stop - 10
        assert rows.max() - rows.min() > HEIGHT / 2


def bar(pixels: Pixels) -> int:
    """Length of the meter's bar in pixels: what in its row is brighter than its track."""
    row = pixels[105, 434:846]
    return int((row.max(axis=1) > 0.5).sum())


def test_the_meter_shows_the_error_to_a_full_scale_of_200_mm(camera: Camera) -> None:
    lengths = [bar(camera(pose(error), TRUE)) for error in (0.05, 0.15, 0.4)]
    np.testing.assert_allclose(lengths, [103, 309, 412], atol=4)


@pytest.mark.parametrize("error", [8.888, 1e6])
def test_the_meter_has_room_for_any_error(camera: Camera, error: float) -> None:
    assert bar(camera(pose(error), TRUE)) > 400


def test_without_a_truth_there_is_one_body_in_the_middle_and_no_meter(alone: Pixels) -> None:
    assert not like(alone, GOLD).any()
    columns = np.argwhere(like(alone, CYAN))[:, 1]
    assert columns.min() < WIDTH / 2 < columns.max()
    assert bar(alone) == 0


def test_imputed_and_lost_markers_have_their_colours(camera: Camera, alone: Pixels) -> None:
    kinds = {"LWRB": Provenance.IMPUTED, "RSHN": Provenance.LOST}
    pixels = camera(pose(provenance=kinds))
    assert 0.5 < discs(pixels, ORANGE) < 1.3
    assert 0.3 < discs(pixels, GREY) < 1.3
    before = alone
    unworn = camera(pose(provenance={"LKNE": Provenance.IMPUTED}))
    assert like(unworn, ORANGE).sum() > like(before, ORANGE).sum() + 60  # without a disc as well


def test_an_origin_that_is_not_measured_is_not_green(camera: Camera) -> None:
    pixels = camera(pose(provenance={"C7": Provenance.IMPUTED}))
    assert discs(pixels, GREEN) == 0
    assert discs(pixels, ORANGE) > 0.5


def test_the_less_sure_a_marker_is_the_larger_it_is_within_limits(camera: Camera) -> None:
    look = replace(PLAIN, sigma=True)
    sizes = [like(camera(pose(sigma=s), None, look), CYAN).sum() for s in (0.0, 0.03, 0.06, 5.0)]
    assert sizes[0] < 0.9 * sizes[1] < 0.81 * sizes[2]
    assert sizes[3] < 1.6 * sizes[2]
    assert like(camera(pose(sigma=0.06), None, PLAIN), CYAN).sum() == sizes[0]


def test_a_pose_with_nothing_known_is_drawn_as_nothing(camera: Camera) -> None:
    nothing = np.full_like(TRUE, np.nan)
    lost = np.full(len(TRUE), Provenance.LOST, np.uint8)
    shown = Pose(0, 0.0, nothing, lost, np.full(len(TRUE), np.inf, np.float32))
    for look in (PLAIN, Look(bones=True)):
        assert not like(camera(shown, nothing, look), CYAN).any()


def test_part_of_a_body_is_drawn(camera: Camera, alone: Pixels) -> None:
    half = TRUE.copy()
    half[: len(half) // 2] = np.nan
    whole = like(alone, CYAN).sum()
    assert 0.2 * whole < like(camera(pose(xyz=half)), CYAN).sum() < 0.8 * whole


def test_keys_turn_the_body_to_its_front_its_side_and_its_top(
    camera: Camera, alone: Pixels
) -> None:
    front, side, top = (like(camera(pose(), keys=key), CYAN) for key in "123")
    widths = [np.ptp(np.nonzero(mask)[1]) for mask in (front, side)]
    heights = [np.ptp(np.nonzero(mask)[0]) for mask in (front, top)]
    assert widths[0] != widths[1]
    assert heights[1] < heights[0] / 2
    three_quarter = like(camera(pose(), keys="14"), CYAN)
    np.testing.assert_array_equal(three_quarter, like(alone, CYAN))


def walk(count: int, step: float = 1 / 120) -> list[Moment]:
    return [
        Moment(replace(pose(xyz=WALKER.pose(index)), index=index, t=index * step), None)
        for index in range(count)
    ]


def test_the_camera_goes_with_the_body_unless_it_is_to_stand(camera: Camera) -> None:
    moments = walk(2)
    away = moments[1].pose.xyz + np.float32([0.8, 0.8, 0])
    moments[1] = Moment(replace(moments[1].pose, xyz=away, t=0.4), None)
    middle = []
    for follow in (True, False):
        look = replace(PLAIN, follow=follow)
        camera(moments, look=look, index=0, keys="4")
        pixels = camera(moments, look=look, index=1)
        middle.append(np.argwhere(like(pixels, CYAN)).mean(axis=0))
    assert np.linalg.norm(middle[1] - middle[0]) > 50


def test_a_camera_that_stood_goes_to_the_body_though_it_is_paused(camera: Camera) -> None:
    moments = walk(2)
    away = moments[1].pose.xyz + np.float32([0.8, 0.8, 0])
    moments[1] = Moment(replace(moments[1].pose, xyz=away, t=0.4), None)
    shown = [(0, False), (1, False), (1, True)]  # the last two at the same moment
    drawn = [camera(moments, look=replace(PLAIN, follow=on), index=at) for at, on in shown]
    first, stood, followed = (np.nonzero(like(pixels, CYAN))[1].mean() for pixels in drawn)
    assert abs(stood - first) > 60
    assert abs(followed - first) < 20


def test_a_true_pose_that_is_missing_moves_nobody(camera: Camera) -> None:
    with_truth, without = Moment(pose(0.05), TRUE), Moment(replace(pose(0.05), t=3.0), None)
    places = []
    for index in (0, 1):
        pixels = camera([with_truth, without], index=index)
        places.append(np.argwhere(like(pixels, CYAN)).mean(axis=0))
        assert like(pixels, GOLD).any() == (index == 0)
    np.testing.assert_allclose(*places, atol=1)


def test_the_error_of_a_moment_that_is_paused_is_its_own() -> None:
    scene = Scene(INFO, WORN)
    for error, t, playing, told in (
        (0.02, 0.00, True, 20.0),
        (0.12, 0.01, True, 26.4),  # a little smoothed
        (0.12, 0.01, False, 120.0),
        (0.02, 0.02, False, 20.0),
    ):
        scene.update(Moment(replace(pose(error), t=t), TRUE), [], PLAIN, SEEN, playing=playing)
        assert scene.error == pytest.approx(told, rel=0.02)


def test_the_trail_shows_where_hips_and_feet_went(camera: Camera) -> None:
    moments = walk(240)
    look = replace(PLAIN, trail=True, view="side")
    drawn, off = (camera(moments, look=look, index=-1, keys=keys) for keys in ("", "T"))
    changed = np.abs(drawn - off).max(axis=2) > 0.05
    assert changed[BODY].sum() > 500
    assert not changed[: BODY.start].any()


def test_bones_take_the_place_of_sticks_where_the_whole_body_is_known(
    camera: Camera, alone: Pixels
) -> None:
    sticks, bones = alone, camera(pose(), keys="B")
    changed = np.abs(sticks - bones).max(axis=2) > 0.05
    assert changed[BODY].sum() > 3000
    assert like(bones, CYAN).sum() > 2000
    part = pose(xyz=np.where(np.arange(41)[:, None] == 9, np.float32(np.nan), TRUE))
    np.testing.assert_array_equal(camera(part), camera(part, keys="B"))


def test_the_keys_are_told_until_they_are_hidden(camera: Camera, alone: Pixels) -> None:
    told = camera(pose(), look=Look(), keys="")
    hidden = camera(pose(), look=Look(), keys="H")
    bottom = slice(HEIGHT - 70, HEIGHT)
    assert written(told, bottom) > 2000
    assert written(hidden, bottom) == written(alone, bottom) < 100


def test_a_note_stands_on_nothing_else() -> None:
    player = Player([Moment(pose(), TRUE)])
    controls = Controls(Look(follow=False), player)
    player.step(1)
    areas = []
    for note in ("", "saved markerbridge-2026-01-01-10.00.00.png"):
        sheet = Sheet()
        panel = Panel(sheet, WORN)
        panel.note = note
        panel.update(player.moment, 50.0, controls, SEEN)
        areas.append(
            [
                np.ravel([quads.min((0, 1)), quads.max((0, 1))])
                for quads in sheet._quads
                if len(quads)
            ]
        )
    others = np.array(areas[0])
    (new,) = (area for area in areas[1] if not (area == others).all(axis=1).any())
    apart = (new[2:] < others[:, :2]) | (others[:, 2:] < new[:2])
    assert apart.any(axis=1).all()


def test_a_bar_shows_where_a_recording_is(camera: Camera) -> None:
    moments = walk(121)
    shares = [
        written(camera(moments, index=index), slice(693, 694)) / (WIDTH - 44)
        for index in (0, 60, 120)
    ]
    np.testing.assert_allclose(shares, [0.0, 0.5, 1.0], atol=0.02)


def test_a_snapshot_is_the_same_picture_finer(tmp_path: Path, both: Pixels) -> None:
    path = tmp_path / "view.png"
    snapshot(path, INFO, pose(0.05), TRUE)
    assert [entry.name for entry in tmp_path.iterdir()] == ["view.png"]
    pixels = read(path)
    assert pixels.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(pixels - both).mean() < 0.01


def test_a_picture_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SinkError, match=r"name has to end in \.png"):
        snapshot(tmp_path / "view.gif", INFO, pose(), None)
    with pytest.raises(SinkError, match="no such folder"):
        snapshot(tmp_path / "no" / "view.png", INFO, pose(), None)


@pytest.mark.parametrize("missing", ["open3d", "PIL"])
def test_without_its_libraries_one_line_says_what_to_install(
    monkeypatch, tmp_path, missing: str
) -> None:
    monkeypatch.setattr(process, "find_spec", lambda name: None if name == missing else True)
    for call in (
        lambda: snapshot(tmp_path / "view.png", INFO, pose(), None),
        lambda: open_sink("view:", SinkContext(INFO, lambda index: None)),
    ):
        with pytest.raises(ViewError, match=r"pip install 'markerbridge\[view\]'") as caught:
            call()
        assert "\n" not in str(caught.value)


def test_who_has_no_view_needs_nothing_of_it() -> None:
    lacking = "import sys; sys.modules.update(dict.fromkeys(('open3d', 'PIL')))"
    modules = "bridge.sinks.view, bridge.view.command, bridge.view.snapshot, bridge.demo"
    subprocess.run([sys.executable, "-c", f"{lacking}; import {modules}"], check=True)


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
    for display, wayland, words in (
        (None, None, "DISPLAY is not set"),
        (":4711", None, "nobody answers"),
        (None, "wayland-0", "apt-get install xwayland"),
    ):
        for name, value in (("DISPLAY", display), ("WAYLAND_DISPLAY", wayland)):
            monkeypatch.delenv(name, raising=False)
            if value:
                monkeypatch.setenv(name, value)
        with pytest.raises(ViewError, match="no display here.*" + words):
            open_sink("view:", SinkContext(INFO, lambda index: None))


@pytest.fixture(scope="module")
def module_screen() -> Iterator[str]:
    with screen() as name:
        yield name


@pytest.fixture
def display(module_screen: str, monkeypatch) -> str:
    monkeypatch.setenv("DISPLAY", module_screen)
    return module_screen


def press_until(display: str, key: str, done: Callable[[], object]) -> None:
    """A key, until it has done its work: a window that has just opened has no focus yet."""
    for _ in range(20):
        press(display, key)
        deadline = time.monotonic() + 1.0
        while time.monotonic() < deadline:
            if done():
                return
            time.sleep(0.02)
    raise AssertionError(f"key {key} does nothing")


def test_the_window_draws_obeys_the_keys_and_ends_with_the_sink(
    display: str, monkeypatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    sink = open_sink("view:", SinkContext(INFO, lambda index: TRUE))
    send(sink, 30)
    press_until(display, "s", lambda: list(tmp_path.glob("markerbridge-*.png")))
    path = min(tmp_path.glob("markerbridge-*.png"))
    assert like(read(path), GOLD).sum() > 2000
    child = sink._process
    began = time.monotonic()
    sink.close()
    assert time.monotonic() - began < 5
    assert child.exitcode == 0
    sink.close()


def test_a_window_that_hangs_or_is_closed_ends_nothing_but_itself(
    display: str, monkeypatch
) -> None:
    monkeypatch.setattr("bridge.sinks.view.HANGS", 0.1)
    sink = open_sink("view:", SinkContext(INFO, lambda index: TRUE))
    sink(pose())
    os.kill(sink._process.pid, signal.SIGSTOP)
    began = time.monotonic()
    with pytest.raises(ViewError, match="the window hangs; the session goes on without it"):
        send(sink, 1000)
    assert time.monotonic() - began < 3
    os.kill(sink._process.pid, signal.SIGCONT)
    wait_for(lambda: sent(sink), "the window to draw again")
    press_until(display, "q", lambda: not sink._process.is_alive())
    with pytest.raises(SinkClosed, match="the window was closed; the session goes on without it"):
        sink(pose())
    sink.close()


def send(sink, count: int) -> None:
    for index in range(count):
        sink(replace(pose(), index=index))


def sent(sink) -> bool:
    try:
        send(sink, 1)
    except ViewError:
        return False
    return True


def hangs(connection: Connection, info: object) -> None:
    connection.send(process.READY)
    os.kill(os.getpid(), signal.SIGSTOP)


def test_a_window_that_hangs_does_not_hold_up_the_end(display: str, monkeypatch) -> None:
    monkeypatch.setattr("bridge.sinks.view.HANGS", 0.1)
    monkeypatch.setattr("bridge.sinks.view.show", hangs)
    sink = open_sink("view:", SinkContext(INFO, lambda index: TRUE))
    with pytest.raises(ViewError, match="hangs"):
        send(sink, 1000)
    monkeypatch.setattr("bridge.sinks.view.HANGS", 60.0)
    began = time.monotonic()
    with pytest.raises(ViewError, match="hangs"):  # it is not waited for once more
        sink(pose())
    sink.close()
    assert time.monotonic() - began < 1


def tells(connection: Connection, info: object) -> None:
    """Which true poses came, once a pose without a number does."""
    connection.send(process.READY)
    known = []
    while (came := connection.recv())[0].index >= 0:
        known.append(came[1] is not None)
    raise SinkError(f"{known}")


def test_of_a_pose_that_is_lost_nobody_knows_what_is_true(display: str, monkeypatch) -> None:
    monkeypatch.setattr("bridge.sinks.view.show", tells)
    sink = open_sink("view:", SinkContext(INFO, lambda index: TRUE))
    for index, t in ((1, 0.1), (2, 0.2), (2, 1.3), (2, 1.4), (3, 1.5), (-1, 1.6)):
        sink(replace(pose(), index=index, t=t))
    with pytest.raises(SinkError, match=r"\[True, True, False, False, True\]"):
        process.hear(sink._process, sink._connection)
    sink.close()


def breaks(connection: Connection, info: object) -> None:
    connection.send(process.READY)
    connection.recv()
    raise RuntimeError("the card is on fire")


def test_what_went_wrong_in_the_window_is_said(display: str, monkeypatch) -> None:
    monkeypatch.setattr("bridge.sinks.view.show", breaks)
    sink = open_sink("view:", SinkContext(INFO, lambda index: TRUE))
    sink(pose())
    wait_for(lambda: not sink._process.is_alive(), "the window's end")
    with pytest.raises(ViewError, match="RuntimeError: the card is on fire; the session goes on"):
        sink(pose())
    sink.close()
