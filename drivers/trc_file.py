"""TRC files (track row column), as OpenSim reads them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from drivers.frame import Floats, Layout

UNITS = ("mm", "cm", "m")  # that a TRC file may name


def trc_header(name: str, layout: Layout, unit: str, count: int) -> str:
    """The first lines of the file `name` of `count` frames."""
    rate, markers = f"{layout.rate:g}", len(layout.labels)
    axes = "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, markers + 1))
    return (
        f"PathFileType\t4\t(X/Y/Z)\t{name}\n"
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\t"
        "OrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
        f"{rate}\t{rate}\t{count}\t{markers}\t{unit}\t{rate}\t1\t{count}\n"
        "Frame#\tTime\t" + "\t\t\t".join(layout.labels) + "\t\t\n"
        f"\t\t{axes}\n\n"
    )


def write_trc(path: Path, layout: Layout, header: str, rows: Iterable[Floats]) -> None:
    """Writes frames (M, 3), in the axes and unit that the file is to have.

    A missing marker is `nan`: all versions of OpenSim read that, and some stumble over an empty
    column. Raises OSError where it cannot be written.
    """
    line = "%d\t%.6f" + "\t%.7g" * (3 * len(layout.labels)) + "\n"
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(header)
        for number, xyz in enumerate(rows):
            file.write(line % (number + 1, number / layout.rate, *xyz.ravel().tolist()))
