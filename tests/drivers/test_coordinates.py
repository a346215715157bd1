"""Golden vectors: where a person's right, front and up are in each engine's world."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.convention import Convention, parse_labels
from drivers.coordinates import FRAMES, UNITS, Frame, parse_axes, parse_frame, parse_unit
from drivers.frame import Layout
from drivers.url import Url, UrlError

# One metre to the right, to the front, and up. Sources: C3D file format guide; REP 103 (ros.org);
# OpenGL's and OpenVR's right-handed eye and tracking spaces; the manuals of Unity, Unreal and
# Polhemus (hemispheres: +X forward, +Y right, +Z lower).
GOLDEN = {
    "cmu": [(1, 0, 0), (0, 1, 0), (0, 0, 1)],
    "c3d": [(1000, 0, 0), (0, 1000, 0), (0, 0, 1000)],
    "ros": [(0, -1, 0), (1, 0, 0), (0, 0, 1)],
    "opengl": [(1, 0, 0), (0, 0, -1), (0, 1, 0)],
    "steamvr": [(1, 0, 0), (0, 0, -1), (0, 1, 0)],
    "unity": [(1, 0, 0), (0, 0, 1), (0, 1, 0)],
    "unreal": [(0, 100, 0), (100, 0, 0), (0, 0, 100)],
    "fastrak": [(0, 1 / 0.0254, 0), (1 / 0.0254, 0, 0), (0, 0, -1 / 0.0254)],
}
LEFT_HANDED = {"unity", "unreal"}


@pytest.mark.parametrize("name", FRAMES)
def test_right_front_and_up_are_where_the_engine_has_them(name: str) -> None:
    ours, theirs = np.eye(3, dtype=np.float32), np.float32(GOLDEN[name])
    np.testing.assert_allclose(FRAMES[name].from_ours(ours), theirs, rtol=1e-6)
    np.testing.assert_allclose(FRAMES[name].to_ours(theirs), ours, rtol=1e-6)
    assert FRAMES[name].left_handed == (name in LEFT_HANDED)
    turns = np.linalg.det(FRAMES[name].from_ours(ours)) > 0
    assert turns != (name in LEFT_HANDED)


# Quaternions x, y, z, w of two quarter turns: to the left, about up; and raising the left arm,
# about forward. About an axis that points the other way it is the other way round, and so it is in
# a left hand's world (Unreal's yaw grows to the right, Unity's too).
S = 0.5**0.5
TURNS = {
    "cmu": [(0, 0, S, S), (0, S, 0, S)],
    "c3d": [(0, 0, S, S), (0, S, 0, S)],
    "ros": [(0, 0, S, S), (S, 0, 0, S)],
    "opengl": [(0, S, 0, S), (0, 0, -S, S)],
    "steamvr": [(0, S, 0, S), (0, 0, -S, S)],
    "unity": [(0, -S, 0, S), (0, 0, -S, S)],
    "unreal": [(0, 0, -S, S), (-S, 0, 0, S)],
    "fastrak": [(0, 0, -S, S), (S, 0, 0, S)],
}


@pytest.mark.parametrize("name", FRAMES)
def test_turning_and_raising_an_arm_are_what_the_engine_calls_so(name: str) -> None:
    ours, theirs = np.float32(TURNS["cmu"]), np.float32(TURNS[name])
    np.testing.assert_array_equal(FRAMES[name].rotations_from_ours(ours), theirs)


axes = st.permutations(["x", "y", "z"]).flatmap(
    lambda names: st.tuples(*(st.sampled_from([name, "-" + name]) for name in names))
)


@given(axes.map(",".join), st.sampled_from(sorted(UNITS)))
def test_there_and_back_is_the_same(text: str, unit: str) -> None:
    frame = Frame(parse_axes(text), parse_unit(unit))
    xyz = np.random.default_rng(0).normal(size=(9, 3)).astype(np.float32)
    xyz[3] = np.nan
    back = frame.to_ours(frame.from_ours(xyz))
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, xyz, rtol=1e-5, atol=1e-6)


def turned(quaternions: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors turned by quaternions, in any world: the formula knows no hand."""
    axis, w = quaternions[:, :3], quaternions[:, 3:]
    once = np.cross(axis, vectors)
    return vectors + 2 * w * once + 2 * np.cross(axis, once)


@given(axes.map(",".join), st.sampled_from(sorted(UNITS)), st.integers(0, 99))
def test_turned_and_then_converted_is_converted_and_then_turned(
    text: str, unit: str, seed: int
) -> None:
    frame = Frame(parse_axes(text), parse_unit(unit))
    random = np.random.default_rng(seed)
    turns = random.normal(size=(5, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    vectors = random.normal(size=(5, 3))
    theirs = frame.rotations_from_ours(turns)
    np.testing.assert_allclose(np.linalg.norm(theirs, axis=1), 1.0)
    np.testing.assert_allclose(
        turned(theirs, frame.from_ours(vectors)), frame.from_ours(turned(turns, vectors)), rtol=1e-4
    )


def test_our_own_world_is_passed_on_untouched() -> None:
    xyz = np.ones((2, 3), np.float32)
    assert FRAMES["cmu"].to_ours(xyz) is xyz
    assert FRAMES["cmu"].from_ours(xyz) is xyz


def test_an_address_says_what_the_world_is_like() -> None:
    url = Url.parse("osc://:1?frame=unity&unit=mm&labels=Hand_L:LWRB,ann:RWRB:RWRB")
    convention = Convention.take(url)
    url.finish()
    assert convention.frame == Frame("x,z,y", 0.001)
    foreign = Layout(("Hand_L", "ann:RWRB", "C7"), 60.0)
    ours = convention.layout_in(foreign)
    assert ours == Layout(("LWRB", "RWRB", "C7"), 60.0)
    assert convention.layout_out(ours) == foreign
    only_axes = Convention.take(Url.parse("osc://:1?axes=x,z,-y"), FRAMES["c3d"])
    assert only_axes.frame == Frame("x,z,-y", 0.001)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("frame=blender", "known are cmu, c3d"),
        ("axes=x,y", "name each of x, y and z once"),
        ("axes=x,y,y", "name each of x, y and z once"),
        ("unit=km", "known are m, dm"),
        ("labels=Hand", "'Hand' maps nothing: write for example"),
        ("labels=A:C7,B:C7", "named twice"),
    ],
)
def test_what_cannot_be_meant_is_refused(options: str, words: str) -> None:
    with pytest.raises(UrlError) as caught:
        Convention.take(Url.parse(f"osc://:1?{options}"))
    assert words in str(caught.value)


def test_two_of_theirs_cannot_be_one_of_ours() -> None:
    convention = Convention(labels=parse_labels("Hand_L:LWRB"))
    with pytest.raises(ValueError, match="twice: LWRB"):
        convention.layout_in(Layout(("Hand_L", "LWRB"), 120.0))


def test_names_are_read_by_their_table() -> None:
    assert parse_frame("ros") is FRAMES["ros"]
