"""One rig per driver: the device's end of a real line, and the source at the other."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from drivers.c3d_file import write_c3d
from drivers.clock import VirtualClock
from drivers.frame import Floats, Layout, Source
from drivers.osc_udp import OscSource
from drivers.registry import open_source
from drivers.transport import memory_line
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire.osc_native import NativeOscEncoder
from drivers.wire_source import WireSource
from simulators.lines import PtyLine, UdpLine

LAYOUT = Layout(("C7", "LSHO", "RSHO", "LTOE"), 120.0)


def stream(count: int) -> Floats:
    """Frames that carry their own truth: x of marker m in frame i is i + m / 10 metres, and
    marker i mod 7 is missing."""
    index, marker = np.meshgrid(np.arange(count), np.arange(len(LAYOUT.labels)), indexing="ij")
    xyz = np.stack([index + marker / 10 + 1, -index - 1.0, marker + 1.0], axis=2)
    xyz[index % 7 == marker] = np.nan
    return xyz.astype(np.float32)


class Rig(Protocol):
    """`open` connects the source; `send` makes the device send frames it has not sent yet."""

    source: Source

    def send(self, xyz: Floats) -> None: ...

    def send_rubbish(self) -> int:
        """Puts foreign and spoilt packets on the line; how many there are to count."""
        ...

    def close(self) -> None: ...


class SerialRig:
    def __init__(self, folder: Path) -> None:
        self.line = PtyLine(folder / "port")
        self.encoder = CobsEncoder()
        self.source = open_source(f"serial:{folder / 'port'}")
        while not ((hello := self.line.receive(1.0)) and self.encoder.has_hello(hello.data)):
            pass
        self.line.send(self.encoder.encode_layout(LAYOUT))
        self.sent = 0

    def send(self, xyz: Floats) -> None:
        for frame in xyz:
            self.line.send(self.encoder.encode_frame(self.sent, self.sent / 120, frame))
            self.sent += 1

    def send_rubbish(self) -> int:
        good = self.encoder.encode_frame(999, 0.0, stream(1)[0])
        self.line.send(good[:20] + b"\0" + good[3:] + b"AT+RST\r\n\0\0\xff\xfe\x00")
        return 4

    def close(self) -> None:
        self.source.close()
        self.line.close()


class OscRig:
    def __init__(self, folder: Path) -> None:
        self.source = open_source("osc://127.0.0.1:0")
        assert isinstance(self.source, OscSource)
        self.line = UdpLine("127.0.0.1", self.source.port)
        self.encoder = NativeOscEncoder()
        self.line.send(self.encoder.encode_layout(LAYOUT))
        self.sent = 0

    send = SerialRig.send

    def send_rubbish(self) -> int:
        good = self.encoder.encode_frame(999, 0.0, stream(1)[0])
        packets = (good[:-4], good[4:], b"hello", b"#bundle\0" + bytes(8) + b"\xff" * 4)
        for packet in packets:
            self.line.send(packet)
        return len(packets)

    def close(self) -> None:
        self.source.close()
        self.line.close()


class MemoryRig:
    """The serial driver's codec over a line within this process, on virtual time."""

    def __init__(self, folder: Path) -> None:
        clock = VirtualClock()
        host, self.line = memory_line(clock)
        self.encoder = CobsEncoder()
        self.source = WireSource("memory:", lambda: host, CobsDecoder(), clock)
        hello = self.line.receive(1.0)
        assert hello is not None
        assert self.encoder.has_hello(hello.data)
        self.line.send(self.encoder.encode_layout(LAYOUT))
        self.sent = 0

    send = SerialRig.send
    send_rubbish = SerialRig.send_rubbish

    def close(self) -> None:
        self.source.close()


class C3dRig:
    """A file of 400 frames of `stream`: the device's sending is the file's being there."""

    def __init__(self, folder: Path) -> None:
        write_c3d(folder / "clip.c3d", LAYOUT, stream(400))
        self.source = open_source(f"c3d:{folder / 'clip.c3d'}?speed=max")

    def send(self, xyz: Floats) -> None:
        pass

    def send_rubbish(self) -> int:
        return 0

    def close(self) -> None:
        self.source.close()


RIGS = {"serial": SerialRig, "osc": OscRig, "memory": MemoryRig, "c3d": C3dRig}
