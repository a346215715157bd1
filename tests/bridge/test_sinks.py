"""Sinks by their addresses, and recordings as C3D."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkError
from drivers.c3d_file import read_c3d, write_c3d
from drivers.frame import Layout
from drivers.udp_sender import AddressError
from drivers.url import UrlError
from tests.bridge.poses import CONTEXT, pose, unknown


def test_a_recording_holds_every_pose_and_lost_ones_as_missing(tmp_path: Path) -> None:
    path = tmp_path / "out.c3d"
    sink = open_sink(f"c3d:{path}", CONTEXT)
    poses = [pose(i, seed=i) for i in (0, 1, 4)]
    for each in poses:
        sink(each)
    sink(unknown(5))
    sink.close()
    sink.close()
    clip = read_c3d(path)
    assert clip.layout.rate == 100.0
    assert len(clip.xyz) == 6  # frames 2 and 3 were never seen, 5 was lost
    assert np.isnan(clip.xyz[[2, 3, 5]]).all()
    np.testing.assert_allclose(clip.xyz[[0, 1, 4]], [p.xyz for p in poses], atol=1e-6)


def test_a_recording_longer_than_c3d_goes_on_in_another_file(tmp_path, monkeypatch) -> None:
    """As C3D counts frames in 16 bits; here it counts to 100."""
    monkeypatch.setattr("bridge.sinks.c3d.MAX_FRAMES", 100)
    sink = open_sink(f"c3d:{tmp_path / 'out.c3d'}", CONTEXT)
    for index in range(250):
        sink(pose(index))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out-2.c3d", "out.c3d"]
    sink.close()
    lengths = [len(read_c3d(path).xyz) for path in sorted(tmp_path.iterdir())]
    assert lengths == [100, 50, 100]  # out-2, out-3, out
    with pytest.raises(ValueError, match="a C3D file counts to 65535"):
        write_c3d(tmp_path / "x.c3d", Layout(("C7",), 120.0), np.ones((65536, 1, 3), np.float32))


def test_a_recording_without_a_pose_leaves_no_file(tmp_path: Path) -> None:
    open_sink(f"c3d:{tmp_path / 'out.c3d'}", CONTEXT).close()
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(SinkError, match="it is a folder"):
        open_sink(f"c3d:{tmp_path}", CONTEXT)
    with pytest.raises(SinkError, match=r"cannot write .*No such file or directory"):
        open_sink(f"c3d:{tmp_path / 'no' / 'out.c3d'}", CONTEXT)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("fax:1", "is no sink: known are vmc, vrchat, vmt, qtm-osc, osc, c3d, view"),
        (
            "vmc://127.0.0.1:1?rat=3",
            "unknown option rat (known: send, hips, rate, uncertain, sigma",
        ),
        ("vmc://127.0.0.1:1?rate=fast", "option rate=fast is wrong"),
        ("vmc://127.0.0.1:1?rate=-5", "option rate=-5 is wrong"),
        ("vmc://127.0.0.1:1?send=faces", "known are both, bones, trackers"),
        ("vmc://127.0.0.1:1?hips=92", "write a length with its unit, for example 80mm"),
        ("vmt://127.0.0.1:1?uncertain=maybe", "known are show, fade, hide, hold"),
        ("vmt://127.0.0.1:1?sigma=80", "write a length with its unit, for example 80mm"),
        ("vmt://127.0.0.1:1?sigma=8em", "write a length with its unit, for example 80mm"),
        ("vmt://127.0.0.1:1?sigma=0mm", "'0' is no number above 0"),
        ("vmt://127.0.0.1:1?index=48", "a whole number from 0 to 47: VMT has 58 trackers"),
        ("vrchat://127.0.0.1:1?head=maybe", "known are yes, position, no"),
        ("vrchat://127.0.0.1:1?trackers=1,9", "write some of 1 to 8, each once: 1,2,3"),
        ("vrchat://127.0.0.1:1?trackers=1,1", "write some of 1 to 8, each once: 1,2,3"),
        ("vmt://127.0.0.1:1?trackers=", "write some of 0 to 10, each once: 1,2,3"),
        ("qtm-osc://127.0.0.1", "names no port: write qtm-osc://127.0.0.1:9100"),
        ("qtm-osc://127.0.0.1:1?frame=blender", "known are cmu, c3d, ros"),
        ("qtm-osc://127.0.0.1:1?labels=Hand:HAND", "the model has no marker HAND"),
        ("osc://127.0.0.1:1?labels=LSHO:C7", "marker labels occur twice: LSHO"),
        ("osc://127.0.0.1:1?labels=a%00:C7", "at most 255 letters, all of them printable"),
        (f"osc://127.0.0.1:1?labels={'a' * 256}:C7", "at most 255 letters"),
        ("qtm-osc://127.0.0.1:1?labels=C*:C7", "marker 'C*': a name here is"),
        ("c3d:", "names no path"),
    ],
)
def test_an_address_that_cannot_be_meant_is_refused(address: str, words: str) -> None:
    with pytest.raises(UrlError) as caught:
        open_sink(address, CONTEXT)
    assert words in str(caught.value)


def test_an_unknown_host_is_refused() -> None:
    with pytest.raises(AddressError, match=r"cannot send to host\.invalid"):
        open_sink("osc://host.invalid:9000", CONTEXT)
