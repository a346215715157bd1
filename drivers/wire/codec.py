"""What every wire codec offers: a decoder for the host's side, an encoder for the device's."""

from __future__ import annotations

from collections import Counter
from typing import Protocol

from drivers.frame import Floats, Layout, MarkerFrame


class Decoder(Protocol):
    """Bytes to frames. Never raises on any input: what it cannot read it counts and skips."""

    hello: bytes  # what asks the device for its layout; empty where the wire has no way back
    layout: Layout | None
    counters: Counter[str]

    def feed(self, data: bytes, t: float) -> list[MarkerFrame]:
        """Frames completed by `data`, stamped with `t`, the host's time of receipt in seconds."""
        ...

    def reset(self) -> None:
        """Forgets what came before the line was lost: the layout, and a packet begun."""
        ...


class Encoder(Protocol):
    """Frames to bytes, as a device sends them."""

    def encode_layout(self, layout: Layout) -> bytes: ...

    def encode_frame(self, index: int, t_device: float, xyz: Floats) -> bytes:
        """One packet: device time in seconds, (M, 3) float32 metres with NaN rows where missing."""
        ...

    def has_hello(self, data: bytes) -> bool:
        """True if `data`, bytes from the host, holds (the end of) a hello."""
        ...
