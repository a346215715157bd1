from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.body_frame import REFERENCES
from drivers.errors import UsageError
from drivers.marker_set import MARKERS
from training.marker_wishes import NOT_WEARABLE, SHOULDERS, WEARABLE, Wishes, can_fill


def parts():
    """The labels without their side, where they have one."""
    twins = {label[1:] for label in MARKERS if "L" + label[1:] in MARKERS}
    return {label[1:] if label[1:] in twins else label for label in MARKERS}


def test_the_tables_tell_of_every_marker_once():
    assert {*WEARABLE} | {*NOT_WEARABLE} == parts()
    assert not {*WEARABLE} & {*NOT_WEARABLE}


def test_without_wishes_all_but_the_references_are_free():
    choice = Wishes().choice()
    assert choice.references == REFERENCES
    assert {label for unit in choice.units for label in unit} == {*MARKERS} - {*REFERENCES}
    assert all(len(unit) == 1 for unit in choice.units)
    assert (choice.must, choice.left) == ((), 6)


def test_a_pair_is_a_unit_and_the_middle_stands_alone():
    choice = Wishes(pairs=True).choice()
    alone = {unit[0] for unit in choice.units if len(unit) == 1}
    assert alone == {"T10", "CLAV", "STRN"}
    pairs = [unit for unit in choice.units if len(unit) == 2]
    assert len(pairs) == 17
    assert all(left == "L" + right[1:] and right[0] == "R" for left, right in pairs)


def test_one_of_a_pair_brings_its_twin():
    choice = Wishes(must=("RTOE",), pairs=True).choice()
    assert choice.must == ("LTOE", "RTOE")
    assert choice.left == 4
    assert not any("LTOE" in unit for unit in choice.units)
    choice = Wishes(never=("RTOE",), pairs=True).choice()
    assert not any("LTOE" in unit for unit in choice.units)


def test_on_clothes_only_what_something_holds():
    free = {label for unit in Wishes(clothes=True).choice().units for label in unit}
    assert {"LFHD", "RWRB", "LBWT", "RANK", "LMT5", "T10"} <= free
    assert not free & {"LKNE", "RELB", "RBAC", "CLAV", "RSHN", "C7"}


def test_alone_the_shoulders_count_and_c7_is_one_of_many():
    choice = Wishes(alone=True).choice()
    assert choice.references == choice.must == SHOULDERS
    assert choice.left == 4
    assert ("C7",) in choice.units
    assert Wishes(alone=True, must=("LSHO",)).choice() == choice
    assert Wishes(alone=True, pairs=True).choice().must == SHOULDERS


@pytest.mark.parametrize(
    ("wishes", "told"),
    [
        ({"must": ("NOSE",)}, "--must: NOSE not in the marker set"),
        ({"never": ("LTOE", "")}, "--never: .* not in the marker set"),
        ({"must": ("C7",)}, "--must: C7 are references"),
        ({"never": ("LSHO", "RSHO")}, "--never: LSHO, RSHO are references"),
        ({"never": ("LSHO",), "alone": True}, "--never: LSHO are references"),
        ({"must": ("LTOE", "LFIN"), "never": ("LFIN",)}, "--must and --never both name LFIN"),
        ({"must": ("LTOE", "LFIN"), "count": 1}, "--count 1 is less than .*: LFIN, LTOE"),
        ({"must": ("LTOE", "T10"), "count": 2, "pairs": True}, "--count 2 is less than"),
        ({"alone": True, "count": 1}, "--count 1 is less than .*: LSHO, RSHO"),
        ({"must": ("RBAC",), "pairs": True}, "--must: RBAC has no twin"),
        (
            {"must": ("LTOE",), "never": ("RTOE",), "pairs": True},
            "--never: RTOE is the twin",
        ),
        ({"must": ("LKNE",), "clothes": True}, "LKNE does not go with --clothes: trousers"),
        ({"count": 39}, "--count 39: the wishes leave 38 markers"),
        ({"count": 38}, "--count 38: no marker is left to be estimated"),
        ({"alone": True, "count": 41}, "--count 41: no marker is left to be estimated"),
        (
            {"count": 5, "pairs": True, "never": ("T10", "CLAV", "STRN")},
            "to choose 5 from in pairs, which cannot be",
        ),
    ],
)
def test_wishes_that_cannot_be_kept(wishes, told):
    with pytest.raises(UsageError, match=told):
        Wishes(**wishes).choice()


@given(st.integers(-3, 8), st.integers(0, 4), st.integers(0, 3))
def test_can_fill_is_what_trying_all_finds(left, singles, pairs):
    units = [("A",)] * singles + [("A", "B")] * pairs
    sums = {
        sum(map(len, some)) for size in range(len(units) + 1) for some in combinations(units, size)
    }
    assert can_fill(left, units) == (left in sums)
