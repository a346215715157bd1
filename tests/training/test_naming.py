import csv

import pytest

from training.naming import subject_of


@pytest.mark.parametrize(
    ("file", "subject"),
    [
        ("02_01.c3d", "02"),
        ("subjects/02/02_01.c3d", "02"),
        ("135_02.C3D", "135"),
        ("HDM_bd_05-01_01.c3d", "bd"),
        ("HDM05/HDM_tr_cartwheelLHandStart1Reps_001_120.C3D", "tr"),
        ("walk_494.c3d", None),
        ("2024_01.c3d", None),
        ("02_01.amc", None),
        ("02_01.c3d.part", None),
        ("02_01_cut.c3d", None),
        ("02_01/take.c3d", None),
        ("HDM_bd.c3d", None),
        ("", None),
    ],
)
def test_the_subject_is_in_the_name(file, subject):
    assert subject_of(file) == subject


def test_it_agrees_with_a_manifest_written_by_hand(data_dir):
    with (data_dir / "manifest.csv").open(newline="") as file:
        told = {row["file"]: row["subject"] for row in csv.DictReader(file)}
    found = {name: subject_of(name) for name in told}
    assert {name: told[name] for name in told if found[name]} == {
        name: subject for name, subject in found.items() if subject
    }
    assert sum(subject is not None for subject in found.values()) == 15
