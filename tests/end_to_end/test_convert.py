"""A log as C3D, TRC and CSV: what is missing is missing, and a person stands upright."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from bridge import cli
from drivers.c3d_file import read_c3d, write_c3d
from drivers.frame import Layout, MarkerFrame
from drivers.marker_set import MARKERS
from drivers.session_log import Entry, LoggedPose, LogWriter
from simulators.performer import load_performer
from tests.end_to_end.peers import Command

LAYOUT = Layout(MARKERS, 100.0)
NINE = Layout(MARKERS[:9], 100.0)
HEAD = MARKERS.index("LFHD")


def logged(path: Path, *entries: Entry) -> Path:
    log = LogWriter(path, "test")
    for entry in entries:
        log.add(entry)
    log.close()
    return path


def pose(index: int) -> LoggedPose:
    """A walker's pose; marker `index` mod 41 is lost, the next one imputed."""
    kinds = np.full(41, 2, np.uint8)
    kinds[index % 41], kinds[(index + 1) % 41] = 3, 1
    xyz = load_performer("walk").pose(index).astype(np.float32)
    return LoggedPose(index, index / 100, LAYOUT, xyz, kinds, np.full(41, 0.012, np.float32))


def expected(*indices: int) -> np.ndarray:
    """The poses (N, 41, 3) as they are to come out, metres."""
    found = []
    for index in indices:
        one = pose(index)
        found.append(np.where(one.provenance[:, None] == 3, np.nan, one.xyz))
    return np.stack(found)


def converted(*arguments: Path | str) -> int:
    return cli.main(["convert", *map(str, arguments)])


def read_csv(path: Path) -> tuple[list[str], list[list[str]]]:
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return header, rows


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Poses 10 to 19 of which 13 and 14 never came, and a frame each of nine markers."""
    entries: list[Entry] = []
    for index in (10, 11, 12, 15, 16, 17, 18, 19):
        xyz = pose(index).xyz[:9].copy()
        xyz[index % 9] = np.nan
        entries += [MarkerFrame(index, index / 100, 0.0, NINE, xyz), pose(index)]
    return logged(tmp_path / "a.mcap", *entries)


def test_c3d_has_the_poses_and_what_is_missing_is_missing(log: Path, tmp_path: Path) -> None:
    assert converted(log, tmp_path / "out.c3d") == 0
    clip = read_c3d(tmp_path / "out.c3d")
    assert clip.layout == LAYOUT
    assert clip.xyz.shape == (10, 41, 3)
    assert np.isnan(clip.xyz[3:5]).all()
    there = [0, 1, 2, 5, 6, 7, 8, 9]
    np.testing.assert_allclose(clip.xyz[there], expected(10, 11, 12, 15, 16, 17, 18, 19), atol=1e-6)


def test_trc_is_what_opensim_reads_and_y_is_up(log: Path, tmp_path: Path) -> None:
    """The header's rules are those of OpenSim's TRCFileAdapter."""
    assert converted(log, tmp_path / "out.trc") == 0
    lines = (tmp_path / "out.trc").read_text().split("\n")
    assert lines[0].split("\t") == ["PathFileType", "4", "(X/Y/Z)", "out.trc"]
    keys = "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame"
    assert lines[1].split("\t") == [*keys.split(), "OrigNumFrames"]
    assert lines[2].split("\t") == ["100", "100", "10", "41", "mm", "100", "1", "10"]
    names = lines[3].split("\t")
    assert names[:2] == ["Frame#", "Time"]
    assert [name for name in names[2:] if name] == list(MARKERS)
    axes = [f"{axis}{i}" for i in range(1, 42) for axis in "XYZ"]
    assert lines[4].split("\t") == ["", "", *axes]
    assert lines[5] == lines[-1] == ""
    table = np.array([[float(cell) for cell in line.split("\t")] for line in lines[6:-1]])
    assert table.shape == (10, 2 + 3 * 41)
    np.testing.assert_array_equal(table[:, 0], np.arange(1, 11))
    np.testing.assert_allclose(table[:, 1], np.arange(10) / 100)
    places = table[:, 2:].reshape(10, 41, 3)
    there = [0, 1, 2, 5, 6, 7, 8, 9]
    x, y, z = np.moveaxis(expected(10, 11, 12, 15, 16, 17, 18, 19), -1, 0)
    np.testing.assert_allclose(places[there], 1000 * np.stack([x, z, -y], -1), atol=1e-2)
    assert np.nanmin(places[:, HEAD, 1]) > 1200  # the head is up


def test_csv_has_empty_cells_for_what_is_missing(log: Path, tmp_path: Path) -> None:
    assert converted(log, tmp_path / "out.csv") == 0
    header, rows = read_csv(tmp_path / "out.csv")
    assert header[:5] == ["index", "t", "LFHD.x", "LFHD.y", "LFHD.z"]
    assert [row[0] for row in rows] == [str(index) for index in range(10, 20)]
    assert [float(row[1]) for row in rows] == pytest.approx(np.arange(10) / 100)
    assert set(rows[3][2:]) == set(rows[4][2:]) == {""}
    for row in rows[:3] + rows[5:]:
        assert len(row) == len(header)
        lost = 2 + 3 * (int(row[0]) % 41)
        assert row[lost : lost + 3] == ["", "", ""]
        there = [float(cell) for cell in row[2:] if cell]
        truth = 1000 * expected(int(row[0]))
        np.testing.assert_allclose(there, truth[~np.isnan(truth)], atol=1e-2)


def test_csv_tells_provenance_and_sigma_in_its_unit(log: Path, tmp_path: Path) -> None:
    assert converted(log, tmp_path / "out.csv", "--full", "--unit", "cm") == 0
    header, rows = read_csv(tmp_path / "out.csv")
    assert header[2:7] == ["LFHD.x", "LFHD.y", "LFHD.z", "LFHD.provenance", "LFHD.sigma"]
    assert len(header) == 2 + 5 * 41
    kinds = rows[0][5::5]
    assert (kinds[10], kinds[11], kinds[12]) == ("lost", "imputed", "estimated")
    assert set(rows[0][6::5]) == {"1.2"}
    assert set(rows[3][2:]) == {""}


@pytest.mark.parametrize(
    ("options", "axes", "unit"),
    [
        ((), [0, 1, 2], 1000),
        (("--frame", "unity"), [0, 2, 1], 1),
        (("--frame", "unreal"), [1, 0, 2], 100),
        (("--frame", "unity", "--unit", "mm"), [0, 2, 1], 1000),
    ],
)
def test_csv_of_frames_in_another_programs_world(log, tmp_path, options, axes, unit) -> None:
    assert converted(log, tmp_path / "out.csv", "--what", "frames", *options) == 0
    header, rows = read_csv(tmp_path / "out.csv")
    assert len(header) == 2 + 3 * 9
    row = rows[0]
    assert row[2 + 3 : 2 + 6] == ["", "", ""]  # of frame 10 marker 1 is missing
    place = [float(cell) for cell in row[2:5]]
    np.testing.assert_allclose(place, unit * pose(10).xyz[0][axes], rtol=1e-5)


def test_frames_of_changing_labels_have_all_of_them_by_name(tmp_path: Path) -> None:
    def frame(index: int, *labels: str) -> MarkerFrame:
        xyz = np.full((len(labels), 3), index, np.float32)
        return MarkerFrame(index, 0.0, 0.0, Layout(labels, 50.0), xyz)

    frames = [frame(0, "C7"), frame(1, "LTOE", "C7"), frame(2, "C7", "LTOE"), frame(5, "RTOE")]
    log = logged(tmp_path / "a.mcap", *frames)
    assert converted(log, tmp_path / "a.csv", "--unit", "m") == 0
    header, rows = read_csv(tmp_path / "a.csv")
    assert header[2::3] == ["C7.x", "LTOE.x", "RTOE.x"]
    assert [row[2::3] for row in rows] == [
        ["0", "", ""],
        ["1", "1", ""],
        ["2", "2", ""],
        ["", "", ""],
        ["", "", ""],
        ["", "", "5"],
    ]


def test_a_device_that_starts_anew_is_another_take_that_follows_at_once(tmp_path: Path) -> None:
    log = logged(tmp_path / "a.mcap", *map(pose, (5, 6, 0, 1, 90_000)))
    assert converted(log, tmp_path / "a.csv") == 0
    rows = read_csv(tmp_path / "a.csv")[1]
    assert [row[0] for row in rows] == ["5", "6", "0", "1", "90000"]
    assert [float(row[1]) for row in rows] == pytest.approx([0, 0.01, 0.02, 0.03, 0.04])


def test_c3d_that_counts_no_further_goes_on_in_another(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("bridge.convert_command.MAX_FRAMES", 4)
    log = logged(tmp_path / "a.mcap", *map(pose, range(10)))
    assert converted(log, tmp_path / "out.c3d") == 0
    parts = [tmp_path / name for name in ("out.c3d", "out-2.c3d", "out-3.c3d")]
    assert [len(read_c3d(part).xyz) for part in parts] == [4, 4, 2]
    whole = np.concatenate([read_c3d(part).xyz for part in parts])
    np.testing.assert_allclose(whole, expected(*range(10)), atol=1e-6)
    assert sorted(tmp_path.iterdir()) == sorted([log, *parts])


def test_c3d_in_is_converted_too(tmp_path: Path) -> None:
    xyz = np.random.default_rng(0).normal(size=(7, 2, 3)).astype(np.float32)
    xyz[2, 1] = np.nan
    write_c3d(tmp_path / "a.c3d", Layout(("C7", "LTOE"), 50.0), xyz)
    assert converted(tmp_path / "a.c3d", tmp_path / "A.CSV", "--unit", "m") == 0
    header, rows = read_csv(tmp_path / "A.CSV")
    assert set(header[2::3]) == {"C7.x", "LTOE.x"}
    at = header.index("LTOE.x")
    assert rows[2][at : at + 3] == ["", "", ""]
    np.testing.assert_allclose([float(c) for c in rows[1][at : at + 3]], xyz[1, 1], rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["a.mcap", "out.bvh"], 2, "'out.bvh': the ending is one of .c3d, .csv, .trc"),
        (["a.mcap", "out.trc", "--full"], 2, "--full is for .csv"),
        (["a.mcap", "out.csv", "--full", "--what", "frames"], 2, "there is nothing more to tell"),
        (["a.mcap", "out.c3d", "--frame", "unity"], 2, "a C3D file is in millimetres"),
        (["a.mcap", "out.trc", "--unit", "in"], 2, "a TRC file knows --unit mm, cm, m"),
        (["a.mcap", "out.csv", "--frame", "blender"], 2, "known are cmu"),
        (["a.mcap", "a.mcap"], 2, "the ending is one of"),
        (["b.c3d", "b.c3d"], 2, "b.c3d is the recording itself: choose another name"),
        (["b.c3d", "linked.c3d"], 2, "linked.c3d is the recording itself"),
        (["b.c3d", "out.csv", "--what", "poses"], 2, "b.c3d has frames only"),
        (["absent.mcap", "out.csv"], 1, "cannot read absent.mcap: No such file or directory"),
        (["frames.mcap", "out.csv", "--what", "poses"], 1, "frames.mcap has no poses"),
        (["a.mcap", "no/out.csv"], 1, "cannot write no/out.csv: "),
    ],
)
def test_what_cannot_be_is_one_line_and_leaves_everything_as_it_was(
    log: Path, tmp_path: Path, monkeypatch, capsys, arguments, status, words
) -> None:
    monkeypatch.chdir(tmp_path)
    write_c3d(tmp_path / "b.c3d", LAYOUT, expected(0, 1))
    (tmp_path / "linked.c3d").symlink_to("b.c3d")
    xyz = np.ones((9, 3), np.float32)
    logged(tmp_path / "frames.mcap", MarkerFrame(0, 0.0, 0.0, NINE, xyz))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    try:
        found = converted(*arguments)
    except SystemExit as end:  # argparse's own way
        found = end.code
    assert found == status
    err = capsys.readouterr().err
    assert words in err.splitlines()[-1]
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_the_command_converts_a_cut_log_and_says_so(log: Path, tmp_path: Path) -> None:
    log.write_bytes(log.read_bytes()[:5000])
    status, out, err = Command("convert", str(log), str(tmp_path / "out.csv")).end()
    assert (status, out) == (0, "")
    first, last = err.splitlines()
    assert "a.mcap is not whole: " in first
    assert " frames of 41 markers at 100 Hz in " in last
    assert 1 < len(read_csv(tmp_path / "out.csv")[1]) < 10
