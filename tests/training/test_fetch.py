"""Against a server on this machine that serves real captures as the database's site does."""

import csv
import hashlib
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from drivers.c3d_file import read_c3d, write_c3d
from drivers.clock import VirtualClock
from drivers.errors import MarkerbridgeError
from drivers.frame import Layout
from tests.training.cmu_site import FILES, MOTIONS, serving
from training.dataset import load
from training.download import WAITS, DownloadError, download
from training.fetch_command import main


@pytest.fixture
def site(data_dir, monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with serving(data_dir) as site:
        yield site


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "captures"


def fetch(site, folder, *options, subjects="02,07", clock=None):
    argv = ["cmu", "--subjects", subjects, "--to", str(folder), "--from", site.url, *options]
    return main(argv, clock or VirtualClock())


def manifest(folder):
    with (folder / "manifest.csv").open(newline="") as file:
        return {row["file"]: row for row in csv.DictReader(file)}


def there(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.*"))


def sha256(content):
    return hashlib.sha256(content).hexdigest()


def test_subjects_come_with_a_manifest_and_checksums(site, folder, data_dir):
    clock = VirtualClock()
    assert fetch(site, folder, clock=clock) == 0
    assert there(folder) == sorted([*FILES, "checksums.txt", "manifest.csv"])
    for file in FILES:
        assert (folder / file).read_bytes() == (data_dir / "real" / file[3:]).read_bytes()
    assert manifest(folder)["02/02_03.c3d"] == {
        "file": "02/02_03.c3d",
        "kind": "real",
        "dataset": "CMU",
        "subject": "02",
        "motion": "run/jog",
    }
    assert (folder / "checksums.txt").read_text().splitlines() == [
        f"{file} {sha256((folder / file).read_bytes())}" for file in FILES
    ]
    takes = load(folder, None, pytest.fail)
    assert [(take.name, take.subject, take.motion) for take in takes] == [
        (file, file[:2], motion) for file, motion in zip(FILES, MOTIONS.values(), strict=True)
    ]
    assert clock.now() == 0


def test_what_is_there_and_right_is_not_downloaded_again(site, folder):
    fetch(site, folder, subjects="02")
    fetch(site, folder, subjects="2,7,02")
    assert sorted(site.captures_asked) == sorted(f"/subjects/{file}" for file in FILES)
    assert sorted(manifest(folder)) == FILES


def test_a_damaged_file_is_replaced(site, folder):
    fetch(site, folder)
    whole = (folder / FILES[1]).read_bytes()
    (folder / FILES[1]).write_bytes(whole[:-1] + b"?")
    del site.asked[:]
    assert fetch(site, folder) == 0
    assert (folder / FILES[1]).read_bytes() == whole
    assert site.captures_asked == [f"/subjects/{FILES[1]}"]


def test_a_cut_download_goes_on_where_it_ended(site, folder):
    path = "/subjects/02/02_01.c3d"
    site.faults[path] = ["cut", "cut"]
    clock = VirtualClock()
    assert fetch(site, folder, clock=clock) == 0
    size = len(site.files[path])
    assert site.sent[path] == [(0, 100_000), (100_000, 200_000), (200_000, size)]
    assert [header for asked, header in site.asked if asked == path] == [
        None,
        "bytes=100000-",
        "bytes=200000-",
    ]
    assert (folder / "02/02_01.c3d").read_bytes() == site.files[path]
    assert clock.now() == sum(WAITS[:2])


def test_a_line_that_falls_silent_is_given_up(site, folder, monkeypatch):
    monkeypatch.setattr("training.download.TIMEOUT", 0.2)
    path = "/subjects/07/07_12.c3d"
    site.faults[path] = ["stall"]
    assert fetch(site, folder, subjects="07") == 0
    assert site.sent[path] == [(0, 100_000), (100_000, len(site.files[path]))]
    assert (folder / "07/07_12.c3d").read_bytes() == site.files[path]


def test_a_server_without_ranges_sends_all_of_it_again(site, folder):
    path = "/subjects/02/02_01.c3d"
    site.ranges = False
    site.faults[path] = ["cut"]
    assert fetch(site, folder) == 0
    assert site.sent[path] == [(0, 100_000), (0, len(site.files[path]))]
    assert (folder / "02/02_01.c3d").read_bytes() == site.files[path]


def test_the_next_run_goes_on_too(site, folder):
    path = "/subjects/02/02_01.c3d"
    site.faults[path] = ["cut", 503, 503, 503]
    with pytest.raises(MarkerbridgeError, match="the same command again goes on from here"):
        fetch(site, folder)
    assert sorted(manifest(folder)) == FILES[1:]
    assert fetch(site, folder) == 0
    assert site.sent[path] == [(0, 100_000), (100_000, len(site.files[path]))]
    assert sorted(manifest(folder)) == FILES
    assert (folder / FILES[0]).read_bytes() == site.files[path]
    assert there(folder) == sorted([*FILES, "checksums.txt", "manifest.csv"])


def test_the_part_of_a_file_that_has_changed_since_is_not_used(site, folder):
    path = "/subjects/02/02_01.c3d"
    site.faults[path] = ["cut", 503, 503, 503]
    with pytest.raises(MarkerbridgeError):
        fetch(site, folder)
    site.files[path] = site.files["/subjects/02/02_02.c3d"]
    site.modified = 4e9  # 2096
    assert fetch(site, folder) == 0
    assert (folder / FILES[0]).read_bytes() == site.files[path]


@pytest.mark.parametrize("excess", [0, 1])
def test_a_part_that_is_no_beginning_is_dropped(site, tmp_path, excess):
    content = site.files["/subjects/02/02_03.c3d"]
    part = tmp_path / "part"
    part.write_bytes(b"x" * (len(content) + excess))
    download(f"{site.url}/subjects/02/02_03.c3d", part, VirtualClock())
    assert part.read_bytes() == content


def test_ctrl_c_leaves_what_is_there(site, folder):
    class Interrupted(VirtualClock):
        def sleep_until(self, moment):
            raise KeyboardInterrupt

    path = "/subjects/02/02_02.c3d"
    site.faults[path] = ["cut"]
    with pytest.raises(KeyboardInterrupt):
        fetch(site, folder, clock=Interrupted())
    assert list(manifest(folder)) == FILES[:1]
    assert fetch(site, folder) == 0
    assert site.captures_asked.count("/subjects/02/02_01.c3d") == 1
    assert site.sent[path] == [(0, 100_000), (100_000, len(site.files[path]))]
    assert sorted(manifest(folder)) == FILES


def test_an_overloaded_server_is_given_time(site, folder):
    site.faults["/search.php?subjectnumber=7"] = [500, "cut"]
    site.faults["/subjects/07/07_12.c3d"] = [503, 503]
    clock = VirtualClock()
    assert fetch(site, folder, subjects="07", clock=clock) == 0
    assert clock.now() == 2 * sum(WAITS[:2])


def test_what_is_not_there_is_named_and_the_rest_goes_on(site, folder, capsys):
    del site.files["/subjects/02/02_02.c3d"]
    clock = VirtualClock()
    with pytest.raises(MarkerbridgeError, match="not all could be had") as error:
        fetch(site, folder, clock=clock)
    assert error.value.exit_status == 1
    told = capsys.readouterr().err
    assert f"missing: {site.url}/subjects/02/02_02.c3d: the server answers 404 Not Found" in told
    assert sorted(manifest(folder)) == [FILES[0], FILES[2], FILES[3]]
    assert site.captures_asked.count("/subjects/02/02_02.c3d") == 1  # no use in trying again
    assert clock.now() == 0


def test_a_subject_that_the_index_does_not_know(site, folder, capsys):
    site.files["/search.php?subjectnumber=4"] = b"<html><p>No results.</p></html>"
    with pytest.raises(MarkerbridgeError, match="not all could be had"):
        fetch(site, folder, subjects="04,07")
    url = f"{site.url}/search.php?subjectnumber=4"
    assert f"the index at {url} names no trial of subject 04" in capsys.readouterr().err
    assert list(manifest(folder)) == ["07/07_12.c3d"]


def test_a_server_that_is_not_there(site, folder, capsys):
    with ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as closed:
        site.url = f"http://127.0.0.1:{closed.server_port}"
    clock = VirtualClock()
    with pytest.raises(MarkerbridgeError, match="not all could be had"):
        fetch(site, folder, subjects="02", clock=clock)
    told = capsys.readouterr().err
    assert f"{site.url}/search.php?subjectnumber=2: no connection (4 tries)" in told
    assert "captures, described" not in told
    assert clock.now() == sum(WAITS)
    assert not list(folder.iterdir())


def test_what_does_not_end_is_given_up(site, tmp_path):
    part = tmp_path / "part"
    with pytest.raises(DownloadError, match="more than 50,000 bytes, and no end"):
        download(f"{site.url}/subjects/02/02_03.c3d", part, VirtualClock(), largest=50_000)
    assert part.stat().st_size < 50_000 + 2**17


def test_an_unsafe_connection_is_not_tried_again(site, folder, capsys):
    site.url = site.url.replace("http:", "https:")  # the server does not speak it
    clock = VirtualClock()
    with pytest.raises(MarkerbridgeError, match="not all could be had"):
        fetch(site, folder, subjects="02", clock=clock)
    assert "no safe connection" in capsys.readouterr().err
    assert clock.now() == 0


@pytest.mark.parametrize("cut", [False, True], ids=["page", "cut"])
def test_what_is_no_whole_capture_is_refused(site, folder, capsys, cut):
    path = "/subjects/02/02_02.c3d"
    content = site.files[path]
    site.files[path] = content[:150_000] if cut else b"<html>Please try again later</html>" * 50
    with pytest.raises(MarkerbridgeError, match="not all could be had"):
        fetch(site, folder)
    told = capsys.readouterr().err
    assert f"{site.url}{path} is no whole capture" in told
    assert ("cut short" if cut else "does not begin as a C3D file does") in told
    assert there(folder) == sorted([FILES[0], *FILES[2:], "checksums.txt", "manifest.csv"])
    site.files[path] = content
    assert fetch(site, folder) == 0
    assert (folder / FILES[1]).read_bytes() == content


def test_a_capture_that_lacks_markers_is_kept_and_named(site, folder, data_dir, tmp_path, capsys):
    clip = read_c3d(data_dir / "real" / "07_12.c3d")
    layout = Layout(clip.layout.labels[1:], clip.layout.rate)
    write_c3d(tmp_path / "few.c3d", layout, np.ascontiguousarray(clip.xyz[:, 1:]))
    site.files["/subjects/07/07_12.c3d"] = (tmp_path / "few.c3d").read_bytes()
    assert fetch(site, folder, subjects="07") == 0
    told = capsys.readouterr().err
    assert f"07/07_12.c3d is kept, but cannot be used: it lacks {clip.layout.labels[0]}\n" in told
    assert list(manifest(folder)) == ["07/07_12.c3d"]


def test_checksums_from_elsewhere_must_match(site, folder, tmp_path, capsys):
    right = {file: sha256(site.files[f"/subjects/{file}"]) for file in FILES}
    wrong = sha256(b"another")
    registry = tmp_path / "colleague.txt"
    lines = {**right, FILES[1]: wrong}
    del lines[FILES[2]]
    registry.write_text("".join(f"{file} {checksum}\n" for file, checksum in lines.items()))
    with pytest.raises(MarkerbridgeError, match="not all could be had"):
        fetch(site, folder, "--checksums", str(registry))
    told = capsys.readouterr().err
    assert "02_02.c3d" in told
    assert wrong in told
    assert right[FILES[1]] in told
    assert f"{FILES[2]}: {registry} has no checksum of it" in told
    assert there(folder) == sorted([FILES[0], FILES[3], "checksums.txt", "manifest.csv"])
    assert sorted(manifest(folder)) == [FILES[0], FILES[3]]
    registry.write_text("".join(f"{file} {checksum}\n" for file, checksum in right.items()))
    assert fetch(site, folder, "--checksums", str(registry)) == 0
    assert (folder / "checksums.txt").read_text() == registry.read_text()


def test_a_file_that_the_site_has_changed_is_not_taken_for_the_same(site, folder, capsys):
    fetch(site, folder, subjects="07")
    before = (folder / FILES[3]).read_bytes()
    (folder / FILES[3]).unlink()
    site.files["/subjects/07/07_12.c3d"] = after = site.files["/subjects/02/02_01.c3d"]
    with pytest.raises(MarkerbridgeError, match="not all could be had"):
        fetch(site, folder, subjects="07")
    told = capsys.readouterr().err
    assert sha256(before) in told
    assert sha256(after) in told
    assert not (folder / FILES[3]).exists()


def test_files_from_the_archives_are_taken_as_they_are(site, folder):
    for file, content in ((FILES[0], site.files[f"/subjects/{FILES[0]}"]), (FILES[1], b"<html>")):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(content)
    assert fetch(site, folder) == 0
    assert site.captures_asked == [f"/subjects/{file}" for file in FILES[1:]]
    assert sorted(manifest(folder)) == FILES
    assert (folder / FILES[1]).read_bytes() == site.files[f"/subjects/{FILES[1]}"]


def test_a_manifest_of_others_is_added_to(site, folder):
    folder.mkdir()
    (folder / "manifest.csv").write_text(
        "split,file,subject,motion,note\n"
        'train,mine.c3d,ann,"dance, slow",first\n'
        "test,02/02_01.c3d,,walk with care,\n"
    )
    fetch(site, folder, subjects="02")
    rows = manifest(folder)
    assert list(rows) == [*FILES[:3], "mine.c3d"]
    assert rows["mine.c3d"] == {
        "split": "train",
        "file": "mine.c3d",
        "subject": "ann",
        "motion": "dance, slow",
        "note": "first",
        "kind": "",
        "dataset": "",
    }
    assert rows[FILES[0]]["split"] == "test"
    assert rows[FILES[0]]["motion"] == "walk with care"
    assert rows[FILES[0]]["subject"] == "02"
    assert rows[FILES[1]]["split"] == ""
    before = (folder / "manifest.csv").read_bytes()
    fetch(site, folder, subjects="02")
    assert (folder / "manifest.csv").read_bytes() == before


@pytest.mark.parametrize(
    "table",
    [
        b"name,who\na.c3d,ann\n",
        b"file,who\na.c3d,ann,too,much\n",
        b"file\na.c3d\na.c3d\n",
        b"file,who\n,ann\n",
        b"\xff\xfe\x00",
    ],
)
def test_a_manifest_that_cannot_be_kept_stops_it_before_anything(site, folder, table):
    folder.mkdir()
    (folder / "manifest.csv").write_bytes(table)
    with pytest.raises(MarkerbridgeError, match=r"manifest\.csv: n"):
        fetch(site, folder)
    assert (folder / "manifest.csv").read_bytes() == table
    assert not site.asked


def test_checksums_that_cannot_be_read(site, folder, tmp_path):
    registry = tmp_path / "sums.txt"
    registry.write_text("one two three four\n")
    with pytest.raises(MarkerbridgeError, match=r"sums\.txt: not a list of names and checksums"):
        fetch(site, folder, "--checksums", str(registry))
    with pytest.raises(MarkerbridgeError, match="no such file") as error:
        fetch(site, folder, "--checksums", str(tmp_path / "gone.txt"))
    assert error.value.exit_status == 2
    assert not site.asked


def test_a_matching_checksum_does_not_make_a_capture(site, folder, tmp_path, capsys):
    (folder / FILES[3]).parent.mkdir(parents=True)
    (folder / FILES[3]).write_bytes(b"a note")
    registry = tmp_path / "sums.txt"
    registry.write_text(f"{FILES[3]} {sha256(b'a note')}\n")
    with pytest.raises(MarkerbridgeError, match="not all could be had"):
        fetch(site, folder, "--checksums", str(registry), subjects="07")
    assert "07_12.c3d: not a readable C3D file" in capsys.readouterr().err
    assert not (folder / "manifest.csv").exists()


def test_where_it_cannot_write(site, tmp_path):
    with pytest.raises(MarkerbridgeError, match="cannot make the folder"):
        fetch(site, tmp_path / "no" / "captures")
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(MarkerbridgeError, match="cannot make the folder"):
        fetch(site, tmp_path / "file")
    (tmp_path / "captures").mkdir()
    (tmp_path / "captures" / "02").write_text("in the way")
    with pytest.raises(MarkerbridgeError, match="cannot write in"):
        fetch(site, tmp_path / "captures")


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (["cmu", "--to", "x"], "--subjects"),
        (["cmu", "--subjects", "02"], "--to"),
        (["hdm05", "--subjects", "02", "--to", "x"], "cmu"),
        (["cmu", "--subjects", "02,walk", "--to", "x"], "'walk' is no subject's number"),
        (["cmu", "--subjects", "0", "--to", "x"], "'0' is no subject's number"),
        (["cmu", "--subjects", "02,", "--to", "x"], "'' is no subject's number"),
        (["cmu", "--subjects", "all", "--to", "x"], "all captures in archives"),
        (["cmu", "--subjects", "02", "--to", "x", "--from", "cmu.edu"], "is no address"),
    ],
)
def test_wrong_usage(wrong, told, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as leaving:
        main(wrong)
    assert leaving.value.code == 2
    assert told in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
