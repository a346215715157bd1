from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest

from drivers.errors import UsageError
from drivers.marker_set import MARKERS
from simulators.body_parts import BODY_PARTS
from simulators.faults.plan import KINDS, parse_plan, read_plan

LABELS = ("C7", "LSHO", "RTOE")
GOOD = """# a bad day
seed = 7

[[fault]]
kind = "dropout"
markers = ["C7", "RTOE"]
share = "20%"
frames = [10, 100]

[[fault]]
kind = "unplug"
at = 10
for = 0.5
every = 60
"""


def refused(text: str) -> str:
    with pytest.raises(UsageError) as caught:
        parse_plan(text, LABELS, "day.toml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_good_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "day.toml").write_text(GOOD)
    plan = read_plan(tmp_path / "day.toml", LABELS)
    assert plan.seed == 7
    assert [fault.kind for fault in plan.fault] == ["dropout", "unplug"]
    assert plan.fault[0].share == pytest.approx(0.2)
    assert (plan.fault[1].at, plan.fault[1].for_, plan.fault[1].every) == (10, 0.5, 60)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("seed = 7", "sed = 7", "day.toml, line 2: sed: unknown key (known: seed, fault)"),
        ("seed = 7", "seed = -1", "day.toml, line 2: seed: "),
        ("[[fault]]", "[[fault]", "day.toml: Expected ']]' at the end of an array declaration"),
        (
            '"unplug"',
            '"unplugg"',
            "day.toml, line 10: fault 2: unknown kind 'unplugg' (known: swap, ghost, noise, ",
        ),
        ('kind = "unplug"', "", "day.toml, line 10: fault 2: it names no kind (known: swap"),
        (
            "share",
            "shares",
            "day.toml, line 7: fault 1 (dropout): shares: unknown key (known: kind, at, for, ",
        ),
        ('"20%"', '"20"', "day.toml, line 7: fault 1 (dropout): share: '20' is no share"),
        ('"20%"', "2", "day.toml, line 7: fault 1 (dropout): share: "),
        ("[10, 100]", "[10]", "day.toml, line 8: fault 1 (dropout): frames: "),
        ("[10, 100]", '[10, "a"]', "day.toml, line 8: fault 1 (dropout): frames.1: "),
        (
            '"C7", "RTOE"',
            '"C7",\n  "LTOE"',
            "day.toml, line 7: fault 1 (dropout): markers.1: the device sends no marker LTOE (it "
            "sends C7, LSHO, RTOE)",
        ),
        ("for = 0.5", "for_ = 0.5", "day.toml, line 13: fault 2 (unplug): for_: unknown key"),
        ("for = 0.5", "for = -1", "day.toml, line 13: fault 2 (unplug): for: "),
        ("for = 0.5", "for = inf", "day.toml, line 13: fault 2 (unplug): for: "),
        ("for = 0.5", "for = 61", "day.toml, line 10: fault 2 (unplug): every goes with at, and "),
        ("for = 0.5", "", "day.toml, line 10: fault 2 (unplug): it needs for, in seconds"),
        ("at = 10", "chance = 0.5", "fault 2 (unplug): every goes with at"),
        ("at = 10\nfor = 0.5\nevery = 60", "for = 0.5", "fault 2 (unplug): for goes with at or"),
        ("every = 60", "chance = 0.5", "fault 2 (unplug): it has either a moment (at) or a chance"),
    ],
)
def test_a_mistake_is_named_with_file_line_and_key(old: str, new: str, said: str) -> None:
    assert GOOD.count(old) >= 1
    assert said in refused(GOOD.replace(old, new, 1))


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ('kind = "occlusion"\npart = "left wing"', "part 'left wing' is unknown (known: head"),
        ('kind = "occlusion"\npart = "left hand"', "sends no marker of the left hand (it sends C7"),
        ('kind = "swap"\nmarkers = ["C7"]', "(swap): markers: "),
        ('kind = "swap"', "(swap): markers: it has to be there"),
        ('kind = "noise"\nsize = 1', "'1' is no length: write for example 1mm"),
        ('kind = "ghost"\nmarker = "C7"\nlabel = "RTOE"', "label RTOE is that of a marker"),
        ('kind = "ghost"\nmarker = "C7"\nmirror = { w = 1 }', "(ghost): mirror.w"),
        ('kind = "dropout"\nshare = 0.9\nframes = [1, 2]', "make them longer"),
        ('kind = "dropout"\nshare = 0.1', "share and frames go together"),
        ('kind = "clock_jump"\nseconds = 1', "it needs at or chance"),
        ('kind = "stall"\nfor = 1', "for goes with at or chance"),
        ('kind = "flip"\nbits = 0', "(flip): bits: "),
        ('kind = "loss"\nchance = "many"', "(loss): chance: 'many' is no share"),
    ],
)
def test_what_a_fault_cannot_mean_is_refused(fault: str, said: str) -> None:
    assert said in refused(f"[[fault]]\n{fault}\n")


@pytest.mark.parametrize(("name", "content"), [("none.toml", None), ("bytes.toml", b"\xff\xfe")])
def test_a_file_that_cannot_be_read(tmp_path: Path, name: str, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(UsageError, match=rf"^cannot read the fault file .*{name}: "):
        read_plan(tmp_path / name, LABELS)


def test_body_parts_are_of_the_marker_set_and_leave_nothing_out() -> None:
    named = {label for part in BODY_PARTS.values() for label in part}
    assert named == set(MARKERS)


def test_what_the_document_says_is_what_there_is() -> None:
    text = (Path(__file__).parents[2] / "docs/faults.md").read_text()
    plan = parse_plan(text.split("```toml\n")[1].split("```")[0], MARKERS)
    assert [fault.kind for fault in plan.fault] == ["occlusion", "loss", "unplug"]
    for kind in KINDS:
        (name,) = get_args(kind.model_fields["kind"].annotation)
        assert f"| `{name}` |" in text
