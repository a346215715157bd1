"""From frames to poses: what goes out where all is well, and where markers are missing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bridge.body_frame import CONSTRUCTIONS
from bridge.estimator import (
    ENOUGH,
    HOLD,
    NOISE,
    STEADY,
    PoseEstimator,
    body_frame,
    influence,
)
from bridge.imputer import RETURN
from bridge.model import Model, ModelInfo
from bridge.pose import Pose, Provenance
from bridge.regression import features_of, regression_of
from drivers.c3d_file import read_c3d
from drivers.frame import Floats, Layout, MarkerFrame
from drivers.marker_set import MARKERS
from simulators.performer import Walker

RATE = 120.0
MM = 1000.0


@pytest.fixture(scope="module", params=["default", "network"])
def model(request) -> Model:
    """The model that ships, and a small network that was trained on little."""
    return (
        Model("default") if request.param == "default" else request.getfixturevalue("network_model")
    )


@pytest.fixture(scope="module")
def whole_walk(data_dir) -> Floats:
    """Somebody walks for 2.8 s, (343, 41, 3); nothing is missing."""
    xyz = read_c3d(data_dir / "real/02_01.c3d", MARKERS).xyz
    assert not np.isnan(xyz).any()
    return xyz


@pytest.fixture
def walk(model, whole_walk) -> Floats:
    return whole_walk[:, [MARKERS.index(label) for label in model.info.tracked]]


def steps(
    model: Model, xyz: Floats, rate: float = RATE, layout: Layout | None = None
) -> list[Pose]:
    layout = layout or Layout(model.info.tracked, rate)
    estimator = PoseEstimator(model)
    return [
        estimator.step(MarkerFrame(i, i / rate, i / rate, layout, frame))
        for i, frame in enumerate(xyz)
    ]


def positions(poses: list[Pose]) -> np.ndarray:
    return np.array([pose.xyz for pose in poses], float)


def rows(model: Model) -> list[int]:
    """Where the tracked markers are in a pose."""
    return [model.info.labels.index(label) for label in model.info.tracked]


def step_lengths(xyz: np.ndarray) -> np.ndarray:
    """(N - 1, M): how far each marker goes from frame to frame, mm."""
    return MM * np.linalg.norm(np.diff(xyz, axis=0), axis=2)


def hidden(xyz: Floats, markers: list[int], start: int, end: int) -> Floats:
    holed = xyz.copy()
    holed[start:end, markers] = np.nan
    return holed


def test_measured_markers_go_out_where_they_are(model, walk) -> None:
    poses = steps(model, walk)
    at = rows(model)
    for pose in poses:
        assert (pose.provenance[at] == Provenance.MEASURED).all()
        assert (np.delete(pose.provenance, at) == Provenance.ESTIMATED).all()
        assert pose.xyz.dtype == pose.sigma.dtype == np.float32
        assert np.isfinite(pose.sigma).all()
        assert (pose.sigma > 0).all()
    away = MM * np.linalg.norm(positions(poses)[:, at] - walk, axis=2)
    assert away.mean() < 1.0
    assert np.percentile(away, 95) < 2.0  # the capture's own noise


def test_a_walker_without_noise_goes_out_unchanged(model) -> None:
    walker = Walker(RATE)
    at = [MARKERS.index(label) for label in model.info.tracked]
    xyz = np.array([walker.pose(index)[at] for index in range(240)])
    away = MM * np.linalg.norm(positions(steps(model, xyz))[:, rows(model)] - xyz, axis=2)
    assert away[12:].max() < 0.5  # before that, what noise there is cannot be known
    assert away.max() < 5.0


def test_noise_is_taken_out(model, walk) -> None:
    noise = np.random.default_rng(2).normal(0, 0.002, walk.shape).astype(np.float32)
    clean, noisy = (positions(steps(model, xyz)) for xyz in (walk, walk + noise))
    at = rows(model)

    def third(xyz: np.ndarray) -> float:
        return float(np.linalg.norm(np.diff(xyz[60:], n=3, axis=0), axis=2).mean())

    assert third(noisy[:, at]) < 0.2 * third((walk + noise).astype(float))
    error = noisy[60:, at] - walk[60:]
    assert MM * np.sqrt((error**2).mean()) < 7.0  # feet that swing are held back
    assert third(noisy) < 3.0 * third(clean)


def test_markers_are_found_by_label_and_others_are_ignored(model, walk, whole_walk) -> None:
    order = np.random.default_rng(1).permutation(41)
    shuffled = Layout(tuple(MARKERS[i] for i in order), RATE)
    others = steps(model, whole_walk[:, order], layout=shuffled)
    np.testing.assert_array_equal(positions(steps(model, walk)), positions(others))


def test_a_missing_marker_is_imputed_and_says_so_with_a_larger_sigma(model, walk) -> None:
    tracked = model.info.tracked
    for label in tracked:
        poses, whole = (
            steps(model, hidden(walk, [tracked.index(label)], 60, 180)),
            steps(model, walk),
        )
        row = model.info.labels.index(label)
        seen = [pose.provenance[row] for pose in poses]
        back = 180 + round(RETURN * RATE) + 2
        assert set(seen[:60]) == set(seen[back:]) == {Provenance.MEASURED}
        assert set(seen[60:180]) == {Provenance.IMPUTED}
        # A network reads sigma off what it is shown, which is not quite the same.
        assert (poses[170].sigma >= 0.8 * whole[170].sigma).all()
        assert poses[170].sigma[row] > 5 * whole[170].sigma[row]
        assert poses[170].sigma[row] > poses[66].sigma[row]
        np.testing.assert_array_equal(positions(poses[:60]), positions(whole[:60]))
        away = np.linalg.norm(positions(poses) - positions(whole), axis=2)
        # Back, its way is as unsure as it is long; then all others come to where they should be.
        for index in range(180, back):
            assert poses[index].sigma[row] > 0.99 * away[index, row]
        assert MM * away[back + round(3 * STEADY * RATE) :].max() < 5.0


def test_with_any_markers_missing_from_the_first_frame_it_is_a_body(
    model, walk, whole_walk
) -> None:
    tracked = model.info.tracked
    references = [tracked.index(label) for label in model.info.references]
    for missing in (*([row] for row in range(len(tracked))), references, [0, 3, *references[:1]]):
        poses = steps(model, hidden(walk, missing, 0, len(walk)))
        error = MM * np.sqrt(((positions(poses) - whole_walk) ** 2).sum(axis=2).mean(axis=1))
        assert error.mean() < 300  # a body, at the right place
        at = rows(model)
        for pose in poses:
            assert (pose.provenance[[at[row] for row in missing]] == Provenance.IMPUTED).all()
        assert (poses[-1].sigma[[at[row] for row in missing]] > 0.005).all()


def test_nothing_jumps_when_a_marker_goes_or_comes_back(model, walk) -> None:
    """Against the same frames with nothing missing, any marker of the body."""
    whole = positions(steps(model, walk))
    markers = len(model.info.tracked)
    for missing in (*([row] for row in range(markers)), [0, 1], [2, markers - 1], [0, 4, 5]):
        pose = positions(steps(model, hidden(walk, missing, 60, 200)))
        assert step_lengths(pose - whole)[50:260].max() < 30


def test_markers_that_flicker_do_not_make_one_drift_that_is_missing(model, walk) -> None:
    """What is walked off as others come and go must not sum up."""
    random = np.random.default_rng(5)
    still = np.repeat(walk[100:101], 840, axis=0)
    for marker in (1, 4):
        missing = hidden(still, [marker], 1, len(still))
        flickering = missing.copy()
        flickering[1:800][random.random((799, still.shape[1])) < 0.05] = np.nan
        row = rows(model)[marker]
        calm, restless = (positions(steps(model, xyz))[:, row] for xyz in (missing, flickering))
        away = MM * np.linalg.norm(restless - calm, axis=1)
        assert away[:400].mean() < 12
        assert away[400:800].mean() < 12
        assert away.max() < 120  # as much as the others tell
        assert away[830:].max() < 1


def test_dropped_samples_cost_next_to_nothing(model, walk) -> None:
    random = np.random.default_rng(6)
    dropped = walk.copy()
    dropped[1:][random.random((len(walk) - 1, walk.shape[1])) < 0.05] = np.nan
    whole, pose = (positions(steps(model, xyz)) for xyz in (walk, dropped))
    away = MM * np.linalg.norm(pose - whole, axis=2)[20:]
    assert away.mean() < 5
    assert step_lengths(pose - whole)[20:].mean() < 1.0


@pytest.mark.parametrize("left", [0, 1, 2])
def test_with_too_few_markers_the_pose_eases_to_a_hold_and_is_lost(model, walk, left) -> None:
    holed = hidden(np.concatenate([walk, walk]), list(range(left, walk.shape[1])), 60, 260)
    poses = steps(model, holed[:343])
    xyz = positions(poses)
    assert np.isfinite(xyz).all()
    unworn = np.delete(np.arange(41), rows(model)[:left])
    step = step_lengths(xyz)[:, unworn]
    before = step[50:59].max()
    assert step[59:70].max() < 1.5 * before  # it does not stop dead, nor jump
    assert step[150:259].max() < 0.1
    lost = 60 + round(HOLD * RATE)
    for pose in poses[60 : lost - 1]:
        assert Provenance.LOST not in pose.provenance
        assert np.isfinite(pose.sigma).all()
    assert (np.diff([pose.sigma[unworn] for pose in poses[59 : lost - 1]], axis=0) > 0).all()
    for pose in poses[lost + 1 : 260]:
        assert (pose.provenance[unworn] == Provenance.LOST).all()
        assert np.isinf(pose.sigma[unworn]).all()
    # Back: as far as the body went meanwhile, in RETURN.
    whole = positions(steps(model, walk))
    far = MM * np.linalg.norm(whole[260] - xyz[259], axis=1).max()
    assert step_lengths(xyz)[259:290].max() < 2 * far / (RETURN * RATE) + 1.5 * before
    assert (poses[300].provenance[rows(model)] == Provenance.MEASURED).all()
    away = MM * np.linalg.norm(xyz - whole, axis=2)
    assert away[300, rows(model)].max() < 2
    # Then all others come to where they should be.
    assert away[300].max() < max(10, far * np.exp(-(300 / RATE - 260 / RATE - RETURN) / STEADY))
    assert away[330].max() < 10


def test_a_marker_that_is_still_missing_after_a_hold_was_seen_before_it(
    model, walk, whole_walk
) -> None:
    at = rows(model)
    for marker in (0, 1, 3):
        alone = hidden(walk, [marker], 60, 140)
        held = hidden(alone, list(range(walk.shape[1])), 60, 90)
        errors = [
            MM
            * np.linalg.norm(positions(steps(model, xyz))[:, at[marker]] - walk[:, marker], axis=1)
            for xyz in (alone, held)
        ]
        np.testing.assert_allclose(errors[1][116:140], errors[0][116:140], atol=2)


def test_markers_that_come_back_one_by_one_do_not_jump(model, walk) -> None:
    holed = hidden(walk, list(range(walk.shape[1])), 60, 90)
    for marker in range(walk.shape[1]):
        holed[90 : 90 + 5 * marker, marker] = np.nan
    pose = positions(steps(model, holed))
    assert step_lengths(pose).max() < 150
    assert np.isfinite(pose).all()


def test_before_enough_markers_there_is_no_pose(model, walk) -> None:
    few = hidden(walk[:5], list(range(ENOUGH - 1, walk.shape[1])), 0, 5)
    for pose in (*steps(model, hidden(few, [0, 1], 0, 5)), *steps(model, few)):
        unworn = np.delete(np.arange(41), rows(model)[: ENOUGH - 1])
        assert np.isnan(pose.xyz[unworn]).all()
        assert (pose.provenance[unworn] == Provenance.LOST).all()
        assert np.isinf(pose.sigma[unworn]).all()


@st.composite
def patterns(draw) -> np.ndarray:
    """(343, 9), what is missing: a few spells of each marker, and of all."""
    missing = np.zeros((343, 9), bool)
    spells = st.tuples(st.integers(0, 342), st.integers(1, 150), st.integers(0, 9))
    for start, length, marker in draw(st.lists(spells, max_size=25)):
        which = slice(None) if marker == 9 else marker
        missing[start : start + length, which] = True
    return missing


@given(missing=patterns())
@settings(
    max_examples=15,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_whatever_is_missing_it_stays_a_body(model, walk, missing) -> None:
    holed = walk.copy()
    holed[missing[:, : walk.shape[1]]] = np.nan
    there = ~np.isnan(holed[..., 0])
    settled = 0  # frames since there were too few
    begun = False
    for pose, markers, present in zip(steps(model, holed), holed, there, strict=True):
        enough = present.sum() >= ENOUGH
        begun = begun or enough
        settled = settled + 1 if enough else 0
        if not begun:
            continue
        assert np.isfinite(pose.xyz).all()
        assert (pose.sigma > 0).all()
        if settled > RETURN * RATE + 1:
            middle = markers[present].mean(axis=0)
            assert np.linalg.norm(pose.xyz - middle, axis=1).max() < 3.0


def at_rate(walk: Floats, rate: float) -> Floats:
    """The same motion, sampled at another rate."""
    times, wanted = np.arange(len(walk)) / RATE, np.arange(0, (len(walk) - 1) / RATE, 1 / rate)
    flat = walk.reshape(len(walk), -1)
    columns = [np.interp(wanted, times, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(-1, *walk.shape[1:]).astype(np.float32)


@pytest.mark.parametrize("rate", [60.0, 240.0])
def test_time_is_time_at_any_rate(model, walk, rate) -> None:
    """A marker goes, comes back, and then all go: at the same moments, to the same places."""

    def told(hertz: float) -> tuple[np.ndarray, np.ndarray]:
        xyz = at_rate(walk, hertz)
        gone, back, end = (round(second * hertz) for second in (0.5, 1.0, 1.5))
        holed = hidden(hidden(xyz, [1], gone, back), list(range(xyz.shape[1])), end, len(xyz))
        poses = steps(model, holed, hertz)
        lost = [(pose.provenance == Provenance.LOST).all() for pose in poses]
        every = round(hertz / 60)
        return positions(poses)[::every][:165], np.array(lost)[::every][:165]

    (one, lost), (other, lost_too) = told(RATE), told(rate)
    away = MM * np.linalg.norm(one - other, axis=2)[10:90]
    assert away.mean() < 15
    assert lost.any()
    assert abs(lost.argmax() - lost_too.argmax()) <= 2


def test_another_layout_in_mid_stream_changes_nothing(model, walk) -> None:
    tracked = model.info.tracked
    estimator = PoseEstimator(model)
    layouts = [Layout(tracked, RATE), Layout(tracked[::-1], RATE), Layout(tracked[1:], RATE)]
    found = []
    for index, xyz in enumerate(walk[:150]):
        which = index // 50
        layout, sent = layouts[which], (xyz, xyz[::-1], xyz[1:])[which]
        found.append(estimator.step(MarkerFrame(index, 0.0, 0.0, layout, sent)))
    expected = steps(model, hidden(walk[:150], [0], 100, 150))
    np.testing.assert_array_equal(positions(found), positions(expected))
    assert found[-1].provenance[rows(model)[0]] == Provenance.IMPUTED


def test_standing_elsewhere_and_facing_elsewhere_changes_nothing(model, walk) -> None:
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float32)
    shift = np.array([4, -3, 0.5], np.float32)
    holed = hidden(hidden(walk, [1, 6], 60, 120), [0, 8], 100, 200)
    here, there = (positions(steps(model, xyz)) for xyz in (holed, holed @ turn.T + shift))
    np.testing.assert_allclose(here @ turn.T + shift, there, atol=1e-3)


def test_those_who_wear_no_c7_are_whole_bodies_too(six_model, whole_walk) -> None:
    assert "C7" not in six_model.info.tracked
    at = rows(six_model)
    walk = whole_walk[:, at]
    whole = positions(steps(six_model, walk))
    error = MM * np.linalg.norm(whole - whole_walk, axis=2)
    assert error[:, at].mean() < 1
    assert error.mean() < 60
    for missing in range(len(at)):
        holed = positions(steps(six_model, hidden(walk, [missing], 60, 200)))
        assert step_lengths(holed - whole)[50:260].max() < 30
        error = MM * np.linalg.norm(holed - whole_walk, axis=2)
        assert error[60:72, at[missing]].max() < 60  # it went on as it went
        assert error[:, at[missing]].max() < 400
        assert error.mean() < 80


def test_reset_forgets_the_performer(model, walk) -> None:
    estimator = PoseEstimator(model)
    layout = Layout(model.info.tracked, RATE)
    holed = hidden(walk, [0, 5], 20, 45)
    frames = [MarkerFrame(i, 0.0, 0.0, layout, xyz) for i, xyz in enumerate(holed[:50])]
    first = [estimator.step(frame).xyz for frame in frames]
    estimator.reset()
    for one, two in zip(first, [estimator.step(frame).xyz for frame in frames], strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("index", [1000, 0], ids=["a long gap", "a device that starts anew"])
def test_after_a_long_absence_all_begins_anew(model, walk, index: int) -> None:
    half = len(walk) // 2
    estimator, fresh = PoseEstimator(model), PoseEstimator(model)
    layout = Layout(model.info.tracked, 120.0)
    for at, xyz in enumerate(walk[:half]):
        estimator.step(MarkerFrame(at, at / 120, at / 120, layout, xyz))
    for at, xyz in enumerate(walk[half : half + 20], index):
        frame = MarkerFrame(at, at / 120, at / 120, layout, xyz + np.float32([5, 0, 0]))
        np.testing.assert_array_equal(estimator.step(frame).xyz, fresh.step(frame).xyz)


def test_frames_that_are_lost_on_the_way_take_their_time(network_model, whole_walk) -> None:
    """Every other frame of a stream is one of half the rate: noise, speeds and blends are in
    seconds.
    """
    info = network_model.info
    xyz = whole_walk[::2, [MARKERS.index(label) for label in info.tracked]].copy()
    xyz[40:60, 0] = np.nan
    slow = steps(network_model, xyz, 60.0)
    estimator, layout = PoseEstimator(network_model), Layout(info.tracked, 120.0)
    for i, frame in enumerate(xyz):
        pose = estimator.step(MarkerFrame(2 * i, i / 60, i / 60, layout, frame))
        if i:  # the first has no frame before it
            np.testing.assert_allclose(pose.xyz, slow[i].xyz, atol=2e-3)
            np.testing.assert_array_equal(pose.provenance, slow[i].provenance)


def test_a_stream_without_markers_has_no_pose(model) -> None:
    layout = Layout((), RATE)
    pose = PoseEstimator(model).step(MarkerFrame(0, 0.0, 0.0, layout, np.zeros((0, 3), np.float32)))
    assert (pose.provenance == Provenance.LOST).all()


class Telling:
    """A regression that knows where a body is and how it moves, but for how far off it says that
    all is: (N, 3), metres, in the world.
    """

    def __init__(self, model: Model, truth: Floats, off: np.ndarray) -> None:
        self._rows, self._truth, self._off = rows(model), truth.astype(float), off
        self._body = body_frame(model.info)
        self.heard: list[Floats] = []

    def reset(self, rate: float) -> None: ...

    def estimate(self, tracked: Floats, velocity: Floats) -> tuple[Floats, Floats, Floats]:
        self.heard.append(velocity.copy())
        index, body = len(self.heard) - 1, self._body
        body.update(self._truth[index, self._rows])
        moved = self._truth[index] - self._truth[max(index - 1, 0)]
        moving = (moved - moved[self._rows][body.origins].mean(axis=0)) @ body.rotation * RATE
        pose = body.to_body(self._truth[index] + self._off[index])
        return pose, np.full(41, 0.01, np.float32), moving.astype(np.float32)


@pytest.fixture
def spinning(model) -> Floats:
    """A walker whose way turns, (240, 41, 3)."""
    walker = Walker(RATE)
    turns = np.linspace(0, 4, 240)
    cos, sin, no, one = np.cos(turns), np.sin(turns), np.zeros(240), np.ones(240)
    axes = np.array([[cos, -sin, no], [sin, cos, no], [no, no, one]]).transpose(2, 0, 1)
    xyz = np.array([walker.pose(index) for index in range(240)])
    return np.einsum("nij,nmj->nmi", axes, xyz).astype(np.float32)


def test_a_pose_goes_on_as_it_moves_and_comes_to_where_it_is_said_to_be(model, spinning) -> None:
    """What a model says of a pose may leap; what it says of its motion is followed at once."""
    off = np.zeros((240, 3))
    off[120:] = [0.1, 0, 0]
    estimator, layout = PoseEstimator(model), Layout(model.info.tracked, RATE)
    estimator.regression = Telling(model, spinning, off)
    at = rows(model)
    unworn = np.delete(np.arange(41), at)
    xyz = positions(
        [
            estimator.step(MarkerFrame(i, i / RATE, i / RATE, layout, frame))
            for i, frame in enumerate(spinning[:, at])
        ]
    )
    away = (xyz - spinning)[:, unworn]
    assert MM * abs(away[20:120]).max() < 2
    kept = np.exp(-np.arange(1, 121) / RATE / STEADY)[:, None, None]
    np.testing.assert_allclose(
        away[120:], np.broadcast_to(off[120:, None] * (1 - kept), away[120:].shape), atol=3e-3
    )
    # The velocities told are those of the markers given out, against the origin's.
    body = body_frame(model.info)
    for index in (60, 121, 200):
        body.place(xyz[index, at])
        moved = xyz[index, at] - xyz[index - 1, at]
        expected = (moved - moved[body.origins].mean(axis=0)) @ body.rotation * RATE
        np.testing.assert_allclose(estimator.regression.heard[index], expected, atol=2e-4)
    assert not estimator.regression.heard[0].any()


def test_a_mixtures_pose_is_what_it_says_at_once(mixture_model, whole_walk) -> None:
    info, at = mixture_model.info, rows(mixture_model)
    regression, body = regression_of(mixture_model, info.history), body_frame(info)
    regression.reset(RATE)
    for pose in steps(mixture_model, whole_walk[:60, at]):
        tracked = pose.xyz[at]
        body.place(tracked)
        said, _, _ = regression.estimate(body.to_body(tracked), np.zeros_like(tracked))
        np.testing.assert_allclose(
            np.delete(pose.xyz, at, 0), np.delete(body.to_world(said), at, 0), atol=1e-5
        )


@pytest.mark.parametrize("name", CONSTRUCTIONS)
def test_influence_is_how_far_an_error_of_a_marker_moves_the_others(name) -> None:
    """By differences, of a linear model in a body frame that does not turn."""
    random = np.random.default_rng(3)
    construction = CONSTRUCTIONS[name]
    principal = ("LFHD", "RELB", "RTOE")
    count = len(construction.features(principal + construction.references))
    others = 41 - len(principal + construction.references)
    info = ModelInfo(
        estimator="best",
        labels=MARKERS,
        principal=principal,
        references=construction.references,
        history=0,
        mean=random.normal(size=(count, 3)).tolist(),
        covariance=np.eye(3 * count).tolist(),
        sigma=[0.01] * others,
        sensitivity=random.normal(size=(3 * others, 3 * count)).tolist(),
        body_frame=name,
    )
    frame, maps = body_frame(info), np.array(info.sensitivity)

    def estimate(world: np.ndarray) -> np.ndarray:
        origin = world[frame.origins].mean(axis=0)
        return (maps @ (world - origin)[features_of(info)].ravel()).reshape(-1, 3) + origin

    world = random.normal(size=(len(info.tracked), 3))
    step = 1e-3
    expected = np.zeros((41, len(info.tracked)))
    unworn = [MARKERS.index(label) for label in info.unworn]
    for marker in range(len(info.tracked)):
        for axis in range(3):
            shift = np.zeros_like(world)
            shift[marker, axis] = step
            slope = (estimate(world + shift) - estimate(world - shift)) / (2 * step)
            expected[unworn, marker] += (slope**2).mean(axis=1)
    np.testing.assert_allclose(influence(info), expected, rtol=1e-6)


def test_what_is_not_known_of_missing_markers_is_not_known_of_those_they_tell(
    mixture_model, whole_walk
) -> None:
    info, at = mixture_model.info, rows(mixture_model)
    unworn = np.delete(np.arange(41), at)
    own = np.zeros(41)
    own[unworn] = np.square(info.sigma)
    holed = hidden(whole_walk[:120, at], [0, 5, 7], 60, 90)
    before = 0.0
    for index, pose in enumerate(steps(mixture_model, holed)):
        of_tracked = pose.sigma[at].astype(float) ** 2 - NOISE**2
        expected = own + influence(info) @ of_tracked
        np.testing.assert_allclose(pose.sigma[unworn] ** 2, expected[unworn], rtol=1e-4)
        if 62 < index < 90:
            assert (pose.sigma[[at[row] for row in (0, 5, 7)]] > NOISE).all()
            assert pose.sigma[unworn].mean() > before
            before = pose.sigma[unworn].mean()
    # Back again: as sure as ever.
    np.testing.assert_allclose(pose.sigma[unworn], info.sigma, rtol=1e-4)
