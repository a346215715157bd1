"""`markerbridge simulate` on each wire, with faults, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.clock import SYSTEM_CLOCK
from drivers.errors import UsageError
from drivers.frame import Layout
from drivers.registry import open_source
from drivers.url import Url, UrlError
from drivers.wire.registry import CODECS, DIALECTS, take_decoder, take_encoder
from simulators.command import heard_names, main
from tests.end_to_end.peers import free_port, running, wait_for

NINE = ("LWRB", "RWRB", "RBWT", "LANK", "RSHN", "RANK", "C7", "LSHO", "RSHO")
LAYOUT = Layout(NINE, 120.0)
SIMULATE = ("simulate", "performer:walk", "--markers")


def names(address: str, labels: tuple[str, ...] = NINE) -> dict[str, str]:
    encoder, convention = take_encoder(Url.parse(address))
    decoder, _ = take_decoder(Url.parse(address))
    return heard_names(encoder, decoder, convention, Layout(labels, 120.0))


@pytest.mark.parametrize("dialect", [*DIALECTS])
@pytest.mark.parametrize("frame", ["cmu", "unity", "c3d"])
def test_names_on_a_dialect_are_told_by_their_places(dialect: str, frame: str) -> None:
    heard = names(f"osc://127.0.0.1:9100?dialect={dialect}&frame={frame}")
    own = dialect != "vrchat"
    theirs = NINE if own else ("1", "2", "3", "4", "5", "6", "7", "8", "head")
    assert heard == dict(zip(theirs, NINE, strict=True))


@pytest.mark.parametrize("codec", [codec for codec in CODECS if codec != "fastrak"])
def test_names_on_a_codec_are_told_by_their_places(codec: str) -> None:
    assert names(f"serial:port?codec={codec}") == dict(zip(NINE, NINE, strict=True))


def test_labels_of_the_address_are_turned_round() -> None:
    heard = names("osc://127.0.0.1:9100?labels=Hand_L:LWRB,Neck:C7")
    assert heard == {"Hand_L": "LWRB", "Neck": "C7"} | {
        label: label for label in NINE if label not in ("LWRB", "C7")
    }


@pytest.mark.parametrize(
    ("to", "said"),
    [
        ("c3d:x.c3d", r"--to 'c3d:x.c3d': write serial:PATH or osc://HOST:PORT"),
        ("serial:x?codec=morse", "codec=morse is wrong: known are cobs"),
        ("serial:x?reorder=9", "reorder=9 is wrong"),
        ("osc://127.0.0.1:9100?colour=red", r"unknown option colour \(known: dialect, frame"),
        ("osc://127.0.0.1:9000?dialect=vrchat&labels=1:C7", "VRChat has the places"),
    ],
)
def test_an_address_that_cannot_be_meant_is_refused(to: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        main(["performer:walk", "--to", to], lambda model: NINE)


def test_options_of_the_host_are_no_mistake_but_checked(tmp_path: Path) -> None:
    arguments = ["performer:walk", "--seconds", "0.05", "--to"]
    to = f"osc://127.0.0.1:{free_port()}?dialect=qtm&reorder=2&rate=120&allow=127.0.0.1"
    assert main([*arguments, to], lambda model: NINE) == 0
    with pytest.raises(UrlError, match="rate=fast is wrong"):
        main([*arguments, to.replace("rate=120", "rate=fast")], lambda model: NINE)


def test_a_fault_file_that_is_wrong_is_a_line_and_status_2(tmp_path: Path) -> None:
    plan = tmp_path / "faults.toml"
    plan.write_text('[[fault]]\nkind = "swap"\nmarkers = ["LFHD", "C7"]\n')
    to = f"serial:{tmp_path / 'port'}"
    with running(*SIMULATE, "C7,LTOE", "--to", to, "--faults", str(plan)) as device:
        status, out, err = device.end()
    assert (status, out) == (2, "")
    assert err.strip().endswith(
        f"{plan}, line 3: fault 1 (swap): markers.0: the device sends no marker LFHD (it sends "
        "C7, LTOE)"
    )
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize("wire", ["vrchat", "fastrak"])
def test_names_of_the_wire_are_said_as_the_host_needs_them(wire: str, tmp_path: Path) -> None:
    to = f"osc://127.0.0.1:{free_port()}?dialect=vrchat"
    if wire == "fastrak":
        to = f"serial:{tmp_path / 'port'}?codec=fastrak"
    with running(*SIMULATE, "C7,LTOE", "--to", to, "--seconds", "0.5") as device:
        if wire == "fastrak":
            wait_for((tmp_path / "port").is_symlink, "the serial port")
            with open_source(f"{to}&labels=1:C7,2:LTOE") as source:
                frame = source.read(5.0)
                assert frame is not None
                assert frame.layout.labels == ("C7", "LTOE")
                assert 0 < frame.xyz[1, 2] < 0.3 < frame.xyz[0, 2] < 2  # a toe, and a neck
                device.interrupt()
        status, _, err = device.end()
    assert status == 0
    assert "labels=1:C7,2:LTOE" in err


def test_an_unplugged_device_in_real_time_is_found_again(tmp_path: Path) -> None:
    plan = tmp_path / "faults.toml"
    plan.write_text(
        'seed = 1\n[[fault]]\nkind = "unplug"\nat = 0.4\nfor = 0.3\n'
        '[[fault]]\nkind = "jitter"\nup_to = 0.02\n'
        '[[fault]]\nkind = "duplicate"\nchance = 0.1\n'
    )
    port = tmp_path / "port"
    arguments = ("--to", f"serial:{port}", "--faults", str(plan), "--seconds", "1.5")
    with running(*SIMULATE, "C7,LTOE", *arguments) as device:
        wait_for(port.is_symlink, "the serial port")
        with open_source(f"serial:{port}") as source:
            frames = []
            end = SYSTEM_CLOCK.now() + 20
            while (not frames or frames[-1].index < 179) and SYSTEM_CLOCK.now() < end:
                frame = source.read(0.5)
                frames += [frame] if frame else []
        status, _, err = device.end()
    assert status == 0, err
    indices = [frame.index for frame in frames]
    assert indices == sorted(set(indices))
    assert 100 < len(indices) < 180 - 30
    assert source.counters["disconnects"] == source.counters["reconnects"] == 1
    assert source.counters["duplicates"] > 5
    assert "unplug 1" in err


def test_a_wire_without_a_hello_starts_when_the_port_is_opened(tmp_path: Path) -> None:
    """Every frame comes: none is sent before there is somebody to read it."""
    port = tmp_path / "port"
    to = f"serial:{port}?codec=lines"
    with running(*SIMULATE, "C7,LTOE", "--to", to, "--seconds", "0.5") as device:
        wait_for(port.is_symlink, "the serial port")
        with open_source(to) as source:
            indices = []
            while (frame := source.read(2.0)) is not None:
                indices.append(frame.index)
                if frame.index == 59:
                    break
        status, _, err = device.end()
    assert status == 0, err
    assert indices == list(range(indices[0], 60))
    assert indices[0] < 8  # labels are believed when they have come some times
