from __future__ import annotations

import pytest

from drivers.toml_lines import line_of

TEXT = '''# a session
seed = 7
model.name = "default"

[view]
"frame rate" = 30   # [not a header]
size = { width = 1280, height = 720 }

[view.camera]
note = """
[[fault]]
kind = "none"
"""
far = 9

[[fault]]
kind = "noise"
sizes = [
    1,  # ]
    { at = 2 },

    [3,
     4],
]

[[fault]]
  kind = "swap"
  markers = ["A", "B"]
[[fault.more]]
deep = true
'''


@pytest.mark.parametrize(
    ("path", "line"),
    [
        (("seed",), 2),
        (("model",), 3),
        (("model", "name"), 3),
        (("view",), 5),
        (("view", "frame rate"), 6),
        (("view", "size", "height"), 7),
        (("view", "camera"), 9),
        (("view", "camera", "note"), 10),
        (("view", "camera", "far"), 14),
        (("fault",), 16),
        (("fault", 0), 16),
        (("fault", 0, "kind"), 17),
        (("fault", 0, "sizes"), 18),
        (("fault", 0, "sizes", 0), 19),
        (("fault", 0, "sizes", 1, "at"), 20),
        (("fault", 0, "sizes", 2, 1), 23),
        (("fault", 1), 26),
        (("fault", 1, "kind"), 27),
        (("fault", 1, "markers", 1), 28),
        (("fault", 1, "more", 0, "deep"), 30),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_line_where_a_key_stands(path: tuple[str | int, ...], line: int, end: str) -> None:
    assert line_of(TEXT.replace("\n", end), path) == line


@pytest.mark.parametrize("path", [("none",), ("fault", 2), ("fault", "kind"), ("seed", 0)])
def test_what_is_not_there_has_no_line(path: tuple[str | int, ...]) -> None:
    assert line_of(TEXT, path) is None


def test_what_stands_before_a_mistake_is_found() -> None:
    assert line_of("a = 1\nb = = 2\n", ("a",)) == 1
    assert line_of("a = 1\nb = = 2\n", ("b",)) is None
