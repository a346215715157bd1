import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bridge.body_frame import REFERENCES
from drivers.errors import MarkerbridgeError, UsageError
from drivers.marker_set import MARKERS
from training.corpus import read_corpus
from training.dataset import read_take, training_captures
from training.folds import leave_out
from training.local_models import NormalEquations, affine, ridge
from training.marker_search import (
    NOISE,
    START_WORK,
    ScoredSet,
    best_by_size,
    distinct,
    residuals,
    search,
)
from training.marker_wishes import NOT_WEARABLE, SHOULDERS, Wishes
from training.mirroring import mirrored
from training.moments import columns_of
from training.pipeline import CANDIDATES
from training.poses import body_poses
from training.recipe import RECIPES

SIX = ("LFHD", "RELB", "LUPA", "RSHN", "LTOE", "RTOE")
NINE = ("LFHD", "T10", "LWRB", "RWRB", "LFWT", "LKNE", "LANK", "RKNE", "RANK")
BUT_NINE = tuple(label for label in MARKERS if label not in (*NINE, *REFERENCES))


@pytest.fixture(scope="module")
def corpus(small_dir):
    captures = training_captures(small_dir)
    return read_corpus(small_dir, captures, RECIPES["local"], lambda *_: None, pytest.fail)


@pytest.fixture(scope="module")
def folds(small_dir):
    return leave_out(training_captures(small_dir))


@pytest.fixture(scope="module")
def starts(corpus, folds):
    """What the references leave unexplained, for both body frames."""
    return {
        references: residuals(corpus, folds, references) for references in (REFERENCES, SHOULDERS)
    }


def found_by(wishes, starts, seed=0, runs=2):
    choice = wishes.choice()
    return search(starts[choice.references], choice, seed, lambda *_: None, runs)


def rows(poses):
    return poses.reshape(len(poses), -1).astype(float)


@pytest.mark.parametrize("references", [REFERENCES, SHOULDERS])
def test_the_closed_form_is_what_every_frame_gives(small_dir, folds, starts, references):
    """A ridge map of all frames, and its error in every frame of the captures left out."""
    captures = training_captures(small_dir)
    poses = {one.name: body_poses(read_take(small_dir, one).xyz) for one in captures}
    if references == SHOULDERS:
        shoulders = [MARKERS.index(label) for label in SHOULDERS]
        poses = {
            name: own - own[:, shoulders].mean(axis=1, keepdims=True) for name, own in poses.items()
        }
    worn = tuple(label for label in (*references, *SIX) if label != "C7")
    unworn = tuple(label for label in MARKERS if label not in (*worn, *references))
    x, z = columns_of(worn), columns_of(unworn)
    errors = []
    for fold in folds:
        seen = np.concatenate([own for name, own in poses.items() if name not in fold.dropped])
        seen = rows(np.concatenate([seen, mirrored(seen)]))
        maps = ridge(NormalEquations.of(affine(seen[:, x]), seen[:, z]), NOISE)
        for capture in fold.scored:
            own = rows(poses[capture.name])
            wrong = affine(own[:, x]) @ maps.T - own[:, z]
            errors.append(1000 * math.sqrt((wrong**2).sum(axis=1).mean() / len(MARKERS)))
    assert len(errors) == 3
    start = starts[references]
    assert start.wearing(SIX).error_mm() == pytest.approx(np.mean(errors), rel=1e-5)
    assert start.wearing(SIX[:2]).errors_mm((SIX[2:],)) == pytest.approx(np.mean(errors), rel=1e-5)


def test_one_at_a_time_is_all_at_once(starts):
    start = starts[REFERENCES]
    one_by_one = start
    for label in reversed(SIX):
        one_by_one = one_by_one.wearing((label,))
    assert one_by_one.error_mm() == pytest.approx(start.wearing(SIX).error_mm(), rel=1e-9)
    known = columns_of((*REFERENCES, *SIX))
    assert np.abs(one_by_one.left_out[:, known]).max() < 1e-12


@pytest.mark.parametrize(
    ("wishes", "number"),
    [(Wishes(count=4, never=BUT_NINE), 126), (Wishes(count=4, pairs=True), 187)],
)
def test_the_search_finds_the_best_of_all(starts, wishes, number):
    """Every set there is, scored by itself."""
    choice = wishes.choice()
    sets = {
        tuple(sorted(labels, key=MARKERS.index))
        for size in range(5)
        for units in combinations(choice.units, size)
        if len(labels := [label for unit in units for label in unit]) == 4
    }
    assert len(sets) == number
    errors = {one: starts[REFERENCES].wearing(one).error_mm() for one in sets}
    best = found_by(wishes, starts, runs=4)[0]
    assert best.markers == min(errors, key=errors.__getitem__)
    assert best.error_mm == pytest.approx(errors[best.markers], rel=1e-9)


def test_all_sets_on_the_way_are_told_with_their_errors(starts):
    found = found_by(Wishes(count=3, must=("LFHD",)), starts)
    assert len({one.markers for one in found}) == len(found) > 100
    assert [one.error_mm for one in found] == sorted(one.error_mm for one in found)
    for one in found[:: len(found) // 10]:
        assert one.error_mm == pytest.approx(
            starts[REFERENCES].wearing(one.markers).error_mm(), rel=1e-9
        )


labels = st.lists(st.sampled_from(CANDIDATES), max_size=2, unique=True).map(tuple)


@settings(max_examples=25, deadline=None)
@given(
    count=st.integers(3, 5),
    must=labels,
    never=labels,
    pairs=st.booleans(),
    clothes=st.booleans(),
    alone=st.booleans(),
    seed=st.integers(0, 9),
)
def test_every_set_keeps_the_wishes(starts, count, must, never, pairs, clothes, alone, seed):
    wishes = Wishes(count, must, never, pairs, clothes, alone)
    try:
        choice = wishes.choice()
    except UsageError:
        assume(False)
    found = found_by(wishes, starts, seed)
    sizes = best_by_size(starts[choice.references], choice)
    for one in (*found, *sizes):
        worn = {*one.markers}
        assert len(worn) == len(one.markers)
        assert worn >= {*must}
        assert not worn & {*never}
        assert worn >= {*SHOULDERS} if alone else not worn & {*REFERENCES}
        if pairs:
            assert {label[1:] for label in worn if label[0] == "L"} == {
                label[1:] for label in worn if label[0] == "R"
            }
        if clothes:
            assert not any(label.endswith(tuple(NOT_WEARABLE)) for label in worn)
    assert all(len(one.markers) == count for one in found)
    assert all(len(one.markers) < count for one in sizes)


def test_a_seed_finds_the_same_again(starts):
    wishes = Wishes(count=3)
    assert found_by(wishes, starts, seed=1) == found_by(wishes, starts, seed=1)
    assert found_by(wishes, starts, seed=1) != found_by(wishes, starts, seed=2)


def test_more_markers_leave_less(starts):
    sizes = best_by_size(starts[REFERENCES], Wishes(count=5).choice())
    assert [len(one.markers) for one in sizes] == [1, 2, 3, 4]
    errors = [one.error_mm for one in sizes]
    assert errors == sorted(errors, reverse=True)


def test_progress_is_told_of_every_start(starts):
    told = []
    choice = Wishes(count=2).choice()
    search(starts[REFERENCES], choice, 0, lambda *work: told.append(work), 3)
    assert [units for _, units in told] == [START_WORK] * 3
    assert told[2][0].startswith("search 3 of 3: ")


def test_sets_that_hardly_differ_are_told_of_once():
    sets = [("A", "B", "C"), ("A", "B", "D"), ("A", "E", "F"), ("E", "F", "B"), ("C", "D", "G")]
    ranked = [ScoredSet(one, float(error)) for error, one in enumerate(sets)]
    assert distinct(ranked, 3) == [ranked[0], ranked[2], ranked[4]]
    assert distinct(ranked, 2) == [ranked[0], ranked[2]]


def test_only_captures_of_one_performer_are_nothing_to_score_on(corpus, folds):
    names = frozenset(capture.name for capture in corpus.captures)
    everything = [type(folds[0])("all", True, names, folds[0].scored)]
    with pytest.raises(MarkerbridgeError, match="nothing left to train on"):
        residuals(corpus, everything, REFERENCES)


def test_of_many_captures_some_are_scored(corpus, folds, starts, monkeypatch):
    monkeypatch.setattr("training.marker_search.MAX_SCORED", 2)
    few = residuals(corpus, folds, REFERENCES)
    assert few.fold.tolist() == [0, 1]
    assert len(few.trained) == 2
    np.testing.assert_allclose(few.left_out, starts[REFERENCES].left_out[::2])
