"""Faults of the line as a whole: it stands still, or it is gone."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

from pydantic import PrivateAttr

from simulators.faults.fault import Fault, Stream
from simulators.faults.packets import Packet, PacketFault


class Stall(PacketFault):
    """Nothing is sent for a while, then everything at once."""

    needs: ClassVar = ("when", "for")
    kind: Literal["stall"]

    def _change(self, packet: Packet) -> list[Packet]:
        self.count()
        return [replace(packet, due=max(packet.due, self._until))]


class Unplug(Fault):
    """The line is gone for a while, then it is there again. Counts how often."""

    needs: ClassVar = ("when", "for")
    kind: Literal["unplug"]

    _out: bool = PrivateAttr(False)

    def start(self, stream: Stream) -> None:
        super().start(stream)
        self._out = False

    def unplugged(self, t: float) -> bool:
        """Whether the line is gone at `t`, seconds of the stream."""
        out = self.acts(t)
        self.count(out and not self._out)
        self._out = out
        return out
