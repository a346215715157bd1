"""What every sink is: a callable that takes a pose, closable."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from bridge.pose import Pose
from drivers.errors import MarkerbridgeError
from drivers.frame import Floats, MarkerFrame
from drivers.session_log import LineBytes, LineEvent

if TYPE_CHECKING:
    from bridge.model import ModelInfo

Input = LineBytes | LineEvent | MarkerFrame  # what comes into a session


class SinkError(MarkerbridgeError):
    """A sink cannot be opened or written; the message names it and says what to do."""


class SinkClosed(SinkError):
    """Nobody wants poses any more, and nothing is wrong: the sink gets no more of them."""


class ViewError(SinkError):
    """The view cannot be shown here; the rest of a session goes on without it."""


@dataclass(slots=True)
class SinkContext:
    """What a sink may know of the session.

    truth: the true pose (M, 3) of a frame index where the simulator sent it, else None. rate: the
    stream's, in Hz; set when its layout is known. model: its file; set when the session begins.
    performer: whose poses they are; empty where there is one alone.
    """

    info: ModelInfo
    truth: Callable[[int], Floats | None]
    rate: float = 120.0
    model: Path | None = None
    performer: str = ""


class Sink(ABC):
    """Called with each pose on a thread of its own, so a slow sink holds up nobody else.

    waiting: how many poses may wait for it before the oldest is dropped (and counted); None: any
    number, nothing is dropped. rate: most poses a second; beyond it the newest wins. 0: no limit.
    records: whether it is also told all that comes in, by `record`. wants_posture: whether its
    poses are to have one. prompt: a call never waits for anything, so it may be made on the thread
    that estimates. one_body: who receives it knows of one performer alone. receiver: host and port
    of who does; None where that is nobody on a network.
    """

    name: str
    waiting: int | None = 120
    rate: float = 0.0
    records: bool = False
    wants_posture: bool = False
    prompt: bool = False
    one_body: bool = False
    receiver: tuple[str, int] | None = None

    @abstractmethod
    def __call__(self, pose: Pose) -> None:
        """Sends or stores a pose. Raises OSError or SinkError where it cannot."""

    def record(self, came: Input) -> None:
        """Stores what came in. Raises OSError where it cannot."""
        raise NotImplementedError

    @abstractmethod
    def close(self) -> None:
        """Ends and saves; a second call does nothing."""


class Closable(Protocol):
    """What `close_all` closes."""

    def close(self) -> None: ...


def close_all(things: Iterable[Closable]) -> None:
    """Closes all of them. Raises the first SinkError, after all else is closed."""
    errors = []
    for thing in things:
        try:
            thing.close()
        except SinkError as error:
            errors.append(error)
    if errors:
        raise errors[0]
