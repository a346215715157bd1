"""C3D files: whole clips for training and simulation, and as a source that plays one."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import ezc3d
import numpy as np

from drivers.c3d_check import check_c3d
from drivers.clock import Clock
from drivers.convention import Convention
from drivers.coordinates import UNITS
from drivers.files import whole_file
from drivers.frame import Floats, Layout, MarkerFrame, Source, SourceError
from drivers.marker_set import MARKERS
from drivers.url import Url

MAX_FRAMES = 65_535  # its frame numbers have 16 bits

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """A recorded capture: layout, and (N, M, 3) float32 metres, NaN where missing."""

    path: Path
    layout: Layout
    xyz: Floats


def read_c3d(path: str | Path, labels: tuple[str, ...] | None = MARKERS) -> Clip:
    """Reads the markers `labels` of a C3D file, in that order, in metres; None: those of the
    marker set that are there.

    Raises SourceError for a file that is no C3D, has no rate, or lacks labels (named).
    """
    clip = read_points(path)
    rows = {label: row for row, label in enumerate(clip.layout.labels)}
    if labels is None:
        labels = tuple(label for label in MARKERS if label in rows)
    lacking = [label for label in labels or MARKERS if label not in rows]
    if lacking:
        raise SourceError(f"{path}: lacks the markers {', '.join(lacking)}")
    chosen = clip.xyz[:, [rows[label] for label in labels]]
    return Clip(clip.path, Layout(tuple(labels), clip.layout.rate), chosen)


def read_points(path: str | Path) -> Clip:
    """Reads all points of a C3D file that have a name, in metres and the file's own axes.

    Prefixes (`liu:LFIN`) are stripped; of several points of one name it is the first, and trackers
    name `*12` what they could not name. Unit and rate are the file's. A negative residual and a
    position of exactly (0, 0, 0) both mean missing. Raises SourceError for a file that is no C3D or
    has no rate.
    """
    path = Path(path)
    if not path.is_file():
        raise SourceError(f"{path}: no such file")
    try:
        check_c3d(path.read_bytes())
        file = ezc3d.c3d(str(path))
        point = file["parameters"]["POINT"]
        found = [
            label
            for key in sorted(k for k in point if k.startswith("LABELS"))
            for label in point[key]["value"]
        ]
        rate = float(point["RATE"]["value"][0])
        units = point["UNITS"]["value"] if "UNITS" in point else []
        unit = str(units[0]).strip().lower() if units else "mm"
        points = file["data"]["points"]
        residuals = file["data"]["meta_points"]["residuals"][0]
    except (OSError, RuntimeError, ValueError, KeyError, IndexError, MemoryError) as error:
        raise SourceError(f"{path}: not a readable C3D file ({error})") from error
    if unit not in UNITS:
        raise SourceError(f"{path}: unknown unit '{unit}' (known: {', '.join(UNITS)})")

    rows: dict[str, int] = {}
    for row, label in enumerate(found[: points.shape[1]]):
        name = str(label).strip().rpartition(":")[2]
        if name and not name.startswith("*"):
            rows.setdefault(name, row)
    chosen = list(rows.values())
    xyz = points[:3, chosen].transpose(2, 1, 0)
    missing = (residuals[chosen].T < 0) | (xyz == 0).all(axis=2) | ~np.isfinite(xyz).all(axis=2)
    metres = np.where(missing[:, :, None], np.nan, xyz * UNITS[unit]).astype(np.float32)
    try:
        return Clip(path, Layout(tuple(rows), rate), metres)
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error


def write_c3d(path: str | Path, layout: Layout, xyz: Floats) -> None:
    """Writes (N, M, 3) metres as millimetres; NaN rows become missing samples (residual -1).

    The file appears whole or not at all. Raises OSError where it cannot be written, ValueError for
    more than MAX_FRAMES frames.
    """
    path = Path(path)
    if len(xyz) > MAX_FRAMES:
        raise ValueError(f"{path}: {len(xyz)} frames, a C3D file counts to {MAX_FRAMES}")
    file = ezc3d.c3d()
    file.add_parameter("POINT", "LABELS", list(layout.labels))
    file.add_parameter("POINT", "UNITS", ["mm"])
    file["parameters"]["POINT"]["RATE"]["value"] = [float(layout.rate)]
    points = np.ones((4, len(layout.labels), len(xyz)))
    points[:3] = xyz.transpose(2, 1, 0) * 1000.0
    missing = np.isnan(points).any(axis=0)
    points[:3, missing] = np.nan
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = np.where(missing, -1.0, 0.0)[None]
    try:
        with whole_file(path) as part:
            file.write(str(part))
            check_c3d(part.read_bytes())  # ezc3d does not notice a full disk
    except (RuntimeError, ValueError) as error:
        raise OSError(f"cannot write {path}: {error}; is the disk full?") from error


class C3dSource(Source):
    """Plays a clip at its own rate, `speed` times as fast; speed infinity does not wait."""

    live = False

    def __init__(self, name: str, clip: Clip, clock: Clock, speed: float = 1.0) -> None:
        super().__init__(name, clock)
        self.layout = clip.layout
        self._clip = clip
        self._step = 1.0 / (clip.layout.rate * speed)
        self._next = 0
        self._start = clock.now()

    def _receive(self, timeout: float) -> Iterable[MarkerFrame] | None:
        if self._next == len(self._clip.xyz):
            self.exhausted = True
            return None
        now = self.clock.now()
        due = self._start + self._next * self._step
        if due > now + timeout:
            self.clock.sleep_until(now + timeout)
            return None
        self.clock.sleep_until(due)
        index = self._next
        self._next += 1
        layout = self._clip.layout
        # An unpaced clip keeps its own time, so that what follows does not depend on the machine.
        t = due if self._step else self._start + index / layout.rate
        return (MarkerFrame(index, t, index / layout.rate, layout, self._clip.xyz[index]),)


def _speed(text: str) -> float:
    speed = float("inf") if text == "max" else float(text)
    if not speed > 0:
        raise ValueError("it is a factor above 0, or max")
    return speed


def open_c3d(url: Url, clock: Clock) -> Source:
    """The source at `c3d:FILE?speed=1` (or `speed=max`): all points that have a name.

    Options `frame`, `axes` and `labels` as on a wire; the unit is the file's. Raises UrlError or
    SourceError.
    """
    path = url.file_path()
    speed = url.take("speed", 1.0, _speed)
    convention = Convention.take(url, unit=1.0)
    url.finish()
    clip = read_points(path)
    try:
        layout = convention.layout_in(clip.layout)
    except ValueError as error:
        raise SourceError(f"{path}: the option labels does not fit it: {error}") from error
    if lacking := convention.lacking(clip.layout):
        log.warning(
            "%s: the option labels names %s, which the file does not carry (it has %s)",
            *(path, ", ".join(lacking), ", ".join(clip.layout.labels)),
        )
    return C3dSource(url.text, Clip(clip.path, layout, convention.xyz_in(clip.xyz)), clock, speed)
