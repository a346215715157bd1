"""`markerbridge run` as a long-running service: session file, status, waiting, and a clean end."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.c3d_file import read_c3d
from tests.end_to_end.peers import Command, Receiver, free_port, listening, running, wait_for

SESSION = """
source = "serial:tracker"
sinks = ["c3d:take.c3d", "osc://127.0.0.1:{port}"]
status = "127.0.0.1:{status}"
wait = true

[log]
lines = 0
"""


def free_tcp_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def status_of(port: int) -> dict[str, Any]:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10) as answer:
        return json.load(answer)


def answers(port: int) -> Callable[[], bool]:
    def asked() -> bool:
        try:
            return bool(status_of(port))
        except OSError:
            return False

    return asked


def ended(*arguments: str, cwd: Path | None = None) -> tuple[int, str, str]:
    return Command(*arguments, cwd=cwd).end(60)


def until_said(command: Command, words: str) -> int:
    """Reads the command's errors until a line has these words; how many lines that were."""
    assert command.process.stderr is not None
    for count, line in enumerate(command.process.stderr, 1):
        if words in line:
            return count
    raise AssertionError(f"it ended without a word of {words}")


def test_a_service_waits_runs_tells_its_status_and_ends_whole(tmp_path: Path) -> None:
    """Started elsewhere, as systemd does: paths are relative to the folder of the file."""
    status, elsewhere = free_tcp_port(), tmp_path / "elsewhere"
    elsewhere.mkdir()
    port, take, file = tmp_path / "tracker", tmp_path / "take.c3d", tmp_path / "session.toml"
    with Receiver() as receiver:
        file.write_text(SESSION.format(port=receiver.port, status=status))
        with running("run", "--config", str(file), cwd=elsewhere) as service:
            wait_for(answers(status), "the status")
            told = status_of(status)
            assert told["state"] == "waiting"
            assert told["pid"] == service.process.pid
            assert told["source_address"] == "serial:tracker"
            assert "frames" not in told
            with running("simulate", "performer:walk", "--to", f"serial:{port}") as device:
                wait_for(lambda: len(receiver.datagrams) > 50, "poses")
                told = status_of(status)
                assert told["state"] == "running"
                assert told["frames"] > 40
                assert told["source"]["bytes"] > 1000
                assert told["sink_addresses"] == list(told["sinks"])
                assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d\d:\d\d", told["started"])
                service.process.send_signal(signal.SIGTERM)
                code, out, err = service.end()
                device.process.send_signal(signal.SIGTERM)
                assert device.end()[0] == 0
    assert (code, out) == (0, ""), err
    assert "Traceback" not in err
    waited = [line for line in err.splitlines() if "waiting for the source" in line]
    assert len(waited) == 1
    assert "cannot open serial port tracker" in waited[0]
    assert len(read_c3d(take).xyz) > 50
    assert list(elsewhere.iterdir()) == []


@pytest.mark.parametrize("json_wanted", [True, False])
def test_one_that_still_waits_ends_when_it_is_told(tmp_path: Path, json_wanted: bool) -> None:
    options = ("--json",) if json_wanted else ()
    command = ("run", "serial:tracker", "--to", "c3d:take.c3d", "--wait", *options)
    with running(*command, cwd=tmp_path) as service:
        assert until_said(service, "waiting for the source") == 1
        service.process.send_signal(signal.SIGTERM)
        code, out, err = service.end(10)
    assert code == 0, err
    if json_wanted:
        assert json.loads(out)["state"] == "ended"
    else:
        assert err.splitlines() == [
            "markerbridge run serial:tracker: ended before its source was there"
        ]
    assert list(tmp_path.iterdir()) == []


def test_a_plug_that_is_pulled_is_told_in_the_log(tmp_path: Path) -> None:
    port = tmp_path / "tracker"
    with running("run", f"serial:{port}", "--wait", "--json") as bridge:
        assert until_said(bridge, "waiting for the source") == 1
        lines = 0
        for often in range(2):
            with running("simulate", "performer:walk", "--to", f"serial:{port}") as device:
                found = f"serial:{port}: found again after" if often else "the source is there"
                lines += until_said(bridge, f"INFO: {found}")
                device.interrupt()
                assert device.end()[0] == 0
            lines += until_said(bridge, f"WARNING: serial:{port}: connection lost")
        bridge.interrupt()
        code, out, _ = bridge.end()
    assert code == 0
    assert json.loads(out)["source"]["disconnects"] == 2
    assert lines < 8


def test_a_session_file_drives_an_osc_session(tmp_path: Path) -> None:
    """With labels, axes and unit of another program, and --seconds and --json from outside."""
    port = free_port()
    options = "labels=Chest:C7,Left%20Shoulder:LSHO&frame=unity&unit=cm"
    (tmp_path / "session.toml").write_text(
        f"""
        seconds = 3600
        [source]
        url = "osc://127.0.0.1:{port}"
        frame = "unity"
        unit = "cm"
        labels = {{ Chest = "C7", "Left Shoulder" = "LSHO" }}
        """
    )
    command = ("run", "--config", "session.toml", "--seconds", "2.5", "--json")
    with running(*command, cwd=tmp_path) as service:
        wait_for(lambda: listening(f"osc://127.0.0.1:{port}"), "the bridge to listen")
        to = f"osc://127.0.0.1:{port}?{options}"
        with running("simulate", "performer:walk", "--to", to, "--loop"):
            code, out, err = service.end()
    assert code == 0, err
    found = json.loads(out)
    assert found["frames"] > 50
    assert found["state"] == "ended"
    assert "the stream has no" not in err
    assert found["imputed_samples"] == 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('source = "osc://127.0.0.1:0"\nsauce = 1', "line 2: sauce: unknown key (known: source, "),
        (
            '[source]\nurl = "osc://127.0.0.1:0"\nfrmae = "unity"',
            "line 3: source.frmae: unknown key (known: dialect, ",
        ),
        ("source = osc", "line 1: no TOML: Invalid value"),
        (
            'source = "osc://127.0.0.1:0"\nsinks = [\n"osc://127.0.0.1:9",\n"morse:x"]',
            "line 4: sinks: 'morse:x' is no sink",
        ),
        (
            'source = "osc://127.0.0.1:0"\ntruth = "serial:/x"',
            "line 2: truth: 'serial:/x' is no line of true poses: write osc://HOST:PORT",
        ),
    ],
)
def test_what_is_wrong_in_the_file_is_status_2_and_one_line(
    tmp_path: Path, text: str, words: str
) -> None:
    (tmp_path / "session.toml").write_text(text)
    status, out, err = ended("run", "--config", "session.toml", cwd=tmp_path)
    assert (status, out) == (2, "")
    assert err.startswith(f"markerbridge run: error: session.toml, {words}"), err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "name a SOURCE, or --config FILE"),
        (["osc://127.0.0.1:0", "--config", "x.toml"], "name a SOURCE, or --config FILE"),
        (["--config", "x.toml", "--to", "view:"], "--to and --config: write it into x.toml"),
        (["--config", "x.toml", "--allow", "::1"], "--allow and --config: write it into x.toml"),
        (["--config", "x.toml"], "x.toml: cannot read the session file: No such file"),
        (["serial:/x", "--allow", "10.0.0.1"], "--allow is for osc:// sources, not for 'serial:/x"),
        (["osc://127.0.0.1:0", "--to", "c3d:a", "--to", "c3d:a"], "a sink is named twice"),
    ],
)
def test_what_cannot_go_together_is_status_2_and_one_line(
    tmp_path: Path, arguments: list[str], words: str
) -> None:
    status, out, err = ended("run", *arguments, cwd=tmp_path)
    assert (status, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


def test_a_status_port_that_is_taken_is_status_1_and_one_line() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        status, _, err = ended("run", "osc://127.0.0.1:0", "--status", port)
    assert status == 1
    assert f"cannot serve the status at 127.0.0.1:{port}: Address already in use" in err
    assert err.count("\n") == 1


def test_a_free_port_for_the_status_is_said_and_curl_reads_it() -> None:
    with running("run", f"osc://127.0.0.1:{free_port()}", "--status", ":0") as service:
        assert service.process.stderr is not None
        said = service.process.stderr.readline()
        url = re.fullmatch(r"status at (http://127\.0\.0\.1:\d+/)\n", said)
        assert url, said
        curl = ["curl", "-s", "--noproxy", "*", url[1]]
        done = subprocess.run(curl, capture_output=True, timeout=30, check=True)
        assert json.loads(done.stdout)["version"]
        service.interrupt()
        assert service.end()[0] == 0


def test_senders_that_are_not_allowed_are_not_read() -> None:
    port = free_port()
    command = ("run", f"osc://127.0.0.1:{port}", "--allow", "10.1.2.3,::1", "--json")
    with running(*command, "--seconds", "2.5") as service:
        wait_for(lambda: listening(f"osc://127.0.0.1:{port}"), "the bridge to listen")
        with running("simulate", "performer:walk", "--to", f"osc://127.0.0.1:{port}"):
            code, out, err = service.end()
    assert code == 0, err
    found = json.loads(out)
    assert found["frames"] == 0
    assert found["source"]["refused"] > 10
