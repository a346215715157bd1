"""Which moment the view shows, and what its keys do, without a window."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from bridge.pose import Pose
from bridge.view.camera import VIEWPOINTS
from bridge.view.controls import KEYS, Controls, Look, keys_of
from bridge.view.lettering import strokes, width
from bridge.view.player import KEPT, SPEEDS, LivePlayer, Moment, Player

LEFT, RIGHT, UP, DOWN, PAGE_UP, PAGE_DOWN, HOME, END, ESCAPE = (
    263,
    262,
    265,
    264,
    266,
    267,
    268,
    269,
    256,
)


def moment(index: int, rate: float = 120.0) -> Moment:
    nothing = np.zeros((1, 3), np.float32)
    return Moment(Pose(index, 50 + index / rate, nothing, np.zeros(1, np.uint8), nothing[0]), None)


def player(count: int = 241) -> Player:
    """Two seconds."""
    return Player([moment(index) for index in range(count)])


def shown(of: Player) -> int:
    assert of.moment
    return of.moment.pose.index


def test_a_recording_plays_at_its_own_pace_and_stops_at_its_end() -> None:
    tape = player()
    assert (shown(tape), tape.length) == (0, 2.0)
    for second, index in ((0.5, 60), (1.0, 180), (5.0, 240)):
        tape.advance(second)
        assert shown(tape) == index
    assert not tape.playing
    assert tape.seconds == tape.length
    tape.toggle()  # from the end: anew
    assert (shown(tape), tape.playing) == (0, True)


def test_a_pause_holds_and_steps_go_both_ways_and_no_further() -> None:
    tape = player()
    tape.advance(1.0)
    tape.toggle()
    tape.advance(0.5)
    assert shown(tape) == 120
    tape.step(1)
    assert shown(tape) == 121
    tape.step(-2)
    assert shown(tape) == 119
    tape.step(-1000)
    assert shown(tape) == 0
    tape.step(1000)
    assert shown(tape) == 240
    tape.step(-1)
    tape.toggle()
    tape.advance(0.001)
    assert (shown(tape), tape.playing) == (239, True)  # from where it was, not from the beginning


def test_the_speed_has_limits_and_counts() -> None:
    tape = player()
    tape.faster(-9)
    assert tape.speed == SPEEDS[0] == 0.25
    tape.advance(1.0)
    assert shown(tape) == 30
    tape.faster(9)
    assert tape.speed == SPEEDS[-1] == 4
    tape.advance(0.25)
    assert shown(tape) == 150


def test_gaps_in_a_recording_are_gaps_in_time() -> None:
    tape = Player([moment(0), moment(1), moment(241)])
    tape.advance(1.0)
    assert shown(tape) == 1
    tape.advance(1.1)
    assert shown(tape) == 241


def test_a_recording_of_one_moment_is_shown() -> None:
    tape = player(1)
    tape.advance(1.0)
    tape.step(1)
    tape.jump(-1)
    assert (shown(tape), tape.length, tape.trail()) == (0, 0.0, [])


def test_the_newest_of_what_comes_is_shown_and_a_pause_keeps_what_went_before() -> None:
    live = LivePlayer()
    assert live.moment is None
    live.step(1)
    for index in range(3 * KEPT):
        live.add(moment(index))
    assert shown(live) == 3 * KEPT - 1
    live.toggle()
    for index in range(3 * KEPT, 6 * KEPT):
        live.add(moment(index))
    assert shown(live) == 3 * KEPT - 1
    live.step(1)
    assert shown(live) == 3 * KEPT
    live.step(-10_000)
    assert shown(live) == 2 * KEPT
    live.step(10_000)
    assert shown(live) == 4 * KEPT - 2  # as much again
    live.toggle()
    live.add(moment(6 * KEPT))
    assert shown(live) == 6 * KEPT
    assert len(live.moments) == KEPT


@pytest.mark.parametrize("rate", [30.0, 60.0, 100.0, 120.0, 200.0, 500.0])
def test_a_trail_is_the_last_seconds_at_times_that_stay(rate: float) -> None:
    live = LivePlayer()
    before: set[int] = set()
    for index in range(1000):
        live.add(moment(index, rate))
        trail = [one.pose.index for one in live.trail()]
        if index:
            assert trail[0] == index
            assert trail == sorted(trail, reverse=True)
            assert (index - trail[-1]) / rate <= 3.0
        if index > 500:  # but for the newest, and those that have grown old, they are the same
            gone = before - set(trail) - {index - 1}
            assert all((index - old) / rate > 2.7 for old in gone)
        before = set(trail)
    assert len(before) > 20
    assert (index - min(before)) / rate == pytest.approx(min(3.0, KEPT / rate, 999 / rate), abs=0.1)


def controls() -> Controls:
    return Controls(Look(), player())


def test_every_key_is_there_once_and_can_be_written() -> None:
    codes = [code for key in KEYS for code in key.codes]
    assert len(codes) == len(set(codes))
    for letter in {letter for key in KEYS for letter in key.name + key.does} - {" "}:
        assert len(strokes(letter.upper())), letter
    for one, two in product("0123456789abcdefghijklmnopqrstuvwxyz", repeat=2):
        if one != two and {one, two} not in ({"0", "o"}, {"0", "q"}):
            first, second = strokes(one.upper()), strokes(two.upper())
            assert first.shape != second.shape or (first != second).any(), (one, two)
    assert strokes("~").size == strokes("").size == width("") == 0


@pytest.mark.parametrize(
    ("key", "name"),
    [("F", "follow"), ("O", "over"), ("B", "bones"), ("T", "trail"), ("U", "sigma"), ("H", "help")],
)
def test_switches_go_on_and_off_again(key: str, name: str) -> None:
    held = controls()
    before = getattr(held.look, name)
    held.press(ord(key))
    assert getattr(held.look, name) is not before
    held.press(ord(key))
    assert getattr(held.look, name) is before


def test_keys_move_through_a_recording() -> None:
    held = controls()
    for code, index in (
        (RIGHT, 1), (RIGHT, 2), (LEFT, 1), (UP, 121), (PAGE_UP, 240), (DOWN, 120),
        (PAGE_DOWN, 0), (END, 240), (HOME, 0),
    ):  # fmt: skip
        held.press(code)
        assert shown(held.player) == index, code
    held.press(ord(" "))
    assert held.player.playing
    held.press(ord(","))
    assert held.player.speed == 0.5
    held.press(ord("."))
    assert held.player.speed == 1


def test_keys_choose_a_view_ask_for_pictures_and_close() -> None:
    held = controls()
    for number, name in enumerate(VIEWPOINTS, 1):
        held.press(ord(str(number)))
        assert held.look.view == name
    held.press(ord("S"))
    assert held.wants_picture
    held.press(ord("R"))
    assert held.recording
    held.press(ord("R"))
    assert not held.recording
    assert not held.closed
    for code in (ord("Q"), ESCAPE):
        held.closed = False
        held.press(code)
        assert held.closed


def test_what_is_for_recordings_does_nothing_live_and_is_not_told() -> None:
    live = LivePlayer()
    for index in range(240):
        live.add(moment(index))
    held = Controls(Look(), live)
    for code in (UP, DOWN, PAGE_UP, PAGE_DOWN, HOME, END, ord(","), ord("."), 300, 0, -1):
        held.press(code)
        assert (shown(live), live.speed) == (239, 1)
    assert {key.does for key in KEYS} - {key.does for key in keys_of(live)} >= {"faster", "start"}
    held.press(LEFT)
    assert (shown(live), live.playing) == (238, False)


def test_the_document_tells_every_key() -> None:
    text = (Path(__file__).parents[2] / "docs/view.md").read_text()
    table = text[text.index("| key |") : text.index("Keys are places")]
    written = "".join(row.split("|")[1] for row in table.splitlines()[2:] if row)
    names = {"PgUp": "Page Up", "PgDn": "Page Down"}
    for key in KEYS:
        assert names.get(key.name, key.name) in written, key
