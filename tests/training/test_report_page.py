import csv
import io
import re
from base64 import b64decode
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from drivers.errors import MarkerbridgeError
from training.report import paper
from training.report.page import Report, new_figure, shown

VOID = {"meta", "img", "br", "hr"}
EMBEDDED = "data:image/png;base64,"


class Page(HTMLParser):
    """A page taken apart: its tags, its text, its tables; fails where tags do not match."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text, self.tables, self._open = [], "", [], []
        self.feed(text)
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        self.text += data
        if self._open and self._open[-1] in ("td", "th"):
            self.tables[-1][-1][-1] += data

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def check_page(path):
    """What holds of every page: whole in itself, each figure and table also a file beside it."""
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert text.startswith("<!DOCTYPE html>")
    assert page.all("html") == [{"lang": "en"}]
    assert not {"script", "link", "iframe", "object", "base", "form"} & {
        tag for tag, _ in page.tags
    }
    assert not [name for _, attributes in page.tags for name in attributes if name.startswith("on")]
    assert not re.search(r"url\(|@import|https?:|file:", text)
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    names = set()
    for link in page.all("a"):
        target = link["href"]
        if target.startswith("#"):
            assert target[1:] in ids
        else:
            names.add(target)
    assert {file.name for file in path.parent.iterdir()} == names | {"index.html"}
    pictures = [attributes["src"] for attributes in page.all("img")]
    assert len(pictures) == len(page.all("figure")) == len(page.all("figcaption"))
    embedded = []
    for picture in pictures:
        assert picture.startswith(EMBEDDED)
        embedded.append(b64decode(picture.removeprefix(EMBEDDED), validate=True))
        image = Image.open(io.BytesIO(embedded[-1]))
        image.load()
        assert image.format == "PNG"
        assert image.width >= 1000
    files = [path.parent / name for name in names if name.endswith(".png")]
    assert sorted(embedded) == sorted(file.read_bytes() for file in files)
    assert all(len(attributes["alt"]) > 10 for attributes in page.all("img"))
    assert len(page.tables) == len([name for name in names if name.endswith(".csv")])
    for table in page.tables:
        assert len({len(row) for row in table}) == 1
    return page


def read_table(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def test_a_page_with_all_there_is(tmp_path):
    report = Report(tmp_path / "deep" / "report", "A title")
    report.section("First", "One paragraph.", "Another one.")
    figure, (left, right) = new_figure(1, 2)
    left.plot([0, 1], [1, 0])
    right.plot([0, 1], [0, 1])
    report.figure("lines", "Two crossing lines.", figure)
    report.section("Second")
    report.table("numbers", "Some numbers.", ("what", "n", "x"), [("a", 151882, 1.23456789)])
    assert not (tmp_path / "deep").exists()
    path = report.write()
    assert path == tmp_path / "deep" / "report" / "index.html"
    page = check_page(path)
    for text in ("A title", "First", "Second", "One paragraph.", "Another one.", "Some numbers."):
        assert text in page.text
    assert page.all("img")[0]["alt"] == "Two crossing lines."
    assert page.tables == [[["what", "n", "x"], ["a", "151,882", "1.23"]]]
    assert read_table(path.with_name("numbers.csv")) == [
        ["what", "n", "x"],
        ["a", "151882", "1.23456789"],
    ]


def test_what_is_not_known_is_a_dash_and_empty_in_the_file(tmp_path):
    report = Report(tmp_path, "Report")
    report.section("Section")
    rows = [("a", None, np.float32("nan")), ("b", 2.0, np.float64(0.5))]
    report.table("gaps", "Some are missing.", ("what", "x", "y"), rows)
    report.table("none", "No rows.", ("what", "x"), [])
    path = report.write()
    page = check_page(path)
    assert page.tables[0] == [["what", "x", "y"], ["a", "–", "–"], ["b", "2.00", "0.500"]]
    assert read_table(path.with_name("gaps.csv"))[1:] == [["a", "", ""], ["b", "2.0", "0.5"]]
    assert read_table(path.with_name("none.csv")) == [["what", "x"]]
    # Columns of numbers are set as such, whatever is missing in them.
    assert [cell.get("class") for cell in page.all("td")] == ["number"] * 4


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        (0.00012, "0.000120"),
        (0.0, "0"),
        (0.7523, "0.752"),
        (45.0, "45.0"),
        (99.96, "100.0"),
        (-3.14159, "-3.14"),
        (151882.4, "151,882"),
        (np.int64(12670), "12,670"),
        (1e-9, "0.000000"),
        ("02_02", "02_02"),
    ],
)
def test_numbers_are_shown_to_three_digits(cell, text):
    assert shown(cell) == text


def test_names_from_outside_are_text_and_nothing_else(tmp_path):
    hostile = "<script>alert(1)</script>&\"'$x$ {{ 7 * 7 }} 走.c3d"
    report = Report(tmp_path, hostile)
    report.section(hostile, hostile)
    figure, (axes,) = new_figure()
    axes.plot([0, 1], [1, 0])
    axes.set_title(hostile)
    axes.set_xlabel(hostile)
    report.figure("lines", hostile, figure)
    report.table("names", hostile, (hostile, "x"), [(hostile, 1)])
    path = report.write()
    page = check_page(path)
    assert page.all("img")[0]["alt"] == hostile
    assert page.tables == [[[hostile, "x"], [hostile, "1"]]]
    assert page.text.count(hostile) == 8
    assert read_table(path.with_name("names.csv")) == [[hostile, "x"], [hostile, "1"]]


def test_names_of_files_are_plain_and_used_once(tmp_path):
    report = Report(tmp_path, "Report")
    report.section("Section")
    report.table("one", "Caption.", ("a",), [])
    for name in ("one", "../two", "Two", ""):
        with pytest.raises(ValueError, match=r"is no name|already"):
            report.table(name, "Caption.", ("a",), [])


def test_a_folder_that_cannot_be_written(tmp_path):
    def report(folder):
        made = Report(folder, "Report")
        made.section("Section")
        made.table("numbers", "Caption.", ("a",), [(1,)])
        return made

    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "deeper"):
        with pytest.raises(MarkerbridgeError, match=f"no report in {folder}"):
            report(folder).write()
    (tmp_path / "taken" / "numbers.csv").mkdir(parents=True)
    with pytest.raises(MarkerbridgeError, match=r"cannot write .*numbers\.csv"):
        report(tmp_path / "taken").write()
    assert not (tmp_path / "taken" / "index.html").exists()  # no page without its tables


def test_a_report_replaces_the_one_before(tmp_path):
    for value in (1, 2):
        report = Report(tmp_path, f"Report {value}")
        report.section("Section")
        report.table("numbers", "Caption.", ("a",), [(value,)])
        page = check_page(report.write())
    assert page.tables == [[["a"], ["2"]]]


def test_figures_do_not_touch_the_style_of_others():
    import matplotlib

    before = dict(matplotlib.rcParams)
    figure, panels = new_figure(2, 2, height=5, share_x=True)
    assert dict(matplotlib.rcParams) == before
    assert len(panels) == 4
    assert figure.get_size_inches()[1] == 5
    assert panels[0].get_shared_x_axes().joined(panels[0], panels[2])


def test_the_paper_agrees_with_itself():
    """Its figures hang together as its text says."""
    total = paper.CLASSIFICATION_S + paper.RECONSTRUCTION_S
    assert round(total, 4) == paper.FRAME_S
    assert 1 / paper.FRAME_S > paper.FRAMES_PER_SECOND
    assert round(paper.TRAIN_FRAMES / paper.SEGMENTS) == paper.SEGMENT_MEAN
    assert paper.SEGMENT_MIN < paper.SEGMENT_MEDIAN < paper.SEGMENT_MEAN < paper.SEGMENT_MAX
