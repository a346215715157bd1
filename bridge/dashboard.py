"""A session on one screen: what matters most is on top and largest, and it fits any terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from bridge.statistics import Ages, MarkerStatus
from bridge.troubles import LOST, troubles
from bridge.watch import HARMLESS
from drivers.url import short

if TYPE_CHECKING:
    from bridge.session import Status

WORST_RMS = 200.0  # mm at the end of the bar
WIDE, TALL = 110, 30  # from which the markers have a table of their own
WIDEST = 140  # columns: in wider rows figures would stand far from what they tell of
TABLE = 40  # columns of that table
CELL = 15  # columns that a large figure needs
HEADING = 9  # columns
WIDTHS = {"max": 7, "per s": 7, "in all": 10, "lost": 7}  # of columns of hops; others have 6
NAME = 16  # columns that the name of a hop has at the least
MARKS = {
    "measured": "black on green",
    "imputed": "bold black on yellow",
    "lost": "bold white on red",
}
LOSSES = {"dropped": "dropped", "rate_limited": "over its rate", "errors": "failed"}
# Counters that other figures tell.
TOLD = {"frames", "bytes", "layouts", "answers", "fifo_overflow"}

PARTS = ("", *"▏▎▍▌▋▊▉")  # of a letter of a bar, in eighths
ASCII = str.maketrans("█▏▎▍▌▋▊▉·…", "#...####.~")  # for terminals that lack them

Block = list[Text]  # lines, each within the width


class _Hop(NamedTuple):
    """How old what passes is, how much passes, and how much is lost; None: not told apart."""

    name: str
    ages: Ages
    passed: Callable[[Status], int] | None = None
    lost: int | None = None


@dataclass(frozen=True, slots=True)
class Dashboard:
    """Draws a status at the width and height that there is.

    before: the status of some seconds earlier, against which rates are told. ended: it is drawn for
    the last time, whole, however high.
    """

    title: str
    status: Status
    before: Status | None = None
    ended: bool = False

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        height = None if self.ended else options.size.height
        for line in self.lines(options.max_width, height):
            # Cropped where letters are wider than they are counted here.
            line.no_wrap, line.overflow = True, "crop"
            if options.ascii_only:
                line.plain = line.plain.translate(ASCII)
            yield line

    def lines(self, width: int, height: int | None) -> list[Text]:
        """All lines, or what fits; the last one is empty while it goes on: a ^C has room there."""
        blocks = [block for block in self._blocks(min(width, WIDEST), height) if block]
        room = None if height is None else height - 1
        wanted = sum(map(len, blocks)) + len(blocks) - 1
        if room is None or wanted <= room:
            lines = [line for block in blocks for line in (Text(), *block)][1:]
        else:
            lines = [line for block in blocks for line in block][:room]
        return lines if self.ended else [*lines, Text()]

    def _blocks(self, width: int, height: int | None) -> Iterator[Block]:
        over = self.ended and self.status.frames > 0  # and what it did tells more
        found = [] if over else troubles(self.status, self.before)
        state, colour = ("", "cyan") if self.ended else ("running", "green")
        if found:
            state, colour = found[0].state, "red" if found[0].grave else "yellow"
        yield self._header(state, colour, width)
        yield [
            Text(line, "bold red" if trouble.grave else "bold yellow")
            for trouble in found
            for line in textwrap.wrap(
                trouble.words, width - 1, initial_indent=" ", subsequent_indent="   "
            )
        ]
        yield self._figures(width)
        if self.status.performers:
            yield self._performers(width)
            yield self._hops(width)
            yield self._sinks(width)
            yield self._line(width)
            return
        if width < WIDE or (height is not None and height < TALL) or not self.status.markers:
            yield self._markers(width)
            yield self._hops(width)
            yield self._sinks(width)
            yield self._line(width)
            return
        room = width - TABLE
        left = [*self._hops(room), Text(), *self._sinks(room), *self._line(room)]
        yield [
            Text.assemble(_padded(here or Text(), room), beside or Text())
            for here, beside in zip_longest(left, self._marker_table())
        ]

    def _header(self, state: str, colour: str, width: int) -> Block:
        """A bar over the whole width."""
        title = self.title.removeprefix("markerbridge ")
        left = f"{title}, model {Path(self.status.model).stem}"
        right = f"{state.upper()}  {_clock(self.status.seconds)}"
        room = max(0, width - len(right) - 3)
        return [Text(f" {_shortened(left, room):<{room}} {right} ", f"bold reverse {colour}")]

    def _figures(self, width: int) -> Block:
        """What is read from afar; of a session that has ended, the figures of all of it."""
        status, age = self.status, self.status.ages["estimate"]
        rate = status.frames / max(status.seconds, 1e-9) if self.ended else status.rate
        nominal = f"frames of {status.layout_rate:g}" if status.layout_rate else "frames"
        aged = age.p50 if self.ended else age.now
        cells = [(f"{rate:.1f} Hz", nominal), (f"{_ms(aged)} ms", f"age, p99 {_ms(age.p99)}")]
        if status.markers:
            cells.append((self._measured(), "markers seen"))
        if status.rms_mm is not None and status.rms_now_mm is not None:
            rms = status.rms_mm if self.ended else status.rms_now_mm
            bar = _bar(rms / WORST_RMS, 6)
            cells.append((f"{rms:.0f} mm {bar}", f"RMS, mean {status.rms_mm:.0f}"))
        elif status.truth is not None and status.frames:
            cells.append(("no RMS", missing_truth(status.truth)))
        per_row = len(cells) if width >= CELL * len(cells) else 2
        wide = width // per_row
        lines = []
        for start in range(0, len(cells), per_row):
            row = zip(*cells[start : start + per_row], strict=True)
            large, small = (
                "".join(f" {cell[: wide - 2]:<{wide - 1}}" for cell in at) for at in row
            )
            lines += [Text(large, "bold"), Text(small, "dim")]
        return lines

    def _measured(self) -> str:
        markers = self.status.markers
        if self.ended:
            samples = max(1, self.status.frames * len(markers))
            return f"{1 - sum(marker.missing for marker in markers.values()) / samples:.1%}"
        here = sum(marker.state == "measured" for marker in markers.values())
        return f"{'-' if self._stale else here} of {len(markers)}"

    @property
    def _stale(self) -> bool:
        """Whether the markers are not those of now."""
        return not self.ended and self.status.silent >= LOST

    def _markers(self, width: int) -> Block:
        """The tracked markers in their order, under each how long it is away; who is worst."""
        markers = list(self.status.markers.items())
        if not markers:
            return []
        cell = max(7, 3 + max(len(label) for label, _ in markers))
        per_row = max(1, (width - HEADING) // cell)
        lines = []
        for start in range(0, len(markers), per_row):
            row = markers[start : start + per_row]
            heading = Text("" if start else " MARKERS", "cyan")
            chips = (_padded(self._chip(*marker), cell) for marker in row)
            lines.append(Text.assemble(_padded(heading, HEADING), *chips))
            away = "".join(f" {_away(marker):<{cell - 1}}" for _, marker in row)
            if away.strip() or len(markers) <= per_row:  # a lone row of them does not come and go
                lines.append(Text(" " * HEADING + away, "bold yellow"))
        worst = [f"{label} {share:.1%}" for label, share in self._missing() if share]
        return [*lines, *_flow(" MISSING", worst or ["nothing so far"], width)[:1]]

    def _marker_table(self) -> Block:
        """The tracked markers, the one that is missing most on top."""
        lines = [Text(f" {'MARKERS':<9}{'away':<9}missing", "cyan")]
        for label, share in self._missing():
            marker = self.status.markers[label]
            away, bar = Text(f"{_away(marker):<9}", "bold yellow"), _bar(share, 12)
            lines.append(
                Text.assemble(_padded(self._chip(label, marker), 10), away, f"{share:6.1%} {bar}")
            )
        return lines

    def _chip(self, label: str, marker: MarkerStatus) -> Text:
        return Text(f" {label} ", "dim" if self._stale else MARKS[marker.state])

    def _missing(self) -> list[tuple[str, float]]:
        """Each tracked marker's share of frames in which it was not measured, the largest first."""
        frames = max(1, self.status.frames)
        found = [(label, at.missing / frames) for label, at in self.status.markers.items()]
        return sorted(found, key=lambda item: -item[1])

    def _performers(self, width: int) -> Block:
        """A row each: their rate, how old their poses are, and what is seen of them."""
        name = min(max(map(len, self.status.performers)), max(8, width - 48))
        heading = f" {'PERFORMERS':<{name}}{'per s':>8}{'p50':>7}{'p99':>7}   seen   missing most"
        lines = [Text(heading, "cyan")]
        for performer, status in self.status.performers.items():
            age, markers = status.ages["estimate"], status.markers
            rate = status.frames / max(status.seconds, 1e-9) if self.ended else status.rate
            here = sum(marker.state == "measured" for marker in markers.values())
            worst = max(markers, key=lambda label: markers[label].missing, default="")
            share = markers[worst].missing / max(1, status.frames) if worst else 0.0
            line = Text.assemble(
                f" {_shortened(performer, name):<{max(name, 10)}}{rate:8.1f}",
                f"{_ms(age.p50):>7}{_ms(age.p99):>7}   ",
                (f"{here} of {len(markers)}", "yellow" if here < len(markers) else ""),
                f"   {worst} {share:.1%}" if share else "",
            )
            lines.append(line)
        return lines

    def _hops(self, width: int) -> Block:
        """A row each for the ways in, through and out: ages, rates, losses."""
        status, ages = self.status, self.status.ages
        columns: dict[str, Callable[[_Hop], str]] = {
            "now": lambda hop: _ms(hop.ages.now),
            "worst": lambda hop: _ms(hop.ages.worst),
            "p50": lambda hop: _ms(hop.ages.p50),
            "p99": lambda hop: _ms(hop.ages.p99),
            "max": lambda hop: _ms(hop.ages.max),
            "per s": lambda hop: "" if hop.passed is None else f"{self._rate(hop.passed):.1f}",
            "in all": lambda hop: "" if hop.passed is None else f"{hop.passed(status):,}",
            "lost": lambda hop: "" if hop.lost is None else f"{hop.lost:,}",
        }
        widths = {name: WIDTHS.get(name, 6) for name in columns}
        if self.ended:
            del widths["now"], widths["worst"]
        for name in ("in all", "p50", "worst", "max"):  # what is missed least goes first
            if width - sum(widths.values()) < NAME + 2:
                widths.pop(name, None)
        room = max(0, width - sum(widths.values()) - 2)
        lines = [
            Text(
                f" {'AGE IN MS':<{room}}" + "".join(f"{name:>{widths[name]}}" for name in widths),
                "cyan",
            )
        ]
        for hop in (
            _Hop("line", ages["delay"], _counter("frames"), status.missing_indices),
            _Hop("read", ages["parse"]),
            _Hop("queue", ages["queue"], None, status.source["fifo_overflow"]),
            _Hop("pose", ages["estimate"], lambda at: at.frames),
            *(_sink_hop(name, sink) for name, sink in status.sinks.items()),
        ):
            cells = "".join(f"{columns[name](hop):>{widths[name]}}" for name in widths)
            line = Text(f" {_shortened(hop.name, room):<{room}}{cells}")
            if hop.lost:
                line.stylize("yellow", len(line) - len(f"{hop.lost:,}"))
            lines.append(line)
        return lines

    def _sinks(self, width: int) -> Block:
        """What sinks did not send, and why."""
        lines = []
        for name, sink in self.status.sinks.items():
            items = [f"{sink[key]:,} {word}" for key, word in LOSSES.items() if sink[key]]
            if sink["last_error"]:
                items[-1] += f", last: {sink['last_error']}"
            if items:
                lines += _flow(" SINK", [_shortened(short(name), 30), *items], width)
        return lines

    def _line(self, width: int) -> Block:
        """The counters of the source that are not told elsewhere, trouble first."""
        counts = {
            name: count for name, count in self.status.source.items() if count and name not in TOLD
        }
        items = []
        if self.status.source.get("bytes"):
            items.append(f"{self._rate(_counter('bytes')) / 1000:.1f} kB/s")
        for name in sorted(counts, key=lambda name: (name in HARMLESS, -counts[name])):
            rate = self._rate(_counter(name))
            often = f" ({rate:.1f}/s)" if rate >= 0.05 else ""
            items.append(f"{counts[name]:,} {name}{often}")
        return _flow(" LINE", items, width) if items else []

    def _rate(self, counter: Callable[[Status], int]) -> float:
        """A second, of late; over all of a session that has ended."""
        before = self.before
        seconds = self.status.seconds - (before.seconds if before else 0.0)
        grown = counter(self.status) - (counter(before) if before else 0)
        return grown / seconds if seconds > 0 else 0.0


def missing_truth(truth: Mapping[str, int]) -> str:
    """Why there is no RMS."""
    came = truth.get("frames", 0)
    return f"none of {came} true poses fits a frame" if came else "no true pose has come"


def _counter(name: str) -> Callable[[Status], int]:
    """What reads one of the source's counters."""
    return lambda status: status.source.get(name, 0)


def _sink_hop(name: str, sink: Mapping[str, Any]) -> _Hop:
    lost = sink["dropped"] + sink["errors"]
    return _Hop(short(name), sink["age"], lambda at: at.sinks[name]["sent"], lost)


def _away(marker: MarkerStatus) -> str:
    """How long a marker has not been measured."""
    if marker.state == "measured":
        return ""
    return "lost" if marker.state == "lost" else f"{marker.seconds:.1f} s"


def _flow(heading: str, items: Iterable[str], width: int) -> Block:
    """A heading, and items beside it in as many lines as they need; none is broken."""
    room = width - HEADING - 1
    lines: list[str] = []
    for item in items:
        if lines and len(lines[-1]) + 3 + len(item) <= room:
            lines[-1] += f"   {item}"
        else:
            lines.append(_shortened(item, room))
    first = (heading, *[""] * (len(lines) - 1))
    return [
        Text.assemble((f"{beside:<{HEADING}}", "cyan"), line)
        for beside, line in zip(first, lines, strict=True)
    ]


def _bar(share: float, width: int) -> str:
    eighths = round(min(1.0, share) * 8 * width)
    full = "█" * (eighths // 8) + PARTS[eighths % 8]
    return f"{full:·<{width}}"


def _padded(text: Text, width: int) -> Text:
    text.pad_right(width - len(text))
    return text


def _shortened(text: str, width: int) -> str:
    """With its middle left out where it is too long: both ends of an address say most."""
    if len(text) <= width:
        return text
    head = max(0, width - 1) // 2
    return f"{text[:head]}…{text[len(text) - (width - 1 - head) :]}" if width > 0 else ""


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"


def _ms(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    ms = seconds * 1000
    return f"{ms:.2f}" if ms < 10 else f"{ms:.1f}" if ms < 100 else f"{ms:,.0f}"
