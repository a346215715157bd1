"""What a session shows of itself: dashboard, lines, summary; from sessions on virtual time."""

from __future__ import annotations

import io
import json
import logging
import re
import threading
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial

import numpy as np
import pytest
from rich.console import Console
from rich.text import Text

from bridge import terminal
from bridge.dashboard import WIDEST, Dashboard
from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.pose import Pose
from bridge.session import Session, Status
from bridge.sinks.sink import Sink, SinkContext
from bridge.statistics import MarkerStatus
from bridge.terminal import line, shown, summarise
from bridge.troubles import troubles
from drivers.clock import VirtualClock
from drivers.frame import Floats, Layout, MarkerFrame
from drivers.transport import memory_line
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire_source import WireSource
from tests.end_to_end.peers import wait_for

MODEL = Model("default")
TRACKED = MODEL.info.tracked
LAYOUT = Layout(TRACKED, 120.0)
STANDING = np.random.default_rng(0).normal(1, 0.2, (len(TRACKED), 3)).astype(np.float32)
TITLE = "markerbridge run serial:/dev/ttyUSB0"
Hidden = Callable[[int], tuple[int, ...]]  # of a frame's index: the markers that are missing


class Engine(Sink):
    """Keeps nothing; fails from a pose on."""

    name = "vmc://127.0.0.1:39539?rate=250"

    def __init__(self, until: int = 10**9) -> None:
        self._until = until

    def __call__(self, pose: Pose) -> None:
        if pose.index >= self._until:
            raise OSError("Network is unreachable")

    def close(self) -> None:
        pass


def played(frames: int, *sinks: Sink, hidden: Hidden = lambda _index: ()) -> Session:
    """A session that a device sent so many frames, in its own time; every hundredth is lost."""
    clock = VirtualClock()
    ours, device = memory_line(clock)
    encoder = CobsEncoder()
    device.send(encoder.encode_layout(LAYOUT))
    source = WireSource("serial:/dev/ttyUSB0", lambda: ours, CobsDecoder(), clock)
    context = SinkContext(MODEL.info, lambda _index: None)
    session = Session(source, PoseEstimator(MODEL), list(sinks), context, clock=clock)
    for index in range(frames):
        if index % 100 == 50:
            continue
        xyz: Floats = STANDING.copy()
        xyz[list(hidden(index))] = np.nan
        packet = encoder.encode_frame(index, index / 120, xyz)
        clock.call_at(index / 120, partial(device.send, packet))
    while (frame := source.read(0.2)) is not None:
        session.handle(frame)
    return session


@pytest.fixture(scope="module")
def troubled() -> tuple[Status, Status]:
    """A session with a marker away and a sink that fails, and how it was three seconds before."""
    before = played(600, Engine()).status()
    now = played(960, Engine(900), hidden=lambda index: (4,) if index >= 900 else ()).status()
    return before, now


@pytest.fixture(scope="module")
def healthy() -> Status:
    return played(480, Engine()).status()


def drawn(dashboard: Dashboard, width: int, height: int) -> list[str]:
    file = io.StringIO()
    Console(file=file, width=width, height=height, color_system=None).print(dashboard)
    return file.getvalue().splitlines()


@pytest.mark.parametrize(
    ("width", "height"), [(80, 24), (120, 40), (60, 15), (40, 12), (24, 5), (300, 60)]
)
def test_the_dashboard_fits_and_what_matters_most_is_there(troubled, width, height) -> None:
    before, status = troubled
    lines = drawn(Dashboard(TITLE, status, before), width, height)
    assert len(lines) <= height
    assert max(map(len, lines)) <= min(width, WIDEST)
    assert lines[0].rstrip().endswith("SINK FAILS  0:00:08")
    assert lines[-1].strip() == ""
    shown_text = " ".join(" ".join(lines).split())
    if width >= 40:
        assert "vmc://127.0.0.1:39539: Network is unreachable" in shown_text
        assert "118.5 Hz" in shown_text
        assert f"{len(TRACKED) - 1} of {len(TRACKED)}" in shown_text
    if width >= 60:
        for words in ("line", "queue", "pose", "vmc://", f" {TRACKED[4]} ", "0.7 s"):
            assert words in shown_text
    if width >= 80:
        assert re.search(rf"{TRACKED[4]} (0\.7 s )?6\.2%", shown_text)
        assert "59 failed, last: Network is unreachable" in shown_text
        assert "10 missing (1.3/s)" in shown_text


def test_a_healthy_session_has_no_troubles(healthy) -> None:
    assert troubles(healthy, None) == []
    lines = drawn(Dashboard(TITLE, healthy, None), 80, 24)
    assert lines[0].split() == [
        *("run", "serial:/dev/ttyUSB0,", "model", "default", "RUNNING", "0:00:04")
    ]
    assert "SINK" not in " ".join(lines)
    assert "nothing so far" in " ".join(lines)


def test_a_stream_that_begins_anew_is_no_slow_one() -> None:
    session = played(480)
    began = session.status().seconds + 3.0
    for index in range(20):
        session._clock.sleep_until(began + index / 120)
        t = session._clock.now()
        session.handle(MarkerFrame(1000 + index, t, t, LAYOUT, STANDING))
    status = session.status()
    assert status.rate == pytest.approx(120, rel=0.01)
    assert troubles(status, status) == []


def changed(status: Status, **counters: int) -> Status:
    return replace(status, source=status.source | counters)


@pytest.mark.parametrize(
    ("change", "state", "words"),
    [
        (lambda at: changed(replace(at, silent=2.0), disconnects=1), "line lost", "for 2 s"),
        (lambda at: replace(at, silent=4.2), "no data", "no frame for 4 s: nothing comes"),
        (
            lambda at: changed(replace(at, silent=4.0), bytes=at.source["bytes"] + 5000),
            "no data",
            "though 5,000 bytes came: `markerbridge doctor` tells why",
        ),
        (
            lambda at: changed(replace(at, silent=4.0), refused=360),
            "no data",
            "though 360 packets came, of senders that the option allow does not name",
        ),
        (lambda at: replace(at, rate=96.0), "frames lost", "only 96 of 120 frames a second"),
        (lambda at: changed(at, fifo_overflow=7), "too slow", "7 frames were dropped"),
        (
            lambda at: replace(
                at, markers={label: MarkerStatus("lost", 1.0, 9) for label in at.markers}
            ),
            "no pose",
            "too few tracked markers",
        ),
        (
            lambda at: replace(
                at,
                markers=at.markers | {TRACKED[2]: MarkerStatus("imputed", at.seconds, at.frames)},
            ),
            "marker lost",
            f"not seen so far: {TRACKED[2]}",
        ),
        (
            lambda at: replace(
                at, sinks={name: sink | {"dropped": 50} for name, sink in at.sinks.items()}
            ),
            "sink slow",
            "does not keep up: 50 poses were dropped",
        ),
    ],
)
def test_what_is_wrong_is_told_in_plain_words_while_it_lasts(healthy, change, state, words) -> None:
    now = change(healthy)
    (trouble,) = troubles(now, healthy)
    assert trouble.state == state
    assert words in trouble.words
    lines = drawn(Dashboard(TITLE, now, healthy), 80, 24)
    assert state.upper() in lines[0]
    assert words in " ".join(" ".join(lines).split())
    # What has only been is none any more, what goes on is.
    later = troubles(now, now)
    assert bool(later) == (
        state in ("line lost", "no data", "frames lost", "no pose", "marker lost")
    )


def test_the_gravest_trouble_is_on_top(troubled) -> None:
    before, status = troubled
    first, second = troubles(replace(status, silent=4.0), before)
    assert (first.state, second.state) == ("no data", "sink fails")


def test_markers_that_are_not_those_of_now_are_not_shown_as_if_they_were(healthy) -> None:
    lines = drawn(Dashboard(TITLE, replace(healthy, silent=5.0), None), 80, 24)
    assert f"- of {len(TRACKED)}" in " ".join(lines)


def test_all_of_it_is_in_the_json(troubled) -> None:
    _, status = troubled
    found = json.loads(json.dumps(asdict(status)))
    assert found["markers"][TRACKED[4]] == {
        "state": "imputed",
        "seconds": pytest.approx(0.5 + 0.2, abs=0.01),  # and the time until it was asked
        "missing": 59,
    }
    (sink,) = found["sinks"].values()
    assert (sink["sent"], sink["errors"]) == (891, 59)
    assert sink["last_error"] == "Network is unreachable"
    assert set(sink["age"]) == {"count", "now", "worst", "p50", "p99", "max"}
    assert set(found["ages"]) == {"delay", "parse", "queue", "estimate"}


def test_a_line_is_short_and_tells_what_matters(troubled, healthy) -> None:
    before, status = troubled
    told = line(status, before)
    assert len(told) <= 165
    assert "vmc://127.0.0.1:39539: Network is unreachable" in told
    assert f"without {TRACKED[4]}" in told
    told = line(healthy)
    assert re.fullmatch(
        r"\d\d:\d\d:\d\d poses 475 at 118\.5 of 120 Hz \| age 0\.00 ms, p99 0\.00 ms "
        rf"\| all {len(TRACKED)} markers \| frames lost 5",
        told,
    )


class Tty(io.StringIO):
    """A terminal that keeps what is written to it."""

    def isatty(self) -> bool:
        return True

    def screen(self) -> list[str]:
        """What can be read on it in the end, with all that has scrolled off."""
        rows, at, column = [""], 0, 0
        for control, word, text in re.findall(
            r"\x1b\[\??([\d;]*)([A-Za-z])|([^\x1b])", self.getvalue()
        ):
            if word == "A":
                at = max(0, at - int(control or 1))
            elif word == "K":
                rows[at] = ""
            elif text == "\r":
                column = 0
            elif text == "\n":
                at, column = at + 1, 0
                rows += [""] * (at == len(rows))
            elif text:
                rows[at] = rows[at][:column].ljust(column) + text + rows[at][column + 1 :]
                column += 1
        return [row.rstrip() for row in rows]


@pytest.fixture
def logging_kept():
    """`log_to` is for a process of its own."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


def test_log_lines_do_not_tear_the_dashboard(troubled, monkeypatch, logging_kept) -> None:
    monkeypatch.setattr(terminal, "LIVE_EVERY", 0.002)
    file = Tty()
    console = Console(file=file, width=80, height=24, force_terminal=True, color_system="standard")
    terminal.log_to(console)
    draws = threading.Semaphore(0)

    def status() -> Status:
        draws.release()
        return troubled[1]

    with shown(console, status, TITLE):
        for number in range(20):
            for _ in range(2):
                assert draws.acquire(timeout=10)
            logging.getLogger("bridge.watch").warning("line %d is lost", number)
    assert [row.split("WARNING")[1].strip() for row in file.screen() if row] == [
        f"line {number} is lost" for number in range(20)
    ]
    summarise(console, troubled[1], f"{TITLE}: ended")
    rows = file.screen()
    assert sum("AGE IN MS" in row for row in rows) == 1
    assert any("serial:/dev/ttyUSB0: ended" in row for row in rows)


def test_a_terminal_whose_size_changes_is_cleared_of_what_it_broke_anew(troubled, monkeypatch):
    monkeypatch.setattr(terminal, "LIVE_EVERY", 0.002)
    file = Tty()
    console = Console(file=file, width=100, height=24, force_terminal=True)
    drawn: list[str] = []  # up to each time that it was cleared, and since

    def complete(times: int) -> bool:
        drawn[:] = file.getvalue().split("\x1b[2J")
        return len(drawn) > times and "RUNNING" in drawn[times]

    with shown(console, lambda: troubled[1], TITLE):
        for times, width in enumerate((100, 60, 80)):
            console.width = width
            wait_for(partial(complete, times), f"a screen {width} wide")
    assert len(drawn) == 3


def test_a_session_of_which_nothing_could_be_read_says_so_at_its_end(healthy) -> None:
    nothing = replace(
        healthy, frames=0, silent=9.0, markers={}, source={"bytes": 8061, "fifo_overflow": 0}
    )
    for file in (io.StringIO(), Tty()):
        console = Console(file=file, width=120, force_terminal=file.isatty())
        summarise(console, nothing, f"{TITLE}: ended")
        assert "though 8,061 bytes came: `markerbridge doctor` tells why" in file.getvalue()


@pytest.mark.parametrize("forced", [False, True])
def test_in_a_pipe_there_are_plain_lines_and_nothing_else(troubled, monkeypatch, forced) -> None:
    """Even where the environment asks for colours, as that of many build servers does."""
    if forced:
        monkeypatch.setenv("FORCE_COLOR", "1")
    file = io.StringIO()
    console = Console(file=file, width=80)
    told = threading.Event()

    def status() -> Status:
        if file.getvalue().count("\n") >= 2:
            told.set()
        return troubled[1]

    with shown(console, status, TITLE, line_every=0.002):
        assert told.wait(10)
    summarise(console, troubled[1], f"{TITLE}: ended")
    lines = file.getvalue().splitlines()
    first = next(at for at, row in enumerate(lines) if row.startswith(TITLE))
    assert first >= 2
    assert all(re.match(r"\d\d:\d\d:\d\d ", row) for row in lines[:first])
    text = "\n".join(lines[first:])
    assert "\x1b" not in file.getvalue()
    for words in (
        "  frames in: 950, 10 never came",
        "  poses out: 950",
        f"  markers imputed: 59, 0.06 a frame: {TRACKED[4]} 6.2% of the time",
        "891 poses, 59 failed (the last: Network is unreachable), age p50 0.00 ms",
    ):
        assert words in text


def test_without_colours_and_without_odd_letters_it_says_the_same(troubled, monkeypatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    raw = io.BytesIO()
    file = io.TextIOWrapper(raw, "ascii")  # refuses what is none
    console = Console(file=file, width=120, height=40, force_terminal=True)
    console.print(Dashboard(f"{TITLE}/a-long-path" * 5, troubled[1], troubled[0]))
    file.flush()
    text = raw.getvalue().decode()
    assert not re.search(r"\x1b\[[\d;]*[34]\d", text)  # bold, faint and reverse alone
    plain = Text.from_ansi(text).plain
    assert "SINK FAILS" in plain
    assert re.search(rf" {TRACKED[4]} +0\.7 s", plain)
    assert "#" in plain
