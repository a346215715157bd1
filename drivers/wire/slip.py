"""OSC 1.1 over a serial line: SLIP (RFC 1055) with an END on both sides of each packet.

    0xC0 | OSC packet, 0xC0 in it as 0xDB 0xDC and 0xDB as 0xDB 0xDD | 0xC0

The leading END closes whatever noise or cut packet came before. The packets are those of an OSC
dialect, `native` unless the option `dialect` names another. The host's hello is the message
/markerbridge/hello without arguments; a device answers with its layout.
"""

from __future__ import annotations

from collections import Counter

import sliplib
from pythonosc.osc_message_builder import OscMessageBuilder

from drivers.frame import Floats, Layout, MarkerFrame
from drivers.url import Url
from drivers.wire.codec import Decoder, Encoder
from drivers.wire.packets import PacketBuffer
from drivers.wire.registry import Wire, take_dialect

FRAME = "cmu"  # that of `native`; another dialect brings its own

END = b"\xc0"
MAX_PACKET = 65_536  # with its escapes; longer than any frame of 255 markers in any dialect
HELLO_ADDRESS = "/markerbridge/hello"


def _wrap(packet: bytes) -> bytes:
    return END + sliplib.encode(packet) + END if packet else b""


HELLO_PACKET = _wrap(OscMessageBuilder(HELLO_ADDRESS).build().dgram)


class SlipEncoder:
    """Frames to SLIP packets around those of `inner`; the device's side of the wire."""

    def __init__(self, inner: Encoder) -> None:
        self._inner = inner
        self._tail = b""

    def encode_layout(self, layout: Layout) -> bytes:
        """The dialect's layout packet; nothing where it has none."""
        return _wrap(self._inner.encode_layout(layout))

    def encode_frame(self, index: int, t_device: float, xyz: Floats) -> bytes:
        """One packet; `encode_layout` comes first."""
        return _wrap(self._inner.encode_frame(index, t_device, xyz))

    def has_hello(self, data: bytes) -> bool:
        joined = self._tail + data
        self._tail = joined[1 - len(HELLO_PACKET) :]
        return HELLO_PACKET in joined


class SlipDecoder:
    """SLIP packets to what `inner` makes of them. Counts `bad_slip` (a wrong escape), `overlong`,
    and what `inner` counts; whatever it met, it reads the next good packet.
    """

    hello = HELLO_PACKET

    def __init__(self, inner: Decoder) -> None:
        self._inner = inner
        self._buffer = PacketBuffer(END, MAX_PACKET)

    @property
    def layout(self) -> Layout | None:
        return self._inner.layout

    @property
    def counters(self) -> Counter[str]:
        return self._inner.counters

    @counters.setter
    def counters(self, counters: Counter[str]) -> None:
        self._inner.counters = counters

    def reset(self) -> None:
        self._inner.reset()
        self._buffer.clear()

    def feed(self, data: bytes, t: float) -> list[MarkerFrame]:
        frames = []
        for packet in self._buffer.feed(data):
            if packet is None:
                self.counters["overlong"] += 1
            elif packet:
                try:
                    frames += self._inner.feed(sliplib.decode(packet), t)
                except sliplib.ProtocolError:
                    self.counters["bad_slip"] += 1
        return frames


def open_decoder(url: Url) -> SlipDecoder:
    """The host's side. Takes `dialect`, and what the dialect takes. Raises UrlError."""
    return SlipDecoder(_take_dialect(url).open_decoder(url))


def open_encoder(url: Url) -> SlipEncoder:
    """The device's side. Takes `dialect`, and what the dialect takes. Raises UrlError."""
    return SlipEncoder(_take_dialect(url).open_encoder(url))


def _take_dialect(url: Url) -> Wire:
    """The dialect; its world is that of the stream unless the address has another."""
    dialect = take_dialect(url)
    url.options.setdefault("frame", dialect.FRAME)
    return dialect
