"""`markerbridge doctor` and `devices` as processes, over real lines."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bridge.cli import main
from drivers.c3d_file import read_c3d, write_c3d
from drivers.coordinates import FRAMES
from drivers.frame import Layout
from tests.end_to_end.peers import Command, free_port, running, wait_for

SECONDS = "2"


def doctor(address: str) -> tuple[int, dict]:
    """The doctor's answer while a simulator sends what `address` says."""
    command = Command("doctor", address, "--seconds", SECONDS, "--json")
    status, out, err = command.end()
    assert out, err
    return status, json.loads(out)


def test_a_sender_in_another_world_is_named_and_the_address_then_is_all_well() -> None:
    address = f"osc://127.0.0.1:{free_port()}"
    with running("simulate", "performer:walk", "--to", f"{address}?frame=unity"):
        status, answer = doctor(address)
        assert status == 1
        assert [f["about"] for f in answer["findings"] if f["grade"] == "wrong"] == ["coordinates"]
        assert answer["address"] == f"{address}?frame=unity"
        status, answer = doctor(answer["address"])
    assert (status, answer["well"]) == (0, True), answer
    assert "rate" in [finding["about"] for finding in answer["findings"]]


def test_in_plain_words_it_ends_with_the_address_to_write(tmp_path: Path) -> None:
    port = tmp_path / "tracker"
    with running("simulate", "performer:walk", "--to", f"serial:{port}?unit=mm"):
        wait_for(port.is_symlink, "the serial port")
        status, out, err = Command("doctor", f"serial:{port}", "--seconds", SECONDS).end()
    assert status == 1, err
    *_, last = out.splitlines()
    assert last == f"write: 'serial:{port}?frame=c3d'"
    assert out.startswith("wrong: the stream's world is another: its positions are millimetres")


def test_silence_has_its_reasons() -> None:
    port = free_port()
    status, out, _ = Command("doctor", f"osc://127.0.0.1:{port}", "--seconds", "0.3").end()
    assert status == 1
    assert f"osc://0.0.0.0:{port}" in out


def test_an_address_that_cannot_be_meant_is_wrong_usage(capsys: pytest.CaptureFixture) -> None:
    assert main(["doctor", "osc://127.0.0.1:9100?frame=maya"]) == 2
    assert "frame=maya" in capsys.readouterr().err


def test_a_capture_is_examined_too(data_dir: Path) -> None:
    clip = f"c3d:{data_dir / 'real/02_01.c3d'}?speed=max"
    status, out, err = Command("doctor", clip, "--json").end()
    assert (status, json.loads(out)["address"]) == (0, clip), err


@pytest.mark.parametrize("frame", ["opengl", "unity"])
def test_a_foreign_capture_is_mended_too(data_dir: Path, tmp_path: Path, frame: str) -> None:
    """Another world's axes and names, in a file that says its unit itself."""
    clip = read_c3d(data_dir / "real/07_01.c3d")
    layout = Layout(tuple(f"Q_{label}" for label in clip.layout.labels), 120.0)
    write_c3d(tmp_path / "foreign.c3d", layout, FRAMES[frame].from_ours(clip.xyz[:600]))
    address = f"c3d:{tmp_path / 'foreign.c3d'}?speed=max"
    status, out, err = Command("doctor", address, "--json").end()
    assert status == 1, err
    found = json.loads(out)["address"]
    assert f"frame={frame}" in found
    assert "Q_LWRB:LWRB" in found
    status, out, err = Command("doctor", found, "--json").end()
    assert (status, json.loads(out)["address"]) == (0, found), err


def test_devices_names_the_address_that_reads_a_port(tmp_path: Path) -> None:
    port = tmp_path / "tracker"
    to = f"serial:{port}?codec=lines"
    with running("simulate", "performer:walk", "--to", to):
        wait_for(port.is_symlink, "the serial port")
        absent = tmp_path / "none"
        status, out, err = Command("devices", str(port), str(absent), "--listen", "1").end()
    assert status == 0, err
    found, none = out.splitlines()
    assert found == f"{port}: write '{to}'"
    assert none.startswith(f"{absent}: there is no such port: is the device plugged in")
