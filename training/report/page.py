"""The page of a report: sections with text, tables and figures, written as one folder."""

from __future__ import annotations

import csv
import io
import math
import re
import tempfile
import warnings
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from numbers import Integral, Real
from pathlib import Path

import jinja2
import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from drivers.errors import MarkerbridgeError
from drivers.files import whole_file

# Colours that the colour-blind tell apart (Okabe and Ito).
OURS = "#0072B2"
NEAREST = "#D55E00"
PAPER = "#000000"
PALETTE = (OURS, NEAREST, "#009E73", "#CC79A7", "#E69F00", "#56B4E9")

_WIDTH = 9.0  # inches; as wide as the page at _DPI
_DPI = 150


@dataclass(frozen=True, slots=True)
class _Table:
    name: str
    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[object]]

    @property
    def numeric(self) -> list[bool]:
        """Of each column, whether it holds numbers alone."""
        columns = zip(*self.rows, strict=True) if self.rows else ((),) * len(self.header)
        return [
            all(cell is None or isinstance(cell, Real) for cell in column) for column in columns
        ]

    @property
    def csv(self) -> str:
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(self.header)
        table.writerows([None if _blank(cell) else cell for cell in row] for row in self.rows)
        return text.getvalue()


@dataclass(frozen=True, slots=True)
class _Picture:
    name: str
    caption: str
    png: bytes

    @property
    def base64(self) -> str:
        return b64encode(self.png).decode()


@dataclass(frozen=True, slots=True)
class _Section:
    title: str
    paragraphs: Sequence[str]
    blocks: list[_Table | _Picture] = field(default_factory=list)


class Report:
    """A folder with one self-contained index.html, every figure also as PNG, every table as CSV.

    Tables and figures go into the section started last. Names are the stems of their files.
    """

    def __init__(self, folder: Path, title: str) -> None:
        """Nothing is written before `write`."""
        self._folder = folder
        self._title = title
        self._sections: list[_Section] = []

    def section(self, title: str, *paragraphs: str) -> None:
        """Starts a section, with paragraphs of plain text."""
        self._sections.append(_Section(title, paragraphs))

    def table(
        self, name: str, caption: str, header: Sequence[str], rows: Sequence[Sequence[object]]
    ) -> None:
        """A table. None is shown as a dash and is empty in the CSV; numbers are whole in the CSV,
        and have three digits on the page.
        """
        self._add(_Table(name, caption, header, rows))

    def left_out(self, rows: Sequence[tuple[str, str]]) -> None:
        """A table of what was left out, and why; none where nothing was."""
        if rows:
            self.table("left_out", "What was left out, and why.", ("what", "why"), rows)

    def figure(self, name: str, caption: str, figure: Figure) -> None:
        """A figure, drawn at once; the caption is its text for those who cannot see it as well."""
        png = io.BytesIO()
        with warnings.catch_warnings():
            # A file's name may be in any script; the page shows it, whatever the plot can.
            warnings.filterwarnings("ignore", "Glyph .* missing from font")
            figure.savefig(png, format="png", dpi=_DPI)
        self._add(_Picture(name, caption, png.getvalue()))

    def write(self) -> Path:
        """Writes the folder, the page last, and returns the page's path.

        Raises MarkerbridgeError where it cannot be written.
        """
        page = self._folder / "index.html"
        files: dict[str, bytes] = {}
        for block in self._blocks():
            if isinstance(block, _Picture):
                files[f"{block.name}.png"] = block.png
            else:
                files[f"{block.name}.csv"] = block.csv.encode()
        files[page.name] = self._html().encode()
        make_folder(self._folder)
        for name, content in files.items():
            try:
                with whole_file(self._folder / name) as part:
                    part.write_bytes(content)
            except OSError as error:
                raise MarkerbridgeError(
                    f"cannot write {self._folder / name}: {error.strerror}"
                ) from error
        return page

    def _add(self, block: _Table | _Picture) -> None:
        if not re.fullmatch(r"[a-z0-9_-]+", block.name):
            raise ValueError(f"'{block.name}' is no name for a file of a report")
        if block.name in (other.name for other in self._blocks()):
            raise ValueError(f"the report has a '{block.name}' already")
        self._sections[-1].blocks.append(block)

    def _blocks(self) -> list[_Table | _Picture]:
        return [block for section in self._sections for block in section.blocks]

    def _html(self) -> str:
        environment = jinja2.Environment(
            autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
        )
        environment.filters["shown"] = shown
        source = files("training.report").joinpath("page.html").read_text(encoding="utf-8")
        return environment.from_string(source).render(title=self._title, sections=self._sections)


def make_folder(folder: Path) -> None:
    """Makes the folder of a report. Raises MarkerbridgeError where nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise MarkerbridgeError(f"no report in {folder}: {error.strerror}") from error


def new_figure(
    rows: int = 1, columns: int = 1, height: float = 3.6, share_x: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure as wide as the page and `height` inches high, and its axes, row by row."""
    style = matplotlib.rc_context(
        {
            "axes.axisbelow": True,
            "axes.grid": True,
            "axes.prop_cycle": cycler(color=PALETTE),
            "axes.spines.right": False,
            "axes.spines.top": False,
            "axes.titlesize": "medium",
            "grid.alpha": 0.3,
            "text.parse_math": False,  # a file's name may hold dollars
        }
    )
    with style:
        figure = Figure(figsize=(_WIDTH, height), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False, sharex="col" if share_x else False)
    return figure, list(grid.flat)


def shown(cell: object) -> str:
    """A cell of a table as the page shows it: numbers to three digits."""
    if _blank(cell):
        return "–"
    if isinstance(cell, Integral):
        return f"{int(cell):,}"
    if isinstance(cell, Real):
        value = float(cell)
        decimals = 2 - math.floor(math.log10(abs(value))) if value else 0
        return f"{value:,.{min(max(decimals, 0), 6)}f}"
    return str(cell)


def _blank(cell: object) -> bool:
    return cell is None or (isinstance(cell, Real) and math.isnan(cell))
