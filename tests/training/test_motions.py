import csv

import pytest

from training.motions import category


@pytest.mark.parametrize(
    ("motion", "kind"),
    [
        ("walk", "walking"),
        ("brisk walk", "walking"),
        ("Walking", "walking"),
        ("walk, veer left", "walking"),
        ("run/jog", "running"),
        ("run/jog, sudden stop", "running"),
        ("walk/run", "running"),
        ("golf swing", "golfing"),
        ("golf - putt", "golfing"),
        ("cartwheel", "cartwheeling"),
        ("salsa dance", "salsa dancing"),
        ("walk on uneven terrain", "walking on uneven terrain"),
        ("running jump", "running jump"),
        ("run, leap", "running jump"),
        ("soccer kick", "soccer kick"),
        ("kick soccer ball", "soccer kick"),
        ("climb 3 steps", "climbing three steps"),
        ("climbing three steps", "climbing three steps"),
        ("forward jump", "jumping"),
        ("jump twist", "jumping"),
        ("playground: forward jumps, turn around", "jumping"),
        ("hop on left foot", "jumping"),
        ("playground - climb, hang, swing", "climbing"),
        ("walk down stairs", "climbing"),
        ("punch/strike", "fighting"),
        ("karate: empi kata", "fighting"),
        ("breakdance, long sequence", "dancing"),
        ("dance - expressive arms, pirouette", "dancing"),
        ("basketball_signal", "basketball signals"),
        ("basketball - forward dribble", "basketball"),
        ("directing_traffic", "directing traffic"),
        ("washwindow", "washing"),
        ("acrobatics", "acrobatics"),
        ("soccer", "soccer"),
        ("script 1-2", "mixed"),
        ("mixed", "mixed"),
        ("bend over, scoop up, rise, lift arm", "other"),
        ("", "unknown"),
        (" - ", "unknown"),
        ("Unknown", "unknown"),
    ],
)
def test_the_kind_of_a_description(motion, kind):
    assert category(motion) == kind


@pytest.mark.parametrize("motion", ["crawl under a trunk", "shop", "prune", "description", "ogolf"])
def test_a_word_inside_another_does_not_count(motion):
    assert category(motion) == "other"


def test_every_capture_at_hand_has_a_kind(data_dir):
    with (data_dir / "manifest.csv").open(newline="") as file:
        motions = {row["motion"] for row in csv.DictReader(file)}
    assert not {motion for motion in motions if category(motion) in ("other", "unknown")}
