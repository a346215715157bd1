"""Rotations by their properties, and against vectors turned by hand."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bridge.humanoid.rotations import carried, cross, matrices, quaternions, unit

seeds = st.integers(0, 2**32 - 1)


def some_quaternions(seed: int, count: int = 50) -> np.ndarray:
    return unit(np.random.default_rng(seed).normal(size=(count, 4)))


def test_a_quarter_turn_about_up_takes_right_to_forward() -> None:
    turn = np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    np.testing.assert_allclose(matrices(turn) @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(matrices(turn) @ [0, 1, 0], [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(quaternions(matrices(turn)), turn, atol=1e-12)


@given(seeds)
def test_quaternions_and_matrices_are_the_same_rotations(seed: int) -> None:
    turns = some_quaternions(seed)
    found = matrices(turns)
    np.testing.assert_allclose(found @ np.swapaxes(found, 1, 2), [np.eye(3)] * 50, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(found), 1.0)
    back = quaternions(found)
    assert (back[:, 3] >= 0).all()
    np.testing.assert_allclose(np.abs((back * turns).sum(axis=1)), 1.0)


def test_half_turns_have_a_quaternion() -> None:
    for axis in np.eye(3):
        half = 2 * np.outer(axis, axis) - np.eye(3)
        np.testing.assert_allclose(quaternions(half), [*axis, 0], atol=1e-12)


@given(seeds)
def test_cross_is_numpys(seed: int) -> None:
    a, b = np.random.default_rng(seed).normal(size=(2, 4, 5, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b))


@given(seeds)
def test_what_is_carried_turns_by_the_shortest_way(seed: int) -> None:
    start, end, other = unit(np.random.default_rng(seed).normal(size=(3, 20, 3)))
    np.testing.assert_allclose(carried(start, start, end), end, atol=1e-9)
    axis = cross(start, end)
    np.testing.assert_allclose(carried(axis, start, end), axis, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(carried(other, start, end), axis=1), 1.0)
