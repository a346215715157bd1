"""All faults of a device, one after the other."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from drivers.frame import Floats, Layout
from simulators.faults.fault import Stream
from simulators.faults.line import Unplug
from simulators.faults.markers import Ghost, MarkerFault
from simulators.faults.packets import Packet, PacketFault
from simulators.faults.plan import KINDS, FaultPlan
from simulators.faults.stamps import StampFault


class FaultChain:
    """What a plan does to one stream; the same plan and seed do the same again.

    They act in the order of `KINDS`, whatever the plan's: a copy of a packet may come late, what
    is lost is not delayed. `layout` is what the device sends: `layout` given, and the labels that
    ghosts bring with them.
    """

    def __init__(self, plan: FaultPlan, layout: Layout, seed: int | None = None) -> None:
        """seed: in place of the plan's."""
        ghosts = [one.label for one in plan.fault if isinstance(one, Ghost) and one.label]
        extra = tuple(label for label in dict.fromkeys(ghosts) if label not in layout.labels)
        self.layout = Layout((*layout.labels, *extra), layout.rate)
        self.counters: Counter[str] = Counter()
        seed = plan.seed if seed is None else seed
        faults = [fault.model_copy() for fault in plan.fault]  # they have state, the plan has none
        for number, fault in enumerate(faults):
            random = np.random.default_rng([seed, number])
            fault.start(Stream(self.layout, random, self.counters))
        faults.sort(key=lambda fault: KINDS.index(type(fault)))
        self._markers = [fault for fault in faults if isinstance(fault, MarkerFault)]
        self._stamps = [fault for fault in faults if isinstance(fault, StampFault)]
        self._packets = [fault for fault in faults if isinstance(fault, PacketFault)]
        self._plugs = [fault for fault in faults if isinstance(fault, Unplug)]

    def markers(self, t: float, xyz: Floats) -> Floats:
        """(M, 3) metres that were measured at `t`, seconds of the stream, as `layout` has them."""
        seen = np.full((len(self.layout.labels), 3), np.nan, np.float32)
        seen[: len(xyz)] = xyz
        for fault in self._markers:
            fault.apply(t, seen)
        return seen

    def stamp(self, t: float) -> float:
        """The device's clock at `t`, both in seconds of the stream."""
        return math.fsum([t, *(fault.gained(t) for fault in self._stamps)])

    def packets(self, packet: Packet) -> list[Packet]:
        """What becomes of a packet on its way to the line."""
        packets = [packet]
        for fault in self._packets:
            packets = [after for before in packets for after in fault.apply(before)]
        return packets

    def unplugged(self, t: float) -> bool:
        """Whether the line is gone at `t`; asked once a frame."""
        out = [fault.unplugged(t) for fault in self._plugs]  # each of them counts
        return any(out)
