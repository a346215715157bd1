import argparse
from pathlib import Path

from training.telling import Notices, command_line


def test_a_command_names_files_without_their_folders():
    given = ["/home/ann/my data", "--out=/tmp/m.onnx", "--show", "real/a.c3d,real/b.c3d"]
    given += ["--cluster", "tcp://10.0.0.1:8786", "--report", "b/page"]
    options = argparse.Namespace(
        data=Path("/home/ann/my data"), out=Path("/tmp/m.onnx"), report=Path("b/page"), seed=0
    )
    assert command_line("train", given, options) == (
        "markerbridge train 'my data' --out=m.onnx --show real/a.c3d,real/b.c3d "
        "--cluster tcp://10.0.0.1:8786 --report page"
    )


def test_what_was_left_out_is_kept_and_told(capsys):
    notices = Notices()
    notices.warn("left out: real/a.c3d: not a readable C3D file (why: that)")
    notices.warn("no folds: this is about [something] else")
    notices.warn("left out: b.c3d: fewer than 10 frames")
    assert notices.left_out == [
        ("real/a.c3d", "not a readable C3D file (why: that)"),
        ("b.c3d", "fewer than 10 frames"),
    ]
    assert capsys.readouterr().err.splitlines() == [
        "left out: real/a.c3d: not a readable C3D file (why: that)",
        "no folds: this is about [something] else",
        "left out: b.c3d: fewer than 10 frames",
    ]
