"""What all sinks of engines share: OSC over UDP, the options, and what their receivers need."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from bridge.compiled import compiled
from bridge.pose import Pose, Provenance
from bridge.sinks.sink import Sink, SinkContext
from bridge.uncertainty import Caution, Policy
from drivers.coordinates import UNITS, Frame
from drivers.frame import Floats
from drivers.options import positive
from drivers.udp_sender import UdpSender
from drivers.url import Url


@dataclass(frozen=True, slots=True)
class Profile:
    """What the receivers of a protocol need.

    port: theirs; None: the address names it. rate: the most bundles a second; 0: any number.
    frame: their coordinates.
    """

    port: int | None
    rate: float
    frame: Frame


class Sender(Protocol):
    """Where datagrams go. limit: the largest worth sending, bytes."""

    limit: int

    def send(self, datagram: bytes | bytearray) -> None: ...

    def close(self) -> None: ...


class EngineSink(Sink):
    """Makes datagrams of each pose and sends them; whether anybody listens makes no difference.

    A protocol has a profile and writes `_datagrams`. The options that only it has it takes before
    it calls this `__init__`, to which all others are unknown.
    """

    profile: Profile
    prompt = True
    one_body = True

    def __init__(self, url: Url, context: SinkContext) -> None:
        """Raises UrlError, and AddressError where the host is unknown."""
        self.name = url.text
        self.rate = url.take("rate", self.profile.rate, positive)
        self.caution = Caution(
            url.take("uncertain", Policy.SHOW, parse_policy),
            url.take("sigma", Caution().threshold, parse_length),
        )
        url.finish()
        self.receiver = url.address(self.profile.port)
        self._out = self._sender(url)
        self._start: float | None = None
        self._lost = bytes([Provenance.LOST]) * len(context.info.labels)

    def _sender(self, url: Url) -> Sender:
        """Raises UrlError, and AddressError where the host is unknown."""
        return UdpSender(*url.address(self.profile.port))

    @abstractmethod
    def _datagrams(self, pose: Pose) -> Iterable[bytes | bytearray]:
        """What is sent of a pose; each is sent before the next is made."""

    def __call__(self, pose: Pose) -> None:
        if self._start is None:
            self._start = pose.t
        for datagram in self._datagrams(pose):
            self._out.send(datagram)

    def _seconds(self, pose: Pose) -> float:
        """Since the first pose: seconds since 1970 step by 128 in a float32."""
        return pose.t - (pose.t if self._start is None else self._start)

    def _is_known(self, pose: Pose) -> bool:
        """Whether there is a pose to show: a lost one is not, unless it fades or is held."""
        if self.wants_posture and pose.posture is None:
            return False
        return self.caution.moves or pose.provenance.tobytes() != self._lost

    def close(self) -> None:
        self._out.close()


def one_of(*words: str) -> Callable[[str], str]:
    """An option that is one of these words."""

    def read(text: str) -> str:
        if text not in words:
            raise ValueError(f"known are {', '.join(words)}")
        return text

    return read


def parse_policy(text: str) -> Policy:
    """What becomes of what is in doubt. Raises ValueError."""
    return Policy(one_of(*Policy)(text))


def parse_length(text: str) -> float:
    """`80mm` as metres. Raises ValueError."""
    match = re.fullmatch(r"([0-9.]+)([a-z]+)", text.strip())
    if not match or match[2] not in UNITS:
        raise ValueError("write a length with its unit, for example 80mm")
    return positive(match[1]) * UNITS[match[2]]


class Placing:
    """Writes positions and rotations as a world has them."""

    def __init__(self, frame: Frame) -> None:
        self._order = np.argsort(frame.order).astype(np.int64)
        self._scale = frame.scale
        self._spin = frame.spin

    def write(self, xyz: Floats, turns: Floats, rows: Floats, size: float = 1.0) -> None:
        """Positions (N, 3), made larger by `size`, and rotations (N, 4) of ours beside each other
        into rows (N, 7); none of their zeros negative.
        """
        _write(xyz, turns, self._order, self._scale, self._spin, size, rows)


@compiled("void(f4[:,:], f4[:,::1], i8[::1], f4[::1], f4[::1], f4, f4[:,::1])")
def _write(
    xyz: Floats,
    turns: Floats,
    order: npt.NDArray[np.int64],
    scale: Floats,
    spin: Floats,
    size: float,
    rows: Floats,
) -> None:
    for row in range(len(xyz)):
        for axis in range(3):
            ours = order[axis]
            rows[row, axis] = size * xyz[row, ours] / scale[ours] + 0.0
            rows[row, 3 + axis] = spin[ours] * turns[row, ours] + 0.0
        rows[row, 6] = turns[row, 3] + 0.0
