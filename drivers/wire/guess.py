"""Which codec or dialect bytes are written in: all of them try."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import islice
from urllib.parse import urlencode

from drivers.transport import Received
from drivers.url import Url
from drivers.wire.registry import CODECS, DIALECTS, take_decoder

ENOUGH = 5  # packets that have to make sense
SPOILT = 0.5  # share of those that make none, at most
ALIKE = 0.05  # share by which what a more usual wire makes of the bytes may be less
MOST = 2000  # packets, or reads of a line, that are tried
_VARIANTS = {
    "slip-osc": [{"dialect": name} for name in DIALECTS if name != "native"],
    "fastrak": [
        {"format": "binary"},
        {"model": "liberty"},
        {"model": "liberty", "format": "binary"},
    ],
}
_SENSE = ("no_layout", "layout_mismatch", "layouts")  # whole packets that gave no frame


@dataclass(frozen=True, slots=True)
class Guess:
    """options: what names the wire in an address, as `codec`: `lines`. good, bad: packets that it
    makes sense of, and that it does not.
    """

    options: Mapping[str, str]
    good: int
    bad: int


def guess_wire(scheme: str, received: Iterable[Received]) -> Guess | None:
    """What reads the bytes best, of the codecs (scheme `serial`) or dialects (`osc`); None where
    nothing makes sense of them.
    """
    chunks = list(islice(received, MOST))
    guesses = [_try(scheme, options, chunks) for options in wires(scheme)]
    most = max(guess.good - guess.bad for guess in guesses)
    # Of wires that are much alike the more usual one, unless another makes clearly more of it.
    best = next(guess for guess in guesses if most - guess.good + guess.bad <= ALIKE * abs(most))
    if best.good < ENOUGH or best.bad > SPOILT * (best.good + best.bad):
        return None
    return best


def wires(scheme: str) -> list[dict[str, str]]:
    """The options of each codec (scheme `serial`) or dialect (`osc`), in all that it may be."""
    if scheme == "osc":
        return [{"dialect": name} for name in DIALECTS]
    found = []
    for name in CODECS:
        found += [{"codec": name, **options} for options in ({}, *_VARIANTS.get(name, ()))]
    return found


def _try(scheme: str, options: Mapping[str, str], received: list[Received]) -> Guess:
    decoder, _ = take_decoder(Url.parse(f"{scheme}:?{urlencode(options)}"))
    good = 0
    for chunk in received:
        good += len(decoder.feed(chunk.data, chunk.t))
    counters = decoder.counters
    good += sum(counters[name] for name in _SENSE)
    bad = sum(n for name, n in counters.items() if name.startswith("bad_") or name == "overlong")
    return Guess(options, good, bad)
