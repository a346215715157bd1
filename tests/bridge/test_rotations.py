"""Vectors and rotations by their properties, and against vectors turned by hand."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge import vectors
from bridge.humanoid.rotations import cross, matrices, unit
from tests.bridge.humanoid_reference import carried, lowered, quaternions
from tests.bridge.poses import product, turned

seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=30, deadline=None)


def some_quaternions(seed: int, count: int = 50) -> np.ndarray:
    return unit(np.random.default_rng(seed).normal(size=(count, 4)))


def as_axes(matrix: np.ndarray) -> vectors.Axes:
    return vectors.axes_at(np.ascontiguousarray(matrix.T))


def as_matrix(axes: vectors.Axes) -> np.ndarray:
    return np.array(axes).T


def near(found: object, expected: object) -> None:
    np.testing.assert_allclose(np.array(found), np.array(expected), atol=1e-12)


def test_a_quarter_turn_about_up_takes_right_to_forward() -> None:
    turn = np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    near(matrices(turn) @ [1, 0, 0], [0, 1, 0])
    near(matrices(turn) @ [0, 1, 0], [-1, 0, 0])
    near(vectors.quaternion(as_axes(matrices(turn))), turn)
    near(vectors.spun(tuple(turn), (1.0, 0.0, 0.0)), [0, 1, 0])


@few
@given(seeds)
def test_quaternions_and_matrices_are_the_same_rotations(seed: int) -> None:
    turns = some_quaternions(seed)
    found = matrices(turns)
    near(found @ np.swapaxes(found, 1, 2), [np.eye(3)] * 50)
    np.testing.assert_allclose(np.linalg.det(found), 1.0)
    back = np.array([vectors.quaternion(as_axes(each)) for each in found])
    assert (back[:, 3] >= 0).all()
    np.testing.assert_allclose(np.abs((back * turns).sum(axis=1)), 1.0)
    near(back, quaternions(found))


def test_half_turns_and_what_is_no_rotation_have_a_quaternion() -> None:
    for axis in np.eye(3):
        half = 2 * np.outer(axis, axis) - np.eye(3)
        near(vectors.quaternion(as_axes(half)), [*axis, 0])
    assert np.linalg.norm(vectors.quaternion(as_axes(np.zeros((3, 3))))) == 1.0


@few
@given(seeds)
def test_cross_is_numpys(seed: int) -> None:
    a, b = np.random.default_rng(seed).normal(size=(2, 4, 5, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b))
    near(vectors.cross(tuple(a[0, 0]), tuple(b[0, 0])), np.cross(a[0, 0], b[0, 0]))


@few
@given(seeds)
def test_what_is_carried_turns_by_the_shortest_way(seed: int) -> None:
    start, end, other = unit(np.random.default_rng(seed).normal(size=(3, 3)))
    near(vectors.carried(tuple(other), tuple(start), tuple(end)), carried(other, start, end))
    np.testing.assert_allclose(carried(start, start, end), end, atol=1e-9)
    axis = cross(start, end)
    np.testing.assert_allclose(carried(axis, start, end), axis, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(carried(other, start, end)), 1.0)


@few
@given(seeds)
def test_axes_turn_as_their_matrix(seed: int) -> None:
    turn, a = matrices(some_quaternions(seed, 1)[0]), np.random.default_rng(seed).normal(size=3)
    axes = as_axes(turn)
    near(vectors.turned(axes, tuple(a)), turn @ a)
    near(vectors.seen_in(axes, tuple(a)), turn.T @ a)
    near(as_matrix(vectors.lowered(axes, 0.3)), turn @ lowered(np.array([0.3]))[0])
    near(vectors.across(tuple(a), axes[0]), a - (a @ turn[:, 0]) * turn[:, 0])
    rows = np.empty((3, 3))
    vectors.put_axes(rows, axes)
    near(rows.T, turn)


@few
@given(seeds)
def test_quaternions_turn_as_hamilton_says(seed: int) -> None:
    last, first = (tuple(each) for each in some_quaternions(seed, 2))
    a = tuple(np.random.default_rng(seed).normal(size=3))
    near(vectors.spun(last, a), turned(last, a))
    near(vectors.after(last, first), product(last, first))
    near(vectors.spun(vectors.opposite(last), vectors.spun(last, a)), a)


@few
@given(seeds, st.floats(0, 1))
def test_what_is_blended_is_between_the_shorter_way_round(seed: int, share: float) -> None:
    start, end = some_quaternions(seed, 2)
    found = vectors.blended(tuple(start), tuple(end), share)
    near(found, vectors.blended(tuple(start), tuple(-end), share))
    near(np.linalg.norm(found), 1.0)
    near(vectors.blended(tuple(start), tuple(end), 0.0), start)
    assert abs(start @ found) > abs(start @ end) - 1e-9
    assert abs(end @ found) > abs(start @ end) - 1e-9
