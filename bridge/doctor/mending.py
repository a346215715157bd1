"""What to write into an address: the option for another world, for other labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from bridge.doctor.heard import Heard
from bridge.doctor.worlds import joined, options_of
from drivers.convention import parse_labels
from drivers.coordinates import OURS, Frame


def unit_now(heard: Heard) -> float:
    """The unit that the address says, in metres."""
    return heard.convention.frame.unit if heard.convention else 1.0


def world_option(heard: Heard, world: Frame, unit: float) -> dict[str, str]:
    """What to write where the stream, as it is read, is of this world, and of this unit."""
    if heard.convention is None:
        return {}
    now = heard.convention.frame
    if world == OURS and unit == now.unit:
        return {}
    options = dict(options_of(replace(joined(now, world), unit=unit)))
    if world == OURS and "frame" not in options:
        options = {"unit": options["unit"]}
    if "unit" not in heard.known:  # a file has its own
        options.pop("unit", None)
    return options


def labels_option(
    heard: Heard, renamed: Mapping[str, str], before: Mapping[str, str] | None = None
) -> dict[str, str]:
    """What to write where labels, as they are read and then renamed as `before`, mean others; an
    empty value where the option is to go.
    """
    if heard.convention is None:
        return {}
    labels = heard.convention.labels
    theirs = {ours: name for name, ours in labels.items() if ours in heard.labels}
    pairs = {}
    for label in heard.labels:
        name = theirs.get(label, label)
        first = (before or {}).get(label, label)
        ours = renamed.get(first, first)
        if name != ours:
            pairs[name] = ours
    if not pairs:
        return {"labels": ""}
    text = ",".join(f"{name}:{ours}" for name, ours in pairs.items())
    try:
        if parse_labels(text) != pairs:
            return {}
    except ValueError:  # a foreign label that cannot be written so
        return {}
    return {"labels": text}
