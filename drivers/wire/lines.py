r"""Text lines, for whoever writes a sender with printf (docs/wires.md).

    LABEL x y z                                   a marker
    LABEL                                         a marker that is not seen (or LABEL nan)
                                                  an empty line: the frame is whole
    #INDEX @SECONDS LABEL x y z LABEL x y z ...   a whole frame; # and @ may each be left out

Between the parts are blanks, tabs or commas; a line ends with \n or \r\n. A line with # or @, or of
more than one marker, is a whole frame; the markers of other lines are collected (`Assembler`).
`*hh` at the end of a line is the XOR of all bytes before it, in hex, as NMEA 0183 has it.
Labels are ASCII without blanks, commas, `*`, and # or @ in front.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from drivers.frame import Floats, Layout, MarkerFrame
from drivers.url import Url
from drivers.wire.assembler import MOST, Assembled, Assembler, take_rate
from drivers.wire.packets import PacketBuffer

FRAME = "cmu"  # metres, Z up

MAX_LINE = 32_768  # bytes; longer than a frame of 255 markers
LARGEST = 1e30  # of a number: what a float32 holds with room to spare
BELIEVED = 10  # lines in a row that lack what all had before: then that is how they are now

_CHECKSUM = re.compile(rb"\*([0-9A-Fa-f]{2})\s*$")
_LABEL = re.compile(r"(?![#@])[!-)+\--~]{1,255}")  # printable, but no comma and no *


def checksum(line: bytes) -> int:
    """The XOR of all bytes."""
    return int(np.bitwise_xor.reduce(np.frombuffer(line, np.uint8)))


class LinesEncoder:
    """Frames to lines; the device's side of the wire. by_marker: a line per marker, and an empty
    one after each frame, in place of one line a frame.
    """

    def __init__(self, *, by_marker: bool = False) -> None:
        self._by_marker = by_marker
        self._labels: tuple[str, ...] = ()

    def encode_layout(self, layout: Layout) -> bytes:
        """Nothing: the labels stand in each line. Raises ValueError for one that cannot."""
        for label in layout.labels:
            if not is_label(label):
                raise ValueError(
                    f"label '{label}': a line carries labels of ASCII without blanks, commas and "
                    "*, not beginning with # or @"
                )
        self._labels = layout.labels
        return b""

    def encode_frame(self, index: int, t_device: float, xyz: Floats) -> bytes:
        """A frame in lines; `encode_layout` comes first. Missing markers are left out."""
        parts = [
            f"{label} {x:.9g} {y:.9g} {z:.9g}"
            for label, (x, y, z) in zip(self._labels, xyz.tolist(), strict=True)
            if not (math.isnan(x) or math.isnan(y) or math.isnan(z))
        ]
        if self._by_marker:
            return "\n".join([*parts, "", ""]).encode("ascii")
        line = " ".join([f"#{index} @{t_device:.6f}", *parts]).encode("ascii")
        return b"%s*%02X\n" % (line, checksum(line))

    def has_hello(self, data: bytes) -> bool:
        return False


class LinesDecoder(Assembled):
    """Lines to frames. Counts `bad_line` (also what a board says when it starts), `bad_checksum`,
    `overlong`, and what the Assembler counts; whatever it met, it reads the next good line. Once
    lines have checksums or indices, one without is a spoilt one.

    required: lines without a checksum are refused from the first. rate: the stream's in Hz where it
    is known, else it is measured.
    """

    hello = b""  # a sender that is five lines of printf listens to nothing

    def __init__(self, *, required: bool = False, rate: float | None = None) -> None:
        self._required = required
        self._frames = Assembler(Counter(), rate)
        self._buffer = PacketBuffer(b"\n", MAX_LINE)
        self._checksums, self._indices = _Habit(), _Habit()

    def reset(self) -> None:
        self._frames.reset()
        self._buffer.clear()
        self._checksums, self._indices = _Habit(), _Habit()

    def feed(self, data: bytes, t: float) -> list[MarkerFrame]:
        frames: list[MarkerFrame] = []
        for line in self._buffer.feed(data):
            if line is None:
                self.counters["overlong"] += 1
            elif not line.strip():
                frames += self._frames.end()
            else:
                frames += self._read(line, t)
        return frames

    def _read(self, line: bytes, t: float) -> list[MarkerFrame]:
        found = _CHECKSUM.search(line)
        if found:
            line = line[: found.start()]
            good = int(found[1], 16) == checksum(line)
        else:
            good = not (self._required or self._checksums.is_broken())
        if not good:
            self.counters["bad_checksum"] += 1
            return []
        if found:
            self._checksums.keep()
        try:
            words = line.decode("ascii").replace(",", " ").split()
            head = _take_head(words)
            markers = _read_markers(words) if words or not head else {}
            seconds, index = head.get("@", math.nan), head.get("#")
            if index is not None:
                self._indices.keep()
            elif self._indices.is_broken():
                raise ValueError("no index, and all others had one")
            if head or len(markers) > 1:
                return self._frames.put(markers, t, seconds, None if index is None else int(index))
            return self._add(markers, t)
        except ValueError:
            self.counters["bad_line"] += 1
            return []

    def _add(self, markers: Mapping[str, Sequence[float]], t: float) -> list[MarkerFrame]:
        ((label, xyz),) = markers.items()
        if math.isnan(xyz[0]) and (self.layout is None or label not in self.layout.labels):
            raise ValueError("a word, and no marker that we know")
        return self._frames.add(label, xyz, t)


class _Habit:
    """Whether the lines of a stream have something."""

    def __init__(self) -> None:
        self._without = BELIEVED  # lines in a row

    def keep(self) -> None:
        """A line has it."""
        self._without = 0

    def is_broken(self) -> bool:
        """A line has it not; whether that is unusual."""
        self._without += 1
        return self._without < BELIEVED


def is_label(text: str) -> bool:
    """Whether a line can carry this label."""
    return _LABEL.fullmatch(text) is not None


def open_decoder(url: Url) -> LinesDecoder:
    """The host's side of the wire. Options `checksum=required` and `rate`. Raises UrlError."""
    required = url.take("checksum", False, _one("required"))
    return LinesDecoder(required=required, rate=take_rate(url))


def open_encoder(url: Url) -> LinesEncoder:
    """The device's side of the wire. Option `style=markers`. Raises UrlError."""
    return LinesEncoder(by_marker=url.take("style", False, _one("markers")))


def _one(word: str) -> Callable[[str], bool]:
    """Reads an option that has but one value."""

    def read(text: str) -> bool:
        if text != word:
            raise ValueError(f"known is {word}")
        return True

    return read


def _take_head(words: list[str]) -> dict[str, float]:
    """Takes #INDEX and @SECONDS off the front. Raises ValueError."""
    head: dict[str, float] = {}
    while words and words[0][0] in "#@":
        kind, number = words[0][0], words.pop(0)[1:]
        if kind in head or (kind == "#" and not (number.isdecimal() and len(number) <= 15)):
            raise ValueError("no number of a frame")
        head[kind] = _number(number)
        if math.isnan(head[kind]):
            raise ValueError("no time")
    return head


def _read_markers(words: list[str]) -> Mapping[str, Sequence[float]]:
    """Labels and positions. Raises ValueError."""
    if len(words) == 1 or (len(words) == 2 and words[1].lower() == "nan"):
        words = [words[0], "nan", "nan", "nan"]
    labels = words[::4]
    if not labels:
        raise ValueError("nothing")
    places = [map(_number, words[1::4]), map(_number, words[2::4]), map(_number, words[3::4])]
    markers = dict(zip(labels, zip(*places, strict=True), strict=True))
    if len(markers) != len(labels) or len(labels) > MOST or not all(map(is_label, labels)):
        raise ValueError("labels that are none, too many, or twice")
    return markers


def _number(text: str) -> float:
    """A number, or NaN. Raises ValueError for what only Python calls a number."""
    value = float(text)
    if abs(value) > LARGEST or "_" in text:
        raise ValueError(f"{text} is no number")
    return value
