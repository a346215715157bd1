"""Findings about the markers: their names, whether they are there, and whether they make a body."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import numpy as np

from bridge.doctor.body_fit import BodyFit
from bridge.doctor.finding import Finding, Grade
from bridge.doctor.heard import Heard
from bridge.doctor.mending import labels_option, unit_now, world_option
from bridge.doctor.names import by_name
from bridge.doctor.places import PLAUSIBLE, by_place
from bridge.doctor.presence import USED, faults_of, presence_findings
from bridge.doctor.readings import AS_IT_IS, Reading, best_readings, partners
from bridge.doctor.worlds import joined, kind, nearest_unit, unit_name
from bridge.model import ModelInfo
from drivers.coordinates import OURS, Frame
from drivers.frame import Floats

ENOUGH = 10  # frames with all that is judged by
LOOKED_AT = 100  # frames, spread over all
FEWEST = 5  # markers that make a body
LOWEST = (-0.1, 0.35)  # m: where the lowest markers of somebody standing may be
_UNITS = {
    "m": "metres",
    "dm": "decimetres",
    "cm": "centimetres",
    "mm": "millimetres",
    "in": "inches",
    "ft": "feet",
}


def body_findings(heard: Heard, info: ModelInfo) -> Iterator[Finding]:
    """All that labels and positions tell against the model."""
    if not heard.frames:
        return
    xyz = heard.positions()
    labels = heard.labels
    lacking = [label for label in info.tracked if label not in labels]
    renamed: dict[str, str] = {}
    if lacking:
        foreign = [label for label in labels if label not in info.labels]
        renamed = by_name(lacking, foreign)
        labels = tuple(renamed.get(label, label) for label in labels)
        finding = _lacking(heard, info, xyz, lacking, foreign, renamed)
        yield finding
        if finding.options and not renamed:
            return  # read again under these labels, all else can be told
    faults = faults_of(info, labels, xyz)
    yield from presence_findings(faults)
    used = [label for label in info.tracked if label in labels and label not in faults.useless]
    try:
        if len(used) < FEWEST:
            raise ValueError(f"of the tracked markers only {len(used)} can be used")
        fit = BodyFit(info, tuple(used))
    except ValueError as error:
        yield Finding(Grade.NOTE, "body", f"up axis, unit and labels are not judged: {error}")
        return
    # Those of the other side tell a mirrored world from exchanged labels: with them, if it can be.
    both = {*used, *partners(info.tracked, labels)}
    whole = _complete(xyz, labels, both)
    xyz = whole if len(whole) >= ENOUGH else _complete(xyz, labels, used)
    if len(xyz) < ENOUGH:
        yield Finding(
            Grade.NOTE,
            "body",
            f"up axis, unit and labels are not judged: only {len(xyz)} frames have all of "
            + ", ".join(used),
        )
        return
    xyz = xyz[np.linspace(0, len(xyz) - 1, min(LOOKED_AT, len(xyz))).astype(int)]
    complete = ~np.isnan(xyz).any(axis=(0, 2))
    labels = tuple(np.array(labels)[complete].tolist())
    yield from _body(heard, fit, labels, xyz[:, complete], renamed)


def _complete(xyz: Floats, labels: tuple[str, ...], used: Collection[str]) -> Floats:
    """The frames with all of these markers."""
    columns = [labels.index(label) for label in used]
    kept: Floats = xyz[~np.isnan(xyz[:, columns]).any(axis=(1, 2))]
    return kept


def _lacking(
    heard: Heard,
    info: ModelInfo,
    xyz: Floats,
    lacking: list[str],
    foreign: list[str],
    renamed: Mapping[str, str],
) -> Finding:
    """Tracked markers that the stream does not name, and what it may call them."""
    carries = f"; it carries {', '.join(foreign)}" if foreign else ""
    if len(carries) > 300:
        carries = carries[:300] + " ..."
    text = f"the stream has no {', '.join(lacking)}{carries}"
    options: Mapping[str, str] = {}
    if renamed:
        options = labels_option(heard, renamed)
        text += f". By their names {_told(renamed)}"
    elif foreign:
        placed = _placed(heard, info, xyz, foreign)
        if placed:
            options = labels_option(heard, placed[1]) | world_option(heard, *placed[0])
            text += f". By their places {_told(placed[1])}"
    return Finding(Grade.WRONG, "labels", text, options)


def _told(renamed: Mapping[str, str]) -> str:
    return ", ".join(f"{theirs} is {ours}" for theirs, ours in renamed.items())


def _placed(
    heard: Heard, info: ModelInfo, xyz: Floats, foreign: list[str]
) -> tuple[tuple[Frame, float], dict[str, str]] | None:
    """World and unit, and foreign label to tracked marker, by where the markers are."""
    labels = heard.labels
    seen = (~np.isnan(xyz[:, :, 0])).mean(axis=0)
    usable = [
        label
        for column, label in enumerate(labels)
        if (label in foreign or label in info.tracked) and seen[column] >= USED
    ]
    xyz = _complete(xyz, labels, usable)[:, [labels.index(label) for label in usable]]
    if len(xyz) < ENOUGH or len(usable) < len(info.tracked):
        return None
    fit = BodyFit(info, info.tracked)
    unit = nearest_unit(unit_now(heard) / fit.times_too_large(xyz.astype(float)))
    if unit is None:
        return None
    fixed = {label: usable.index(label) for label in info.tracked if label in usable}
    found = by_place(fit, xyz * np.float32(unit / unit_now(heard)), fixed)
    if found is None:
        return None
    reading, columns = found
    named = {
        usable[column]: ours
        for ours, column in zip(info.tracked, columns, strict=True)
        if usable[column] != ours
    }
    return (reading.world, unit), named


def _body(
    heard: Heard,
    fit: BodyFit,
    labels: tuple[str, ...],
    xyz: Floats,
    renamed: Mapping[str, str],
) -> Iterator[Finding]:
    """Unit, up axis, handedness, and exchanged labels."""
    columns = [labels.index(label) for label in fit.labels]
    now = unit_now(heard)
    times = fit.times_too_large(xyz[:, columns].astype(float))
    unit = nearest_unit(now / times) if times > 0 else None
    if unit is None:
        yield Finding(
            Grade.WRONG, "size", f"the body is {times:.3g} times as large as a person: no unit fits"
        )
        return
    xyz = xyz * np.float32(unit / now)
    readings = best_readings(fit, labels, xyz)
    first = readings[0]
    exchange = _exchange(first)
    own = [labels.index(exchange.get(label, label)) for label in fit.labels]
    misfit = float(np.median(fit.misfit(first.world.to_ours(xyz[:, own]).astype(float))))
    if misfit > PLAUSIBLE:
        found = by_place(fit, xyz[:, columns])
        if found:
            yield _mixed_up(heard, fit, *found, unit, renamed)
            return
        yield Finding(
            Grade.POOR,
            "body",
            f"the markers make no body that the model knows (squared distance {misfit:.0f}; up to "
            f"{PLAUSIBLE:.0f} is usual): are the labels right, and do the markers sit where they "
            "should? Walk about meanwhile",
        )
    if first.world != OURS or unit != now:
        yield _coordinates(heard, readings, unit, renamed)
    if first.world == OURS and first.exchanged:
        yield _exchanged(heard, readings, renamed)
    if first == AS_IT_IS and unit == now:
        lowest = float(np.percentile(xyz[:, :, 2].min(axis=1), 5))
        if not LOWEST[0] < lowest < LOWEST[1]:
            yield Finding(
                Grade.NOTE,
                "floor",
                f"the lowest markers are at {lowest:.2f} m: the floor seems not to be at 0. The "
                "body is estimated all the same; it will float, or stand in the floor",
            )


def _coordinates(
    heard: Heard, readings: list[Reading], unit: float, renamed: Mapping[str, str]
) -> Finding:
    """Positions that are of another world than the address says."""
    now = heard.convention.frame if heard.convention else OURS
    world = readings[0].world
    meant = replace(joined(now, world), unit=unit)
    up, _ = kind(meant)
    parts = []
    if kind(meant)[0] != kind(now)[0]:
        sign = "minus " if up[0] == "-" else ""
        parts.append(f"up is {sign}its {up[-1]} axis")
    if meant.left_handed != now.left_handed:
        hand = "left" if meant.left_handed else "right"
        parts.append(f"its axes are {hand}-handed, and left and right are mirrored as it is read")
    if unit != now.unit:
        parts.append(f"its positions are {_UNITS[unit_name(unit)]}")
    text = "the stream's world is another: " + "; ".join(parts)
    options = dict(world_option(heard, world, unit))
    for other in readings[1:]:
        instead = labels_option(heard, _exchange(other), renamed).get("labels")
        if instead and other.world == OURS:
            text += (
                f". Or the labels of left and right are exchanged: look which, and write "
                f"labels={instead} in its place"
            )
    return Finding(Grade.WRONG, "coordinates", text, options)


def _exchanged(heard: Heard, readings: list[Reading], renamed: Mapping[str, str]) -> Finding:
    options = [labels_option(heard, _exchange(reading), renamed) for reading in readings]
    if len(readings) > 1:
        ways = " or ".join(
            _pairs(reading) + (f" (labels={option['labels']})" if option else "")
            for reading, option in zip(readings, options, strict=True)
        )
        text = f"markers are exchanged, but which cannot be told: {ways}"
        return Finding(Grade.WRONG, "exchanged", text)
    what = "left and right are exchanged" if readings[0].sides else "two markers are exchanged"
    return Finding(Grade.WRONG, "exchanged", f"{what}: {_pairs(readings[0])}", options[0])


def _mixed_up(
    heard: Heard,
    fit: BodyFit,
    reading: Reading,
    columns: tuple[int, ...],
    unit: float,
    renamed: Mapping[str, str],
) -> Finding:
    """More than two labels that are taken for each other; columns: of fit's own labels."""
    meant = {fit.labels[column]: ours for column, ours in zip(columns, fit.labels, strict=True)}
    meant = {label: ours for label, ours in meant.items() if label != ours}
    return Finding(
        Grade.WRONG,
        "mixed-up",
        f"labels are mixed up. By their places {_told(meant)}",
        labels_option(heard, meant, renamed) | world_option(heard, reading.world, unit),
    )


def _pairs(reading: Reading) -> str:
    return ", ".join(f"{one} and {other}" for one, other in reading.exchanged)


def _exchange(reading: Reading) -> dict[str, str]:
    return dict(reading.exchanged) | {other: one for one, other in reading.exchanged}
