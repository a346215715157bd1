"""Real captures through real lines, in real time, between real processes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_message import OscMessage

from bridge.estimator import PoseEstimator
from bridge.model import Model
from drivers.c3d_file import C3dSource, read_c3d
from drivers.clock import VirtualClock
from tests.end_to_end.peers import Receiver, free_port, listening, running, wait_for

CLIP = "real/07_12.c3d"  # 263 frames, some samples missing


def direct(clip_path: Path) -> np.ndarray:
    """The poses that the estimator gives when nothing lies between it and the capture."""
    model = Model("default")
    clip = read_c3d(clip_path, model.info.tracked)
    estimator = PoseEstimator(model)
    source = C3dSource("clip", clip, VirtualClock())
    return np.stack([estimator.step(frame).xyz for frame in source])


def poses(datagrams: list[bytes], labels: int) -> dict[int, np.ndarray]:
    """Poses by frame index, read by python-osc."""
    found = {}
    for datagram in datagrams:
        message = OscMessage(datagram)
        if message.address == "/markerbridge/pose":
            index, _, provenance, *values = message.params
            assert len(provenance) == labels
            assert index not in found
            found[index] = np.array(values[: 3 * labels], np.float32).reshape(-1, 3)
    return found


@pytest.mark.parametrize("wire", ["serial", "osc"])
def test_no_frame_is_lost_and_none_differs_from_the_direct_evaluation(
    data_dir: Path, tmp_path: Path, wire: str
) -> None:
    expected = direct(data_dir / CLIP)
    address = (
        f"serial:{tmp_path / 'tracker'}" if wire == "serial" else f"osc://127.0.0.1:{free_port()}"
    )
    simulate = ("simulate", f"c3d:{data_dir / CLIP}", "--to", address)
    with Receiver() as receiver:
        run = ("run", address, "--json", "--to", f"osc://127.0.0.1:{receiver.port}")
        if wire == "serial":
            with running(*simulate) as device:
                wait_for((tmp_path / "tracker").is_symlink, "the serial port")
                with running(*run) as bridge:
                    assert device.end()[0] == 0
                    wait_for(lambda: len(poses(receiver.datagrams, 41)) == len(expected), "poses")
                    bridge.interrupt()
                    status, out, err = bridge.end()
        else:
            # Who plays over UDP hears nothing back: the bridge is there first.
            with running(*run, "--to", f"c3d:{tmp_path / 'out.c3d'}") as bridge:
                wait_for(lambda: listening(address), "the bridge to listen")
                with running(*simulate) as device:
                    assert device.end()[0] == 0
                wait_for(lambda: len(poses(receiver.datagrams, 41)) == len(expected), "poses")
                bridge.interrupt()
                status, out, err = bridge.end()
            recorded = read_c3d(tmp_path / "out.c3d").xyz
            np.testing.assert_allclose(recorded, expected, atol=1e-4)
    assert status == 0, err
    assert "Traceback" not in err
    summary = json.loads(out)
    assert summary["frames"] == len(expected)
    assert summary["missing_indices"] == 0
    received = poses(receiver.datagrams, 41)
    assert sorted(received) == list(range(len(expected)))
    difference = max(np.abs(received[i] - expected[i]).max() for i in received)
    assert difference < 1e-4  # 0.1 mm


def test_two_shells_with_dropped_markers_and_vmc_out(data_dir: Path, tmp_path: Path) -> None:
    """The issue's own session: every frame that was sent comes out, Ctrl-C ends both cleanly."""
    port = tmp_path / "tracker"
    with Receiver() as receiver:
        simulate = ("simulate", f"c3d:{data_dir / 'real/02_01.c3d'}", "--to", f"serial:{port}")
        with running(*simulate, "--drop", "5%", "--noise", "1mm", "--loop") as device:
            wait_for(port.is_symlink, "the serial port")
            vmc = f"vmc://127.0.0.1:{receiver.port}?rate=200"
            with running("run", f"serial:{port}", "--to", vmc, "--json") as bridge:
                wait_for(lambda: len(receiver.datagrams) >= 480, "four seconds of VMC")
                device.interrupt()
                device_status, _, device_err = device.end()
                sent = int(device_err.split(" frames of ")[0].split()[-1])
                wait_for(lambda: len(receiver.datagrams) >= sent, "the last frames", 5)
                bridge.interrupt()
                status, out, err = bridge.end()
    assert device_status == status == 0, device_err + err
    assert "Traceback" not in device_err + err
    summary = json.loads(out)
    (sink,) = summary["sinks"].values()
    assert summary["frames"] == sent == sink["sent"] == len(receiver.datagrams)
    assert sink["dropped"] == sink["rate_limited"] == sink["errors"] == 0
    assert summary["imputed_samples"] > 0
    for datagram in receiver.datagrams[:: len(receiver.datagrams) // 10]:
        contents = list(OscBundle(datagram))
        assert [m.address for m in contents[:2]] == ["/VMC/Ext/OK", "/VMC/Ext/T"]
        assert len(contents) == 3 + 19 + 41
    assert not port.is_symlink()


def test_a_pulled_plug_is_survived_and_the_stream_goes_on(data_dir: Path, tmp_path: Path) -> None:
    port = tmp_path / "tracker"
    simulate = ("simulate", f"c3d:{data_dir / CLIP}", "--to", f"serial:{port}")
    with Receiver() as receiver, running(*simulate) as device:
        wait_for(port.is_symlink, "the serial port")
        to = f"osc://127.0.0.1:{receiver.port}"
        with running("run", f"serial:{port}", "--to", to, "--json") as bridge:
            wait_for(lambda: len(receiver.datagrams) > 60, "poses")
            device.process.kill()  # the line breaks in the middle of a frame
            device.end()
            before = len(receiver.datagrams)
            port.unlink()
            with running(*simulate, "--seconds", "1") as again:
                wait_for(lambda: len(receiver.datagrams) > before + 60, "poses after the plug")
                assert again.end()[0] == 0
            bridge.interrupt()
            status, out, err = bridge.end()
    assert status == 0, err
    source = json.loads(out)["source"]
    assert source["disconnects"] >= 1
    assert source["reconnects"] >= 1
