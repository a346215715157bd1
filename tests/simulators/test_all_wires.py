"""What the device sends, on every wire and in any frame, is what the host reads."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.url import Url
from drivers.wire.registry import CODECS, DIALECTS, take_decoder, take_encoder
from drivers.wire_source import WireSource
from simulators.corruption import Corruption, Faults
from simulators.device import Device, Wire
from simulators.lines import MemoryLine
from tests.simulators.played import LAYOUT, poses, position

NUMBERED = ",".join(f"{place}:{label}" for place, label in enumerate(LAYOUT.labels, 1))
WIRES = [
    *(f"serial:port?codec={codec}" for codec in CODECS if codec != "fastrak"),
    f"serial:port?codec=fastrak&labels={NUMBERED}",
    f"serial:port?codec=fastrak&model=liberty&format=binary&labels={NUMBERED}",
    "serial:port?codec=lines&style=markers",
    f"serial:port?codec=slip-osc&dialect=vrchat&labels={NUMBERED}",
    *(f"osc://127.0.0.1:9100?dialect={dialect}" for dialect in DIALECTS if dialect != "vrchat"),
    f"osc://127.0.0.1:9100?dialect=vrchat&labels={NUMBERED}",
]


@pytest.mark.parametrize("frame", ["", "&frame=unreal", "&axes=y,-z,-x&unit=in"])
@pytest.mark.parametrize("address", WIRES)
def test_what_is_sent_is_read_under_our_labels_in_our_metres(address: str, frame: str) -> None:
    clock = VirtualClock(10.0)
    line = MemoryLine(clock)
    encoder, convention = take_encoder(Url.parse(address + frame))
    decoder, again = take_decoder(Url.parse(address + frame))
    assert again == convention
    source = WireSource(address, line.connect, decoder, clock, convention=again)
    rows = list(range(len(LAYOUT.labels)))
    wire = Wire(line, encoder, LAYOUT, convention)
    device = Device(poses(240), rows, Corruption(Faults(), len(rows)), wire, clock)
    device.schedule(clock)
    frames = []
    while (one := source.read(0.5)) is not None:
        frames.append(one)
    assert device.done
    assert len(frames) >= 230  # labels are believed when they have come some times
    for i, one in enumerate(frames[5:]):
        assert set(one.layout.labels) == set(LAYOUT.labels)
        order = [one.layout.labels.index(label) for label in LAYOUT.labels]
        sent = position(239 - (len(frames) - 6 - i))
        np.testing.assert_allclose(one.xyz[order], sent, atol=6e-4)
