r"""Continuous records of Polhemus trackers: FASTRAK, and LIBERTY with PATRIOT and LATUS alike.

A record per station and frame, stations in numerical order; a station that is off sends none. What
a record holds is the tracker's output list, in the maker's numbers (his command `O`):

    FASTRAK  `0`, station 1 to 4 (of compatible trackers to 12, in hex), error letter or blank, then
             the list: numbers as Sxxx.xx, of extended precision as Sx.xxxxxESxx and a blank; binary
             as float32. Replies to commands are lines that begin with `2`.
    LIBERTY  ASCII: station in two digits, error letter or blank, then the list: numbers as Sxxx.xxx
             and a blank. Binary: `LY` (or `PA`, `LU`), station u8, command u8, error u8, reserved
             u8, size of the list u16, then the list: float32, u32. Replies look alike.

Binary is little endian; item 1 of the list is a carriage return and line feed in both formats.
Source: the maker's FASTRAK user manual (OPM00PI002 rev. G, 2012: commands C, f, l, O, S and the
system data record). LIBERTY's records are as programs in use read them (VRPN and others); as the
columns of its text are not certain, any width and precision is taken.
"""

from __future__ import annotations

import math
import re
import struct
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from drivers.frame import Floats, Layout, MarkerFrame
from drivers.url import Url
from drivers.wire.assembler import Assembled, Assembler, take_rate

FRAME = "fastrak"  # inches; x forward, y to the right, z down

LONGEST = 1024  # bytes that may wait for a record, a reply to a command among them
RANGE = 1000.0  # inches or centimetres: a record has three digits before the point


class _Text(NamedTuple):
    """How a number is written in ASCII, and its pattern."""

    form: str
    pattern: bytes


# Sxxx.xx, Sx.xxxx and Sx.xxxxxESxx with a blank, each of fixed width.
_TWO = _Text("%7.2f", rb"([-+ \d]{3}\d\.\d\d)")
_FOUR = _Text("%7.4f", rb"([-+ ]\d\.\d{4})")
_EXTENDED = _Text("%12.5E ", rb"([-+ ]\d\.\d{5}E[-+]\d\d) ")
# LIBERTY parts its numbers by blanks. Possessive: no rubbish is tried in more than one way.
_FREE = rb" {0,8}+([-+]? {0,3}+\d{1,4}+\.\d{1,6}+(?:E[-+]?\d{1,3}+)?)"
_WHOLE = _Text("%10d ", rb" {0,11}+(-?\d{1,10}+)")


class _Item(NamedTuple):
    """Part of a record: struct code and text of its numbers, how large they may be, what a
    simulated tracker gives that does not turn, and what they tell us, if anything.
    """

    code: str
    text: _Text
    limit: float = 0.0
    still: tuple[float, ...] = ()  # a number each; none in a blank or an end of line
    tells: str = ""

    def pattern(self, *, binary: bool) -> bytes:
        if not binary:
            return self.text.pattern * max(len(self.still), 1)
        if self.still:
            return b".{%d}" % struct.calcsize("<" + self.code)
        return re.escape(self.text.form.encode())

    def write(self, numbers: Sequence[float], *, binary: bool) -> bytes:
        if not self.still:
            return self.text.form.encode()
        if binary:
            return struct.pack("<" + self.code, *numbers)
        return "".join(self.text.form % number for number in numbers).encode()


_BLANK = _Item("x", _Text(" ", b" ?"))
_END = _Item("2x", _Text("\r\n", rb" {0,2}\r?\n"))
_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_LEVEL = (0.0, 0.0, 0.0)
_UPRIGHT = (1.0, 0.0, 0.0, 0.0)

_FASTRAK_ITEMS = {
    0: _BLANK,
    1: _END,
    2: _Item("3f", _TWO, RANGE, _LEVEL, "xyz"),
    4: _Item("3f", _TWO, 180.5, _LEVEL),  # azimuth, elevation, roll in degrees
    5: _Item("3f", _FOUR, 1.001, _X),  # direction cosines
    6: _Item("3f", _FOUR, 1.001, _Y),
    7: _Item("3f", _FOUR, 1.001, _Z),
    11: _Item("4f", _FOUR, 1.001, _UPRIGHT),  # quaternion
    50: _BLANK,
    51: _END,
    52: _Item("3f", _EXTENDED, RANGE, _LEVEL, "xyz"),
    54: _Item("3f", _EXTENDED, 180.5, _LEVEL),
    55: _Item("3f", _EXTENDED, 1.001, _X),
    56: _Item("3f", _EXTENDED, 1.001, _Y),
    57: _Item("3f", _EXTENDED, 1.001, _Z),
    61: _Item("4f", _EXTENDED, 1.001, _UPRIGHT),
}
_LIBERTY_ITEMS = {
    0: _BLANK,
    1: _END,
    2: _Item("3f", _Text("%8.3f ", _FREE), RANGE, _LEVEL, "xyz"),
    3: _Item("3f", _Text("%12.5E ", _FREE), RANGE, _LEVEL, "xyz"),
    4: _Item("3f", _Text("%8.3f ", _FREE), 180.5, _LEVEL),
    5: _Item("3f", _Text("%12.5E ", _FREE), 180.5, _LEVEL),
    6: _Item("9f", _Text("%8.5f ", _FREE), 1.001, (*_X, *_Y, *_Z)),
    7: _Item("4f", _Text("%8.5f ", _FREE), 1.001, _UPRIGHT),
    8: _Item("I", _WHOLE, math.inf, (0,), "milliseconds"),
    9: _Item("I", _WHOLE, math.inf, (0,), "frame"),
    10: _Item("i", _WHOLE, math.inf, (0,)),  # stylus button
    11: _Item("i", _WHOLE, math.inf, (0,)),  # distortion
}


class _Form(NamedTuple):
    """What records of one model in one format are made of."""

    items: Mapping[int, _Item]
    hello: bytes  # starts continuous output
    stations: int
    head: bytes  # pattern; groups: station and error
    station: Callable[[bytes], int]
    begin: Callable[[int, int], bytes]  # of station and size of the list
    reply: Callable[[bytes], int]  # length of the reply to a command that is there, or 0
    sized: bool = False  # whether the size of the list, u16, ends the head


def _text_reply(pattern: bytes) -> Callable[[bytes], int]:
    compiled = re.compile(pattern)

    def length(data: bytes) -> int:
        found = compiled.match(data)
        return found.end() if found else 0

    return length


def _liberty_reply(data: bytes) -> int:
    if data[:2] not in (b"LY", b"PA", b"LU") or len(data) < 8 or data[3] in b"CcPp":
        return 0
    length = 8 + int.from_bytes(data[6:8], "little")
    return length if length <= len(data) else 0


_FASTRAK = _Form(
    _FASTRAK_ITEMS,
    b"C",
    12,
    rb"0([1-9A-C])([ A-Za-z])",
    lambda text: int(text, 16),
    lambda station, size: b"0%X " % station,
    _text_reply(rb"2[ 1-9A-C][!-~][^\r\n]{0,250}\r\n"),
)
_FORMS = {
    ("fastrak", "ascii"): _FASTRAK,
    ("fastrak", "binary"): _FASTRAK,
    ("liberty", "ascii"): _Form(
        _LIBERTY_ITEMS,
        b"C\r",
        16,
        rb"(0[1-9]|1[0-6]| [1-9])[CPcp ]?([ A-Za-z])",
        int,
        lambda station, size: b"%02d " % station,
        _text_reply(rb"\d\d[^\d\s.][^\r\n]{0,250}\r\n"),
    ),
    ("liberty", "binary"): _Form(
        _LIBERTY_ITEMS,
        b"C\r",
        16,
        rb"(?:LY|PA|LU)([\x01-\x10])[CPcp]([\0 A-Za-z]).",
        ord,
        lambda station, size: struct.pack("<2sB3sH", b"LY", station, b"C \0", size),
        _liberty_reply,
        sized=True,
    ),
}


class _Record(NamedTuple):
    """What a record tells. error: whether the tracker says that something is wrong."""

    station: int
    xyz: Sequence[float]
    seconds: float
    frame: int | None
    error: bool


class Records:
    """The records of a tracker, both ways.

    model: fastrak or liberty. output: the items of its output list, among them a position. Raises
    ValueError for a list that cannot be read.
    """

    def __init__(self, model: str, output: Sequence[int], *, binary: bool) -> None:
        form = self.form = _FORMS[model, "binary" if binary else "ascii"]
        for number in output:
            if number not in form.items:
                known = ", ".join(map(str, form.items))
                raise ValueError(f"item {number} cannot be read (known are {known})")
        self._items = [form.items[number] for number in output]
        told = [item.tells for item in self._items for _ in item.still]
        if "xyz" not in told:
            raise ValueError("a record without a position: put item 2 in")
        if not binary and self._items[-1] is not _END:
            raise ValueError("a record in ASCII ends with item 1, the end of the line")
        self._place = told.index("xyz")
        self._milliseconds, self._frame = (
            told.index(what) if what in told else None for what in ("milliseconds", "frame")
        )
        self._limits = [item.limit for item in self._items for _ in item.still]
        self.binary = binary
        self._struct = struct.Struct("<" + "".join(item.code for item in self._items))
        # Bytes of a record and of the head behind it; in ASCII no more than that.
        self.longest = 16 + (self._struct.size if binary else 13 * len(self._limits))
        self.pattern = re.compile(self._pattern(), re.DOTALL)

    def _pattern(self) -> bytes:
        body = b"".join(item.pattern(binary=self.binary) for item in self._items)
        if not self.binary:  # an exponent looks like a head, but not at the beginning of a line
            return rb"(?<![^\n])" + self.form.head + body
        size = re.escape(struct.pack("<H", self._struct.size)) if self.form.sized else b""
        # Bytes may have been lost in the midst of it: what comes behind tells.
        behind = b"" if self._items[-1] is _END else b"(?=%s)" % self.form.head
        return self.form.head + size + b"(" + body + b")" + behind

    def read(self, found: re.Match[bytes]) -> _Record | None:
        """What a match of `pattern` tells; None where its numbers cannot be meant."""
        numbers: Sequence[float]
        if self.binary:
            numbers = self._struct.unpack(found[3])
        else:
            try:
                numbers = [float(text.replace(b" ", b"")) for text in found.groups()[2:]]
            except ValueError:  # a sign among the digits
                return None
        for number, limit in zip(numbers, self._limits, strict=True):
            if not -limit <= number <= limit:  # nor does NaN
                return None
        at, error = self._place, found[2] not in (b" ", b"\0")
        seconds = math.nan if self._milliseconds is None else numbers[self._milliseconds] / 1000
        frame = None if self._frame is None else int(numbers[self._frame])
        return _Record(self.form.station(found[1]), numbers[at : at + 3], seconds, frame, error)

    def write(self, station: int, xyz: Sequence[float], seconds: float, frame: int) -> bytes:
        """A record of a station that does not turn."""
        told = {
            "xyz": xyz,
            "milliseconds": [round(seconds * 1000) & 0xFFFFFFFF],
            "frame": [frame & 0xFFFFFFFF],
        }
        body = b"".join(
            item.write(told.get(item.tells, item.still), binary=self.binary) for item in self._items
        )
        return self.form.begin(station, self._struct.size) + body


class FastrakEncoder:
    """Frames to records; the tracker's side of the wire. A missing marker's station is off."""

    def __init__(self, records: Records) -> None:
        self._records = records
        self._stations: list[int] = []

    def encode_layout(self, layout: Layout) -> bytes:
        """Nothing: a tracker knows stations only. Raises ValueError for labels that are none."""
        known = {str(number) for number in range(1, self._records.form.stations + 1)}
        unknown = [label for label in layout.labels if label not in known]
        if unknown:
            raise ValueError(
                f"a tracker of this kind has stations 1 to {len(known)}, not {unknown[0]}: write "
                "for example labels=1:C7,2:LSHO,3:RSHO in the address, for each marker"
            )
        self._stations = [int(label) for label in layout.labels]
        return b""

    def encode_frame(self, index: int, t_device: float, xyz: Floats) -> bytes:
        """The records of one frame; `encode_layout` comes first."""
        stations = sorted(zip(self._stations, xyz.tolist(), strict=True))
        return b"".join(
            self._records.write(station, place, t_device, index)
            for station, place in stations
            if all(abs(number) < RANGE - 0.01 for number in place)
        )

    def has_hello(self, data: bytes) -> bool:
        return b"C" in data


class FastrakDecoder(Assembled):
    """Records to frames, the stations as labels. Counts `bad_record` (also what is none),
    `replies` to commands, records that the tracker marks as doubtful (`flagged`; they are read: the
    mark stays until it is asked for), and what the Assembler counts.

    rate: the stream's in Hz where it is known, else it is measured.
    """

    def __init__(self, records: Records, rate: float | None = None) -> None:
        self.hello = records.form.hello
        self._records = records
        order = [str(number + 1) for number in range(records.form.stations)]
        self._frames = Assembler(Counter(), rate, order)
        self._buffer = b""

    def reset(self) -> None:
        self._frames.reset()
        self._buffer = b""

    def feed(self, data: bytes, t: float) -> list[MarkerFrame]:
        frames: list[MarkerFrame] = []
        buffer = self._buffer + data
        at = search = 0  # the end of the newest record, and where the next is looked for
        while found := self._records.pattern.search(buffer, search):
            record = self._records.read(found)
            if record is None:
                search = found.start() + 1
                continue
            self._account(buffer[at : found.start()])
            at = search = found.end()
            if record.error:
                self.counters["flagged"] += 1
            label = str(record.station)
            frames += self._frames.add(label, record.xyz, t, record.seconds, record.frame)
        rest = buffer[at:]
        if len(rest) > LONGEST:
            self._account(rest[: -self._records.longest])
            rest = rest[-self._records.longest :]
        self._buffer = rest
        return frames

    def _account(self, data: bytes) -> None:
        """Counts what came between two records: replies, and lines or a piece of rubbish."""
        while data.strip():
            length = self._records.form.reply(data)
            self.counters["replies" if length else "bad_record"] += 1
            if not length and not self._records.binary:
                length = data.find(b"\n") + 1
            data = data[length or len(data) :]


def open_decoder(url: Url) -> FastrakDecoder:
    """The host's side of the wire. Options `model`, `format`, `fields`, `rate`. Raises UrlError."""
    return FastrakDecoder(_take_records(url), take_rate(url))


def open_encoder(url: Url) -> FastrakEncoder:
    """The tracker's side of the wire. Options `model`, `format`, `fields`. Raises UrlError."""
    return FastrakEncoder(_take_records(url))


def _take_records(url: Url) -> Records:
    model = url.take("model", "fastrak", _among("fastrak", "liberty"))
    binary = url.take("format", "ascii", _among("ascii", "binary")) == "binary"

    def read(text: str) -> Records:
        numbers = text.split(",")
        if not all(number.isdecimal() and len(number) <= 2 for number in numbers):
            raise ValueError("it is the list of the command O, for example 2,4,1")
        return Records(model, [int(number) for number in numbers], binary=binary)

    return url.take("fields", Records(model, (2, 4, 1), binary=binary), read)


def _among(*known: str) -> Callable[[str], str]:
    def check(text: str) -> str:
        if text not in known:
            raise ValueError(f"known are {', '.join(known)}")
        return text

    return check
