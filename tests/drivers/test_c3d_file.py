from __future__ import annotations

from pathlib import Path

import ezc3d
import numpy as np
import pytest

from drivers.c3d_file import C3dSource, read_c3d, write_c3d
from drivers.clock import VirtualClock
from drivers.frame import Layout, SourceError
from drivers.marker_set import MARKERS
from drivers.registry import open_source
from drivers.url import UrlError

MISSING_PERCENT = {"real/01_01.c3d": 0.027, "real/02_02.c3d": 0.254, "real/07_12.c3d": 0.074}


def made(path: Path, labels: list[str], points: np.ndarray, **parameters: list[object]) -> Path:
    """A C3D file as another program would write it: (N, M, 3) in the file's own unit."""
    file = ezc3d.c3d()
    file.add_parameter("POINT", "LABELS", labels)
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    for name, value in parameters.items():
        file.add_parameter("POINT", name, value)
    data = np.ones((4, points.shape[1], len(points)))
    data[:3] = points.transpose(2, 1, 0)
    file["data"]["points"] = data
    file.write(str(path))
    return path


@pytest.mark.parametrize(("name", "percent"), MISSING_PERCENT.items())
def test_both_kinds_of_missing_sample_are_found_in_real_captures(
    data_dir: Path, name: str, percent: float
) -> None:
    clip = read_c3d(data_dir / name)
    assert clip.layout == Layout(MARKERS, 120.0)
    assert 100 * np.isnan(clip.xyz).any(axis=2).mean() == pytest.approx(percent, abs=5e-4)
    assert np.nanmax(np.abs(clip.xyz)) < 20  # metres


def test_every_real_capture_reads_upright_in_metres(data_dir: Path) -> None:
    for path in sorted((data_dir / "real").glob("*.c3d")):
        xyz = read_c3d(path).xyz
        height = np.nanmedian(xyz[:, MARKERS.index("LFHD"), 2])
        assert 0.8 < height < 2.2, path.name


def test_order_prefixes_and_further_points_do_not_matter(tmp_path: Path) -> None:
    points = np.arange(1, 25, dtype=float).reshape(2, 4, 3)
    path = made(tmp_path / "a.c3d", ["liu:RSHO", "*0", "liu:C7", "liu:LSHO"], points)
    clip = read_c3d(path, ("C7", "LSHO", "RSHO"))
    np.testing.assert_allclose(clip.xyz, points[:, [2, 3, 0]] / 1000, rtol=1e-6)
    assert clip.layout.rate == 100.0


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)])
def test_the_unit_is_the_files_own(tmp_path: Path, unit: str, metres: float) -> None:
    points = np.arange(1, 4, dtype=float).reshape(1, 1, 3)
    path = made(tmp_path / "a.c3d", ["C7"], points, UNITS=[unit])
    np.testing.assert_allclose(read_c3d(path, ("C7",)).xyz, points * metres, rtol=1e-6)


@pytest.mark.parametrize("name", ["a.c3d", "A.C3D", "take 1.c3d"])
def test_what_is_written_is_read_back(tmp_path: Path, name: str) -> None:
    xyz = np.random.default_rng(0).normal(size=(50, 3, 3)).astype(np.float32)
    xyz[7, 1] = np.nan
    layout = Layout(("C7", "LSHO", "RSHO"), 59.94)
    path = tmp_path / name
    write_c3d(path, layout, xyz)
    clip = read_c3d(path, layout.labels)
    np.testing.assert_allclose(clip.xyz, xyz, atol=1e-6)
    assert clip.layout.rate == pytest.approx(59.94)
    assert [entry.name for entry in tmp_path.iterdir()] == [name]


def test_bad_files_get_one_line_that_names_them(tmp_path: Path) -> None:
    points = np.ones((2, 1, 3))
    lacking = made(tmp_path / "few.c3d", ["C7"], points)
    with pytest.raises(SourceError, match=r"few\.c3d: lacks the markers LFHD, RFHD"):
        read_c3d(lacking)
    with pytest.raises(SourceError, match=r"none\.c3d: lacks the markers LFHD"):
        read_c3d(made(tmp_path / "none.c3d", ["X"], points), labels=None)
    with pytest.raises(SourceError, match=r"unit\.c3d: unknown unit 'furlong'"):
        read_c3d(made(tmp_path / "unit.c3d", ["C7"], points, UNITS=["furlong"]), ("C7",))
    (tmp_path / "text.c3d").write_text("not a capture\n" * 100)
    with pytest.raises(SourceError, match=r"text\.c3d: not a readable C3D file"):
        read_c3d(tmp_path / "text.c3d")
    whole = lacking.read_bytes()
    (tmp_path / "cut.c3d").write_bytes(whole[: len(whole) // 3])
    with pytest.raises(SourceError, match=r"cut\.c3d: not a readable C3D file"):
        read_c3d(tmp_path / "cut.c3d", ("C7",))
    (tmp_path / "empty.c3d").touch()
    with pytest.raises(SourceError, match=r"empty\.c3d: not a readable C3D file"):
        read_c3d(tmp_path / "empty.c3d")


def test_a_clip_plays_at_its_own_rate_or_a_multiple(tmp_path: Path) -> None:
    write_c3d(tmp_path / "a.c3d", Layout(("C7",), 100.0), np.ones((200, 1, 3), np.float32))
    clip = read_c3d(tmp_path / "a.c3d", labels=None)
    for speed in (1.0, 4.0):
        clock = VirtualClock(5.0)
        times = [frame.t - 5.0 for frame in C3dSource("a", clip, clock, speed)]
        np.testing.assert_allclose(times, np.arange(200) / (100.0 * speed), atol=1e-9)
        assert clock.now() == pytest.approx(5.0 + 1.99 / speed)


def test_a_file_of_other_names_and_axes_plays_as_ours(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    points = np.float32([[[100, 1500, -200], [0, 900, 50], [7, 7, 7]]])  # mm, Y up
    path = made(tmp_path / "a.c3d", ["ann:neck", "ann:Waist", "*12"], points)
    with open_source(f"c3d:{path}?frame=opengl&labels=neck:C7,nose:CLAV") as source:
        frame = source.read()
    assert frame.layout == Layout(("C7", "Waist"), 100.0)
    np.testing.assert_allclose(frame.xyz, [[0.1, 0.2, 1.5], [0, -0.05, 0.9]], rtol=1e-6)
    assert "names nose, which the file does not carry (it has neck, Waist)" in caplog.text
    with open_source(f"c3d:{path}?frame=unreal") as source:  # whose unit is not the file's
        np.testing.assert_allclose(source.read().xyz[0], [1.5, 0.1, -0.2], rtol=1e-6)


def test_labels_that_do_not_fit_a_file_are_told(tmp_path: Path) -> None:
    path = made(tmp_path / "a.c3d", ["neck", "C7"], np.ones((1, 2, 3)))
    with pytest.raises(SourceError, match=r"a\.c3d: the option labels .* twice: C7"):
        open_source(f"c3d:{path}?labels=neck:C7")
    with pytest.raises(UrlError, match="unknown option unit"):
        open_source(f"c3d:{path}?unit=mm")
