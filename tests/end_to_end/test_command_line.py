"""The command as a user meets it: exit statuses, and errors in one readable line."""

from __future__ import annotations

import contextlib
import json
import logging
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from pythonosc.osc_message_builder import OscMessageBuilder

from bridge.cli import main
from bridge.model import Model
from drivers.c3d_file import read_c3d
from tests.end_to_end.peers import Command, Receiver, free_port, listening, running, wait_for


def ended(*arguments: str, cwd: Path | None = None) -> tuple[int, str, str]:
    return Command(*arguments, cwd=cwd).end(60)


@pytest.fixture
def told(capsys):
    """Runs a command in this process, for what ends by itself: status, output and errors."""

    def run(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        try:
            status = main([*arguments])
        except SystemExit as end:  # argparse's
            status = int(end.code or 0)
        return status, *capsys.readouterr()

    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield run
    root.handlers[:] = handlers
    root.setLevel(level)


def test_the_status_of_the_process_is_the_command_s(tmp_path: Path) -> None:
    commands = [
        (0, Command("run", "--help")),
        (1, Command("run", "c3d:absent.c3d", cwd=tmp_path)),
        (2, Command("run", "morse:x")),
    ]
    for status, command in commands:
        assert command.end()[0] == status


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "devices         serial ports, and what is being sent on them"),
        (["fly"], "invalid choice: 'fly'"),
        (["run"], "SOURCE"),
        (["run", "morse:x"], "'morse:x' is no source: known are serial, osc, c3d"),
        (["run", "c3d:x.c3d", "--seconds", "0"], "'0' is no number above 0"),
        (["simulate", "performer:walk", "--to", "smoke:signal"], "serial:PATH or osc://HOST:PORT"),
        (["simulate", "performer:dance", "--to", "osc://127.0.0.1:9"], "walk"),
        (["simulate", "performer:walk", "--to", "osc://127.0.0.1:9", "--drop", "5"], "5%"),
        (["simulate", "performer:walk", "--to", "osc://127.0.0.1:9", "--markers", "NOSE"], "NOSE"),
        (["simulate", "performer:walk", "--to", "serial:/tmp/x?codec=morse"], "codec=morse"),
        (["demo", "--seconds", "-1"], "'-1' is no number above 0"),
    ],
)
def test_wrong_usage_is_status_2_and_one_line_that_helps(told, arguments, words: str) -> None:
    status, out, err = told(*arguments)
    assert status == 2
    assert words in err.splitlines()[-1]
    assert "Traceback" not in err
    assert out == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "serial:/dev/no-such-port"], "cannot open serial port /dev/no-such-port"),
        (["run", "c3d:absent.c3d"], "absent.c3d: no such file"),
        (["run", "osc://127.0.0.1:0", "--model", "absent.onnx"], "absent.onnx: no such model"),
        (["run", "osc://127.0.0.1:0", "--to", "c3d:/no/such/dir/x.c3d"], "cannot write /no/such"),
        (["simulate", "c3d:absent.c3d", "--to", "osc://127.0.0.1:9"], "absent.c3d: no such file"),
        (["simulate", "performer:walk", "--to", "serial:/no/such/dir/x"], "cannot make the serial"),
        (["demo", "--source", "c3d:absent.c3d"], "absent.c3d: no such file"),
    ],
)
def test_what_fails_while_running_is_status_1_and_one_line(
    told, arguments, words, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = told(*arguments)
    assert status == 1
    last = err.splitlines()[-1]
    assert words in last
    assert last.startswith(f"markerbridge {arguments[0]}: error: ")
    assert "Traceback" not in err
    assert out == ""


@pytest.mark.parametrize(
    "command", ["demo", "run", "simulate", "train", "evaluate", "convert", "doctor", "devices"]
)
def test_every_command_explains_itself(told, command: str) -> None:
    status, out, err = told(command, "--help")
    assert (status, err) == (0, "")
    assert f"markerbridge {command}" in out


def test_a_file_is_not_taken_for_a_serial_port(told, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("precious")
    to = f"serial:{tmp_path / 'mine'}"
    status, _, err = told("simulate", "performer:walk", "--to", to)
    assert status == 1
    assert "choose a path that does not exist" in err
    assert (tmp_path / "mine").read_text() == "precious"


def test_a_capture_without_the_tracked_markers_is_named(told, tmp_path: Path) -> None:
    import numpy as np

    from drivers.c3d_file import write_c3d
    from drivers.frame import Layout

    write_c3d(tmp_path / "few.c3d", Layout(("C7", "LSHO"), 120.0), np.ones((9, 2, 3), np.float32))
    source = f"c3d:{tmp_path / 'few.c3d'}"
    status, _, err = told("simulate", source, "--to", "osc://127.0.0.1:9")
    assert status == 2
    tracked = Model("default").info.tracked
    assert f"the capture lacks the markers {tracked[0]}" in err
    # `run` goes on with what is there, and says what is not.
    status, _, err = told("run", f"{source}?speed=max", "--json")
    assert status == 0
    absent = [label for label in tracked if label not in ("C7", "LSHO")]
    assert f"the stream has no {', '.join(absent)}" in err


def test_a_stream_without_any_tracked_marker_is_an_error(told, tmp_path: Path) -> None:
    import numpy as np

    from drivers.c3d_file import write_c3d
    from drivers.frame import Layout

    write_c3d(tmp_path / "no.c3d", Layout(("T10",), 120.0), np.ones((9, 1, 3), np.float32))
    status, _, err = told("run", f"c3d:{tmp_path / 'no.c3d'}?speed=max")
    assert status == 1
    assert "none of the markers that the model tracks" in err.splitlines()[-1]


def test_the_demo_runs_to_its_end_and_shows_its_figures(data_dir: Path, tmp_path: Path) -> None:
    """The performer, without any data; beside it a real capture, and a picture of it."""
    empty, other = tmp_path / "empty", tmp_path / "other"
    empty.mkdir()
    other.mkdir()
    source = f"c3d:{data_dir / 'real/07_12.c3d'}"  # shorter than the demo: it starts again
    options = ("--seconds", "3", "--no-view")
    picture = ("--source", source, "--snapshot", "view.png")
    with Receiver() as receiver, running("demo", *options, *picture, cwd=other) as real:
        to = f"vmc://127.0.0.1:{receiver.port}"
        status, out, err = ended("demo", *options, "--to", to, cwd=empty)
        assert status == 0, err
        assert out == ""
        for words in ("frames in", "poses out", "age of the pose", "markers imputed", "RMS to the"):
            assert words in err
        status, _, err = real.end(60)
    assert len(receiver.datagrams) > 200
    assert list(empty.iterdir()) == []
    assert status == 0, err
    assert "picture of the view: view.png" in err
    assert (other / "view.png").stat().st_size > 20_000


def test_the_demo_ends_at_once_on_ctrl_c_and_takes_its_simulator_along(tmp_path: Path) -> None:
    with Receiver() as receiver:
        to = f"vmc://127.0.0.1:{receiver.port}"
        with running("demo", "--to", to, "--no-view") as demo:
            wait_for(lambda: receiver.datagrams, "VMC")
            demo.interrupt()
            status, _, err = demo.end(10)
            assert status == 0, err
            assert "ended" in err
    count = len(receiver.datagrams)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", receiver.port))
        again.settimeout(0.3)
        with pytest.raises(TimeoutError):
            again.recv(10)
    assert count > 0


def test_run_ends_after_its_seconds_though_nothing_comes(told) -> None:
    status, out, _ = told("run", f"osc://127.0.0.1:{free_port()}", "--seconds", "0.5", "--json")
    assert status == 0
    assert json.loads(out)["frames"] == 0


def test_however_a_session_is_ended_its_recording_is_whole(tmp_path: Path) -> None:
    """Three at once, each with a device of its own, ended by a signal each."""
    with contextlib.ExitStack() as started:
        devices, sessions = [], []
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
            port, take = tmp_path / f"tracker {number}", tmp_path / f"take [{number}].c3d"
            play = ("simulate", "performer:walk", "--to", f"serial:{port}")
            devices.append((number, port, take, started.enter_context(running(*play))))
        for number, port, take, device in devices:
            wait_for(port.is_symlink, "the serial port")
            receiver = started.enter_context(Receiver())
            to = ("--to", f"c3d:{take}", "--to", f"osc://127.0.0.1:{receiver.port}")
            bridge = started.enter_context(running("run", f"serial:{port}", *to))
            sessions.append((number, port, take, device, receiver, bridge))
        for number, port, take, device, receiver, bridge in sessions:
            wait_for(lambda receiver=receiver: len(receiver.datagrams) > 50, "poses")
            bridge.process.send_signal(number)
            device.process.send_signal(number)
            status, _, err = bridge.end()
            assert status == 0, err
            assert f"to c3d:{take}: " in err
            assert len(read_c3d(take).xyz) > 50
            assert device.end()[0] == 0
            assert not port.is_symlink()


def test_a_demo_told_to_stop_while_it_starts_leaves_nothing_behind(tmp_path: Path) -> None:
    with running("demo", "--no-view", "--seconds", "30", cwd=tmp_path) as demo:
        wait_for(lambda: _children(demo.process.pid), "the simulator's process")
        simulators = _children(demo.process.pid)
        demo.process.terminate()
        demo.end(20)
    for pid in simulators:
        assert not Path(f"/proc/{pid}").exists()


def _children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_an_answer_that_nobody_can_take_is_an_error_in_one_line() -> None:
    answering = (
        ("run", "osc://127.0.0.1:0", "--seconds", "0.1", "--json"),
        ("doctor", "osc://127.0.0.1:0", "--seconds", "0.1"),
        ("devices", "/dev/null", "--listen", "0.1"),
    )
    with Path("/dev/full").open("w") as full:
        started = [
            subprocess.Popen(
                [sys.executable, "-P", "-m", "bridge.cli", *arguments],
                **{"stdout": full, "stderr": subprocess.PIPE, "text": True},
            )
            for arguments in answering
        ]
        for process in started:
            _, err = process.communicate(timeout=60)
            assert process.returncode == 1
            assert "cannot write to standard output: " in err.splitlines()[-1]
            assert "Traceback" not in err


def test_a_session_goes_on_though_its_lines_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        'source = "osc://127.0.0.1:0"\nseconds = 0.5\n[log]\nlines = 0.1\n'
    )
    command = [sys.executable, "-P", "-m", "bridge.cli", "run", "--config", tmp_path / "s.toml"]
    with Path("/dev/full").open("w") as full:
        assert subprocess.run(command, stderr=full, check=False).returncode == 0


def test_a_recording_that_fails_at_its_end_is_told_after_the_summary(tmp_path: Path) -> None:
    address = f"osc://127.0.0.1:{free_port()}"
    out = tmp_path / "out"
    out.mkdir()
    with running("run", address, "--to", f"c3d:{out / 'x.c3d'}") as bridge:
        wait_for(lambda: listening(address), "the bridge to listen")
        out.rmdir()
        ended("simulate", "performer:walk", "--to", address, "--seconds", "1")
        bridge.interrupt()
        status, _, err = bridge.end()
    assert status == 1
    assert "poses out: " in err
    assert "error: " in err.splitlines()[-1]
    assert "Traceback" not in err


def test_a_sink_named_twice_is_refused(told, tmp_path: Path) -> None:
    sink = f"c3d:{tmp_path / 'x.c3d'}"
    address = f"osc://127.0.0.1:{free_port()}"
    status, _, err = told("run", address, "--to", sink, "--to", sink)
    assert status == 2
    assert "a sink is named twice" in err


def test_a_flood_on_the_truth_channel_holds_nothing_up(data_dir: Path) -> None:
    """Rubbish as fast as it can be sent: the session goes on, and stops when it is told to."""
    truth, address = free_port(), f"osc://127.0.0.1:{free_port()}"
    stop = threading.Event()

    def flood() -> None:
        frame = OscMessageBuilder("/markerbridge/frame")
        frame.add_arg(1, "i")
        frame.add_arg(0.0, "d")
        datagram = frame.build().dgram
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not stop.is_set():
                out.sendto(datagram, ("127.0.0.1", truth))

    thread = threading.Thread(target=flood)
    with running("run", address, "--truth", f"osc://127.0.0.1:{truth}", "--json") as bridge:
        wait_for(lambda: listening(address), "the bridge to listen")
        thread.start()
        try:
            source = f"c3d:{data_dir / 'real/02_03.c3d'}"
            assert ended("simulate", source, "--to", address)[0] == 0
            bridge.interrupt()
            status, out, err = bridge.end(20)
        finally:
            stop.set()
            thread.join()
    assert status == 0, err
    assert json.loads(out)["frames"] > 0
