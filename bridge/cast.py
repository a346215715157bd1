"""Who is in a stream: one performer, or several whose labels begin with their names."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping

from bridge.rehearsal import LEAD, SHORTEST
from bridge.session import Backlog, Session
from drivers.frame import Layout, MarkerFrame, Rows, Source

log = logging.getLogger(__name__)

Part = tuple[Session, MarkerFrame]
_Place = tuple[Session, Layout, Rows]


class Cast:
    """A source, and the sessions of the performers in it.

    sessions: by performer; of a performer whom the source shows alone, all labels are theirs. Of
    several, `ann:LFHD` is ann's LFHD.
    """

    def __init__(self, source: Source, sessions: Mapping[str, Session], *, alone: bool) -> None:
        self.source = source
        self.sessions = dict(sessions)
        self.backlog = Backlog()
        for session in self.sessions.values():
            session.backlog = self.backlog
        self._alone = next(iter(self.sessions.values())) if alone else None
        # The layout, as it came, and where it has whom.
        self._known: tuple[Layout | None, list[_Place]] = None, []

    def parts(self, frame: MarkerFrame) -> list[Part]:
        """Each performer's own part of a frame, where the stream has any of it."""
        if self._alone is not None:
            return [(self._alone, frame)]
        known, places = self._known
        if frame.layout is not known:
            if frame.layout != known:  # a line that comes back tells the same once more
                places = self._places(frame.layout)
            self._known = frame.layout, places
        return [(session, _part(frame, layout, rows)) for session, layout, rows in places]

    def rehearsal_due(self, frame: MarkerFrame) -> float:
        """When to rehearse for the frame that comes after this one; never (infinity) where frames
        come too fast, or for many at a time.
        """
        interval = 1.0 / frame.layout.rate
        if self._alone is None or not self.source.live or interval < SHORTEST:
            return math.inf
        return frame.t + interval - LEAD

    def rehearse(self) -> None:
        """See `Session.rehearse`."""
        if self._alone is not None:
            self._alone.rehearse()

    def record(self, frame: MarkerFrame) -> None:
        """Tells the sinks that record of a frame that is not estimated."""
        for session, part in self.parts(frame):
            session.record(part)

    def _places(self, layout: Layout) -> list[_Place]:
        """Where a layout has whom; says whom it lacks, and who else is there."""
        places: list[_Place] = []
        others = {label.partition(":")[0] for label in layout.labels} - set(self.sessions)
        for name, session in self.sessions.items():
            head = f"{name}:"
            own = [label for label in layout.labels if label.startswith(head)]
            if own:
                labels = tuple(label.removeprefix(head) for label in own)
                _, rows = layout.places(own)
                places.append((session, Layout(labels, layout.rate), rows))
            else:
                log.warning("%s: the stream has no markers of %s", self.source.name, name)
        if others:
            log.warning(
                "%s: the option performers names %s; the stream has others' labels, too: %s",
                *(self.source.name, ", ".join(self.sessions), ", ".join(sorted(others)[:8])),
            )
        return places


def _part(frame: MarkerFrame, layout: Layout, rows: Rows) -> MarkerFrame:
    """These rows of a frame; `dataclasses.replace` takes three times as long."""
    return MarkerFrame(
        *(frame.index, frame.t, frame.t_device, layout, frame.xyz.take(rows, 0)),
        *(frame.t_mapped, frame.t_parsed),
    )
