"""Whose stream it is, when several programs send to one port."""

from __future__ import annotations

from collections import OrderedDict
from enum import Enum, auto
from functools import cached_property

from drivers.frame import MarkerFrame
from drivers.transport import Received
from drivers.wire_source import WireSource

SILENCE = 1.0  # s after which an owner that says nothing may be followed by another
ESTABLISHED = 3  # packets that make a sender more than one that says a single thing (oscsend)
REMEMBERED = 64  # senders
NO_USE = ("bad_osc", "bad_packet", "foreign")  # counters of packets that no stream is made of


class Verdict(Enum):
    """What is to be done with a packet."""

    TAKE = auto()
    TAKE_OVER = auto()  # of another sender of the same stream, such as a program started for each
    START_ANEW = auto()  # of another stream
    REFUSE = auto()


class Ownership:
    """One sender owns the stream. While an established one is heard, no other is taken in."""

    def __init__(self) -> None:
        self.owner = ""  # as `127.0.0.1:40312`
        self._heard = 0.0
        self._packets: OrderedDict[str, int] = OrderedDict()  # of each sender, the newest last

    def hear(self, sender: str, t: float) -> Verdict:
        """Judges a packet that came at `t`, in seconds."""
        former, established = self.owner, self._packets.get(self.owner, 0) >= ESTABLISHED
        if sender != former and established and t - self._heard < SILENCE:
            return Verdict.REFUSE
        self.owner, self._heard = sender, t
        self._packets[sender] = self._packets.pop(sender, 0) + 1
        if len(self._packets) > REMEMBERED:
            self._packets.popitem(last=False)
        if sender == former or not former:
            return Verdict.TAKE
        if established or _host(sender) != _host(former):
            return Verdict.START_ANEW
        return Verdict.TAKE_OVER

    def discount(self) -> None:
        """The owner's newest packet was of no use: such packets establish nobody."""
        self._packets[self.owner] -= 1


class OwnedSource(WireSource):
    """A WireSource on a line that several may send to: it reads its owner.

    Counts packets of another sender while the owner is heard (`other_sender`), and
    `sender_changes`.
    """

    @cached_property
    def ownership(self) -> Ownership:
        """Who is listened to."""
        return Ownership()

    def _decode(self, received: Received) -> list[MarkerFrame]:
        owner = self.ownership.owner
        verdict = self.ownership.hear(received.sender, received.t)
        if verdict is Verdict.REFUSE:
            self.counters["other_sender"] += 1
            self._say_refused(owner, received.sender)
            return []
        if verdict is not Verdict.TAKE:
            self.counters["sender_changes"] += 1
        if verdict is Verdict.START_ANEW:
            self._ready.extend(self._finished(self._sequence.flush()))
            self._start_anew()
        of_no_use = self._of_no_use
        frames = super()._decode(received)
        if not frames and self._of_no_use > of_no_use:
            self.ownership.discount()
        return frames

    @property
    def _of_no_use(self) -> int:
        return sum(self.counters[name] for name in NO_USE)

    def _say_refused(self, owner: str, sender: str) -> None:
        """For who has something to say of a packet that is not read."""


def _host(sender: str) -> str:
    return sender.rpartition(":")[0]
