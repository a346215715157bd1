"""The CMU Graphics Lab Motion Capture Database: where its site keeps what, and its index.

As the site is known at the time of writing: `search.php?subjectnumber=2` is a page with a table of
the trials of subject 02, each row with the trial's number, its description, and links to its files,
which lie at `subjects/02/02_01.c3d`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from html.parser import HTMLParser
from itertools import pairwise

SITE = "http://mocap.cs.cmu.edu"

_CAPTURE = re.compile(r"(?:^|/)(\d{2,3})_(\d{2,3})\.c3d$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Trial:
    """One capture of the database. motion: its description there, may be empty."""

    subject: str
    number: str
    motion: str

    @property
    def file(self) -> str:
        """Where it lies, both under the site's `subjects/` and in a folder of captures."""
        return f"{self.subject}/{self.subject}_{self.number}.c3d"


def index_url(site: str, subject: str) -> str:
    """The page that lists the trials of a subject (`02`)."""
    return f"{site}/search.php?subjectnumber={int(subject)}"


def read_index(page: str, subject: str) -> list[Trial]:
    """The trials of one subject that an index page links a C3D file of, in the page's order.

    The description is the cell after the one with the trial's number.
    """
    table = _Table()
    table.feed(page)
    table.close()
    trials: dict[str, Trial] = {}
    for row in table.rows:
        for link in row.links:
            match = _CAPTURE.search(link)
            if match and match[1] == subject:
                trials.setdefault(match[2], Trial(subject, match[2], row.after(int(match[2]))))
    return list(trials.values())


class _Row:
    """A table row: the text of its cells, and where its links lead."""

    def __init__(self) -> None:
        self.cells: list[str] = []
        self.links: list[str] = []

    def after(self, number: int) -> str:
        """The text of the cell after the one that holds only this number; empty without one."""
        cells = [" ".join(cell.split()) for cell in self.cells]
        for cell, following in pairwise(cells):
            if cell.isdecimal() and int(cell) == number:
                return following
        return ""


class _Table(HTMLParser):
    """All table rows of a page; a cell or row that is never closed ends where the next begins."""

    def __init__(self) -> None:
        super().__init__()
        self.rows = [_Row()]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "tr":
            self.rows.append(_Row())
        elif tag in ("td", "th"):
            self.rows[-1].cells.append("")
        elif tag == "a":
            self.rows[-1].links.append(dict(attrs).get("href") or "")

    def handle_data(self, data: str) -> None:
        cells = self.rows[-1].cells
        if cells:
            cells[-1] += data
