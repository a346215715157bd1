"""One rig per driver and wire: the device's end of a real line, and the source at the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from drivers.c3d_file import write_c3d
from drivers.clock import VirtualClock
from drivers.convention import Convention
from drivers.frame import Floats, Layout, MarkerFrame, Source
from drivers.osc_udp import OscSource
from drivers.registry import open_source
from drivers.session_log import OPENED, LineBytes, LineEvent, LogWriter
from drivers.transport import MemoryTransport, Received, memory_line
from drivers.url import Url
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire.codec import Encoder
from drivers.wire.registry import take_encoder
from drivers.wire_source import WireSource
from simulators.lines import PtyLine, UdpLine

LAYOUT = Layout(("C7", "LSHO", "RSHO", "LTOE"), 120.0)
WARM_UP = 4  # frames after which every wire's labels are believed


@dataclass(frozen=True)
class Wire:
    """What an address leads to. tells: whether indices and times are the device's own. holes:
    whether a frame with missing markers is whole as soon as it is sent.
    """

    address: str
    tells: bool = True
    holes: bool = True


_PLACES = "labels=1:C7,2:LSHO,3:RSHO,4:LTOE"
WIRES = {
    "cobs": Wire("serial:{}?codec=cobs"),
    "slip-osc": Wire("serial:{}?codec=slip-osc"),
    "lines": Wire("serial:{}?codec=lines"),
    "fastrak": Wire(f"serial:{{}}?codec=fastrak&{_PLACES}", tells=False, holes=False),
    "native": Wire("osc://127.0.0.1:{}?dialect=native"),
    "qtm": Wire("osc://127.0.0.1:{}?dialect=qtm"),
    "natnet": Wire("osc://127.0.0.1:{}?dialect=natnet", tells=False),
    "vmc": Wire("osc://127.0.0.1:{}?dialect=vmc", tells=False),
    "vrchat": Wire(f"osc://127.0.0.1:{{}}?dialect=vrchat&{_PLACES}", tells=False),
}


def stream(count: int) -> Floats:
    """Frames that carry their own truth: y of marker m in frame i is i · 2 mm + m / 10 metres, and
    marker i mod 7 is missing."""
    index, marker = np.meshgrid(np.arange(count), np.arange(len(LAYOUT.labels)), indexing="ij")
    xyz = np.stack([-index / 1000 - 0.1, index / 500 + marker / 10, marker / 5 + 0.5], axis=2)
    xyz[index % 7 == marker] = np.nan
    return xyz.astype(np.float32)


class Rig(Protocol):
    """`open` connects the source; `send` makes the device send frames it has not sent yet."""

    source: Source
    tells: bool
    holes: bool

    def send(self, xyz: Floats) -> None: ...

    def send_rubbish(self) -> int:
        """Puts foreign and spoilt packets on the line; how many there are to count."""
        ...

    def close(self) -> None: ...


class WireRig:
    """A wire of `WIRES` on a real pty or UDP port, with its labels believed already."""

    def __init__(self, name: str, folder: Path) -> None:
        wire = WIRES[name]
        self.tells, self.holes = wire.tells, wire.holes
        self.line: PtyLine | UdpLine | MemoryTransport
        if wire.address.startswith("serial:"):
            self.line = PtyLine(folder / "port")
            address = wire.address.format(folder / "port")
            self.source = open_source(address)
        else:
            address = wire.address.format(0)
            self.source = open_source(address)
            assert isinstance(self.source, OscSource)
            self.line = UdpLine("127.0.0.1", self.source.port)
        self.encoder: Encoder
        self.encoder, self.convention = take_encoder(Url.parse(address))
        self._begin()

    def _begin(self) -> None:
        layout = self.encoder.encode_layout(self.convention.layout_out(LAYOUT))
        if layout:
            self.line.send(layout)
        self.sent = -WARM_UP
        still = np.ones((WARM_UP, 4, 3), np.float32) + np.arange(4, dtype=np.float32)[:, None] / 10
        self.send(still)
        heard: MarkerFrame | None = self.source.read(2.0)
        while heard is not None and not (self.tells and heard.index == WARM_UP - 1):
            heard = self.source.read(0.1)
        self.source.counters.clear()

    def send(self, xyz: Floats) -> None:
        for frame in self.convention.xyz_out(xyz):
            index = self.sent + WARM_UP
            self.line.send(self.encoder.encode_frame(index, index / 120, frame))
            self.sent += 1

    def send_rubbish(self) -> int:
        good = self.encoder.encode_frame(999, 0.0, self.convention.xyz_out(stream(1)[0]))
        if not isinstance(self.line, UdpLine):
            end = b"\0\xc0\r\n"  # of any packet
            self.line.send(end + good[: len(good) // 2] + end + b"AT+RST\r\n\xff\xfe" + end)
            return 1
        packets = (good[:-3], b"\xff" + good[1:], b"hello", b"#bundle\0" + bytes(8) + b"\xff" * 4)
        for packet in packets:
            self.line.send(packet)
        return len(packets)

    def close(self) -> None:
        self.source.close()
        self.line.close()


class MemoryRig(WireRig):
    """The serial driver's codec over a line within this process, on virtual time."""

    def __init__(self, folder: Path) -> None:
        self.tells = self.holes = True
        clock = VirtualClock()
        host, self.line = memory_line(clock)
        self.encoder = CobsEncoder()
        self.convention = Convention()
        self.source = WireSource("memory:", lambda: host, CobsDecoder(), clock)
        hello = self.line.receive(1.0)
        assert hello is not None
        assert self.encoder.has_hello(hello.data)
        self._begin()

    def close(self) -> None:
        self.source.close()


class FileRig:
    """A file of 400 frames of `stream`: the device's sending is the file's being there."""

    tells = holes = True

    def __init__(self, folder: Path) -> None:
        self.source = open_source(self._write(folder, stream(400)) + "?speed=max")

    def _write(self, folder: Path, xyz: Floats) -> str:
        write_c3d(folder / "clip.c3d", LAYOUT, xyz)
        return f"c3d:{folder / 'clip.c3d'}"

    def send(self, xyz: Floats) -> None:
        pass

    def send_rubbish(self) -> int:
        return 0

    def close(self) -> None:
        self.source.close()


class LogRig(FileRig):
    """A recorded session: what came over a serial line once."""

    def _write(self, folder: Path, xyz: Floats) -> str:
        log, encoder = LogWriter(folder / "log.mcap", "tests"), CobsEncoder()
        log.add(LineEvent("source", 0.0, OPENED, "serial:/dev/ttyUSB0"))
        log.add(LineBytes("source", Received(encoder.encode_layout(LAYOUT), 0.0)))
        for index, frame in enumerate(xyz):
            data = encoder.encode_frame(index, index / 120, frame)
            log.add(LineBytes("source", Received(data, index / 120)))
        log.close()
        return f"log:{folder / 'log.mcap'}"


FILES = {"c3d": FileRig, "log": LogRig}
RIGS: dict[str, Callable[[Path], Rig]] = {
    **{name: partial(WireRig, name) for name in WIRES},
    "memory": MemoryRig,
    **FILES,
}
