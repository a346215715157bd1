"""OSC packets made once, of which only the floats change from frame to frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from bridge.uncertainty import Mask
from drivers.frame import Floats
from drivers.wire.osc import build, build_bundle, sized

_HEAD = len(build_bundle([]))  # bytes before the first message


class Template(NamedTuple):
    """A message, with its size before it, whose last floats change."""

    element: bytes
    floats: int


def template(address: str, *fixed: tuple[str, int | float | str], floats: int = 0) -> Template:
    """A message of fixed arguments, each with its type tag, and then floats."""
    return Template(sized(build(address, *fixed, *[("f", 0.0)] * floats)), floats)


class Bundles:
    """Messages in as few bundles as hold them, of at most `limit` bytes each."""

    def __init__(self, templates: Sequence[Template], limit: int) -> None:
        self._parts = [_part(group) for group in _grouped(templates, limit)]

    def filled(self, values: Floats) -> Iterator[bytearray]:
        """The bundles with these floats, in order; overwritten by the next call."""
        for datagram, words, places in self._parts:
            words[places] = values[: len(places)]
            values = values[len(places) :]
            yield datagram


class Selection:
    """A head, and messages of which some may be left out, or sent in another form, for a while.

    head: its floats. rows: (N, K), those of the N messages. Both are written into.
    """

    def __init__(
        self,
        head: Sequence[Template],
        things: Sequence[Template],
        limit: int,
        *,
        hidden: Sequence[Template] | None = None,
    ) -> None:
        """hidden: the other form; where there is none, messages are left out."""
        self._head, self._things, self._hidden = head, things, hidden
        self._limit = limit
        first = sum(one.floats for one in head)
        self._values = np.zeros(first + sum(one.floats for one in things), np.float32)
        self.head = self._values[:first]
        self.rows = self._values[first:].reshape(len(things), -1)
        self._mask = b""
        self._is_whole = True
        self._bundles = Bundles([], limit)

    def filled(self, shown: Mask) -> Iterator[bytearray]:
        """The bundles of those of the N messages that are shown; overwritten by the next call."""
        mask = shown.tobytes()
        if mask != self._mask:
            self._mask = mask
            self._is_whole = self._hidden is not None or bool(shown.all())
            self._bundles = Bundles([*self._head, *self._chosen(shown)], self._limit)
        if self._is_whole:
            return self._bundles.filled(self._values)
        return self._bundles.filled(np.concatenate([self.head, self.rows[shown].ravel()]))

    def _chosen(self, shown: Mask) -> list[Template]:
        if self._hidden is None:
            return [one for one, here in zip(self._things, shown, strict=True) if here]
        forms = zip(self._things, self._hidden, shown, strict=True)
        return [one if here else other for one, other, here in forms]


def _part(group: Sequence[Template]) -> tuple[bytearray, np.ndarray, np.ndarray]:
    """A bundle, its four-byte words as floats, and which of these are."""
    places: list[int] = []
    end = _HEAD
    for element, floats in group:
        end += len(element)
        places.extend(range(end // 4 - floats, end // 4))  # OSC aligns all to four bytes
    datagram = bytearray(build_bundle(element for element, _ in group))
    return datagram, np.frombuffer(datagram, ">f4"), np.array(places, int)


def _grouped(templates: Sequence[Template], limit: int) -> Iterator[list[Template]]:
    group: list[Template] = []
    size = _HEAD
    for one in templates:
        if group and size + len(one.element) > limit:
            yield group
            group, size = [], _HEAD
        group.append(one)
        size += len(one.element)
    if group:
        yield group
