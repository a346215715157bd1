from pathlib import Path

from training.telling import command_line, left_out


def test_a_command_names_files_without_their_folders():
    given = ["/home/ann/my data", "--out=/tmp/m.onnx", "--principal", "A,B", "--report", "b/page"]
    told = command_line("train", given)
    assert told == "markerbridge train 'my data' --out=m.onnx --principal A,B --report page"


def test_what_was_left_out_is_named_within_its_folder():
    warnings = [
        "left out: /home/ann/data/real/a.c3d: not a readable C3D file (why: that)",
        "no folds: this is about something else",
        "left out: b.c3d: fewer than 10 frames",
    ]
    assert left_out(warnings, (Path("/home/ann/data"), None)) == [
        ("real/a.c3d", "not a readable C3D file (why: that)"),
        ("b.c3d", "fewer than 10 frames"),
    ]
