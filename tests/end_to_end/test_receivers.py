"""What receivers of another make understand of what we send: an OSC library in JavaScript, and an
avatar in a browser that the VMC protocol moves (tests/receivers).
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.humanoid.rotations import matrices
from bridge.humanoid.skeleton import BONES, PARENTS, Posture
from bridge.humanoid.solver import HumanoidSolver
from bridge.model import Model
from bridge.pose import Pose, Provenance
from bridge.session import Session
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import Sink, SinkContext
from drivers.c3d_file import C3dSource, Clip, read_c3d
from drivers.clock import VirtualClock
from drivers.frame import Layout
from tests.receivers import programs
from tests.receivers.programs import Avatar, Decoder, Drawn, Message

MODEL = Model("default")
LABELS = MODEL.info.labels
CONTEXT = SinkContext(MODEL.info, lambda index: None, 100.0)
S = float(np.float32(np.sqrt(0.5)))


@pytest.fixture(scope="module")
def decoder() -> Iterator[Decoder]:
    with programs.decoding() as decoder:
        yield decoder


def packets(decoder: Decoder, address: str, *poses: Pose) -> list[list[Message]]:
    """What osc.js makes of what a sink sends."""
    sink = open_sink(address.format(decoder.port), CONTEXT)
    for pose in poses:
        sink(pose)
    sink.close()
    return decoder.packets()


# Somebody in a T, in their own axes: x right, y forward, z up.
STANDING = {
    "Hips": (0, 0, 0.875),
    "Spine": (0, -0.0625, 1),
    "Chest": (0, -0.0625, 1.125),
    "Neck": (0, -0.0625, 1.375),
    "Head": (0, 0, 1.5),
    "LeftShoulder": (-0.0625, 0, 1.3125),
    "LeftUpperArm": (-0.1875, 0, 1.375),
    "LeftLowerArm": (-0.4375, 0, 1.375),
    "LeftHand": (-0.6875, 0, 1.375),
    "RightShoulder": (0.0625, 0, 1.3125),
    "RightUpperArm": (0.1875, 0, 1.375),
    "RightLowerArm": (0.4375, 0, 1.375),
    "RightHand": (0.6875, 0, 1.375),
    "LeftUpperLeg": (-0.125, 0, 0.875),
    "LeftLowerLeg": (-0.125, 0, 0.5),
    "LeftFoot": (-0.125, 0, 0.0625),
    "RightUpperLeg": (0.125, 0, 0.875),
    "RightLowerLeg": (0.125, 0, 0.5),
    "RightFoot": (0.125, 0, 0.0625),
}
RAISED = {"LeftLowerArm": (-0.1875, 0, 1.625), "LeftHand": (-0.1875, 0, 1.875)}
ARM = ("LeftUpperArm", "LeftLowerArm", "LeftHand")


def greeting() -> Pose:
    """They stand at (1, 2), look along -x, and raise the left arm; markers anywhere."""
    random = np.random.default_rng(0)
    rest = np.float32([STANDING[bone] for bone in BONES])
    rest[1:] -= rest[PARENTS[1:]]
    joints = [(1 - y, 2 + x, z) for x, y, z in (STANDING | RAISED).values()]
    left, up = (0, 0, S, S), (0, S, 0, S)  # a quarter turn to the left, and about what is forward
    local = [{"Hips": left, "LeftUpperArm": up}.get(bone, (0, 0, 0, 1)) for bone in BONES]
    turns = [(-0.5, 0.5, 0.5, 0.5) if bone in ARM else left for bone in BONES]  # `up`, then `left`
    sigma = np.full(len(BONES), 0.01, np.float32)
    return Pose(
        7,
        50.0,
        random.normal(size=(len(LABELS), 3)).astype(np.float32),
        random.integers(0, 3, len(LABELS)).astype(np.uint8),
        random.uniform(0.001, 0.02, len(LABELS)).astype(np.float32),
        Posture(np.float32(joints), np.float32(turns), np.float32(local), sigma, rest),
    )


def close(found: list[Message], expected: list[Message]) -> None:
    """The same addresses and types; floats as near as float32 and its rounding allow."""
    assert [message[:2] for message in found] == [message[:2] for message in expected]
    for (address, _, values), (*_, others) in zip(found, expected, strict=True):
        words = [value for value in values if isinstance(value, str)]
        assert words == [value for value in others if isinstance(value, str)]
        numbers = [value for value in values if not isinstance(value, str)]
        wanted = [value for value in others if not isinstance(value, str)]
        assert numbers == pytest.approx(wanted, abs=2e-7), address


def test_vmc_is_understood(decoder: Decoder) -> None:
    pose = greeting()
    first, second = packets(
        decoder, "vmc://127.0.0.1:{}?send=both", pose, replace(pose, index=8, t=50.25)
    )
    turned = {"Hips": [0, -S, 0, S], "LeftUpperArm": [0, 0, -S, S]}
    bones: list[Message] = []
    for bone, parent in zip(BONES, PARENTS, strict=True):
        x, y, z = np.subtract(STANDING[bone], STANDING[BONES[parent]] if bone != "Hips" else 0)
        place = [1, 0.875, 2] if bone == "Hips" else [x, z, y]
        turn = turned.get(bone, [0, 0, 0, 1])
        bones.append(("/VMC/Ext/Bone/Pos", "sfffffff", [bone, *place, *turn]))
    head = [
        ("/VMC/Ext/OK", "i", [1]),
        ("/VMC/Ext/T", "f", [0]),
        ("/VMC/Ext/Root/Pos", "sfffffff", ["root", 0, 0, 0, 0, 0, 0, 1]),
    ]
    close(first[:22], [*head, *bones])
    trackers = first[22:]
    assert {message[:2] for message in trackers} == {("/VMC/Ext/Tra/Pos", "sfffffff")}
    assert [values[0] for *_, values in trackers] == list(LABELS)
    values = {label: row for *_, (label, *row) in trackers}
    assert [row[:3] for row in values.values()] == pose.xyz[:, [0, 2, 1]].tolist()
    for label in ("LFHD", "C7", "RBWT", "RTOE"):
        assert values[label][3:] == pytest.approx([0, -S, 0, S], abs=2e-7)
    for label in ("LELB", "LFIN"):  # on the raised arm
        assert values[label][3:] == pytest.approx([0.5, -0.5, -0.5, 0.5], abs=2e-7)
    close(second[:2], [("/VMC/Ext/OK", "i", [1]), ("/VMC/Ext/T", "f", [0.25])])
    assert second[2:] == first[2:]


def test_vmc_before_there_is_a_pose_is_understood(decoder: Decoder) -> None:
    nothing = np.full((len(LABELS), 3), np.nan, np.float32)
    lost = np.full(len(LABELS), Provenance.LOST, np.uint8)
    pose = Pose(0, 50.0, nothing, lost, np.full(len(LABELS), np.inf, np.float32))
    (packet,) = packets(decoder, "vmc://127.0.0.1:{}", pose)
    assert packet == [("/VMC/Ext/OK", "i", [0]), ("/VMC/Ext/T", "f", [0])]


def test_vrchat_is_understood(decoder: Decoder) -> None:
    (packet,) = packets(decoder, "vrchat://127.0.0.1:{}", greeting())
    # A tracker: where it is in Unity's space, and its degrees about x, y and z.
    trackers = {
        "1": ([1, 0.875, 2], [0, -90, 0]),  # hips
        "2": ([1, 0.0625, 1.875], [0, -90, 0]),  # left and right foot
        "3": ([1, 0.0625, 2.125], [0, -90, 0]),
        "4": ([1, 0.5, 1.875], [0, -90, 0]),  # left and right knee
        "5": ([1, 0.5, 2.125], [0, -90, 0]),
        "6": ([1.0625, 1.125, 2], [0, -90, 0]),  # chest
        "7": ([1, 1.625, 1.8125], [0, -90, -90]),  # left and right elbow
        "8": ([1, 1.375, 2.4375], [0, -90, 0]),
        "head": ([1, 1.5, 2], [0, -90, 0]),
    }
    expected: list[Message] = []
    for name, (place, angles) in trackers.items():
        expected.append((f"/tracking/trackers/{name}/position", "fff", place))
        expected.append((f"/tracking/trackers/{name}/rotation", "fff", angles))
    assert [message[:2] for message in packet] == [message[:2] for message in expected]
    for (address, _, values), (*_, wanted) in zip(packet, expected, strict=True):
        within = 1e-3 if address.endswith("rotation") else 2e-7
        assert values == pytest.approx(wanted, abs=within), address


def test_vmt_is_understood(decoder: Decoder) -> None:
    on, off = packets(decoder, "vmt://127.0.0.1:{}", greeting())
    for packet, enable in ((on, 1), (off, 0)):
        assert {message[:2] for message in packet} == {("/VMT/Room/Unity", "iiffffffff")}
        assert [values[:3] for *_, values in packet] == [[i, enable, 0] for i in range(len(packet))]
    at = {index: values for *_, (index, _, _, *values) in on}
    assert at[0] == pytest.approx([1, 1.5, 2, 0, -S, 0, S], abs=2e-7)  # head
    assert at[1] == pytest.approx([1, 0.875, 2, 0, -S, 0, S], abs=2e-7)  # hips
    assert at[7] == pytest.approx([1, 1.625, 1.8125, 0.5, -0.5, -0.5, 0.5], abs=2e-7)
    assert at[9] == pytest.approx([1, 1.875, 1.8125, 0.5, -0.5, -0.5, 0.5], abs=2e-7)  # hand


def test_qtm_is_understood(decoder: Decoder) -> None:
    pose = greeting()
    xyz = pose.xyz.copy()
    xyz[3] = np.nan
    _, packet = packets(
        decoder, "qtm-osc://127.0.0.1:{}", pose, replace(pose, index=9, t=50.5, xyz=xyz)
    )
    address, types, values = packet[0]
    assert (address, types) == ("/qtm/data", "iiiiiii")
    assert values[:2] == [0, 500_000]  # microseconds
    assert values[3] == 9
    assert [message[:2] for message in packet[1:]] == [(f"/qtm/3d/{m}", "fff") for m in LABELS]
    found = np.array([[float(value) for value in row] for *_, row in packet[1:]])
    assert np.isnan(found[3]).all()
    np.testing.assert_allclose(found, np.float64(xyz) * 1000, rtol=1e-6)


def test_our_own_is_understood(decoder: Decoder) -> None:
    pose, count = greeting(), len(LABELS)
    (layout,), (message,) = packets(decoder, "osc://127.0.0.1:{}", pose)
    assert layout == ("/markerbridge/layout", "d" + "s" * count, [100, *LABELS])
    address, types, (index, seconds, provenance, *floats) = message
    assert (address, types) == ("/markerbridge/pose", "ids" + "f" * (4 * count))
    assert (index, seconds) == (7, 0)
    assert provenance == "".join("MIEL"[kind] for kind in pose.provenance)
    assert floats == [*pose.xyz.ravel().tolist(), *pose.sigma.tolist()]


@pytest.fixture(scope="module")
def avatar() -> Iterator[Avatar]:
    with programs.avatar() as avatar:
        yield avatar


@pytest.fixture
def sink(avatar: Avatar) -> Iterator[Sink]:
    """It moves the avatar, with hips as high as in the avatar's own rest pose."""
    hips = avatar.drawn(0).rest["hips"][1]
    sink = open_sink(f"vmc://127.0.0.1:{avatar.port}?hips={hips}m", CONTEXT)
    yield sink
    sink.close()


# Ours to three's: x left, y up, z forward.
TO_THREE = np.array([[-1, 0, 0], [0, 0, 1], [0, 1, 0]], float)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Degrees."""
    cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def vrm(bone: str) -> str:
    return bone[0].lower() + bone[1:]


def check(drawn: Drawn, posture: Posture) -> None:
    """The avatar stands as the humanoid does.

    Each of its bones is turned from where it points in its own T as ours is from ours. So spine and
    limbs point where ours do, but for what the two T differ by (five degrees in the shanks).
    """
    scale = drawn.rest["hips"][1] / posture.rest[0, 2]
    hips = TO_THREE @ posture.joints[0] * scale
    np.testing.assert_allclose(drawn.joints["hips"], hips, atol=1e-3)
    turns = TO_THREE @ matrices(posture.rotations.astype(float)) @ TO_THREE.T
    for row, parent in list(enumerate(PARENTS))[1:]:
        start, end = vrm(BONES[parent]), vrm(BONES[row])
        way, rest = (places[end] - places[start] for places in (drawn.joints, drawn.rest))
        assert angle(way, turns[parent] @ rest) < 0.1, (start, end)
        if start.endswith(("spine", "Arm", "Leg")):
            ours = TO_THREE @ (posture.joints[row] - posture.joints[parent])
            apart = angle(rest, TO_THREE @ posture.rest[row])
            assert angle(way, ours) < apart + 0.1, (start, end)


def test_the_left_arm_raised_in_the_capture_is_the_left_arm_raised_in_the_picture(
    data_dir: Path, avatar: Avatar, sink: Sink
) -> None:
    """A whole session: of nine of the capture's markers, through estimator and humanoid."""
    clip = read_c3d(data_dir / "real/HDM_bd_05-01_01.c3d", LABELS)
    frames = clip.xyz[2870:2923]
    marker = dict(zip(LABELS, frames[-1].astype(float), strict=True))
    assert marker["LFIN"][2] > marker["LFHD"][2] + 0.1  # above the forehead
    assert marker["RFIN"][2] < marker["RBWT"][2]  # below the belt

    tracked = MODEL.info.tracked
    worn = Layout(tracked, clip.layout.rate)
    seen = frames[:, [LABELS.index(label) for label in tracked]]
    source = C3dSource("clip", Clip(clip.path, worn, seen), VirtualClock())
    session = Session(source, PoseEstimator(MODEL), [sink], CONTEXT)
    for frame in source:
        pose = session.handle(frame)
    drawn = avatar.drawn(len(frames))
    check(drawn, pose.posture)

    joints = drawn.joints
    assert joints["leftHand"][1] > joints["head"][1] + 0.1
    assert joints["rightHand"][1] < joints["spine"][1]
    # Beside the markers themselves, without the humanoid between them.
    for side in ("left", "right"):
        label = side[0].upper()
        wrist = (marker[label + "WRA"] + marker[label + "WRB"]) / 2
        arm = TO_THREE @ (wrist - marker[label + "SHO"])
        assert angle(joints[side + "Hand"] - joints[side + "UpperArm"], arm) < 15, side
    belt = TO_THREE @ (marker["LFWT"] - marker["RFWT"])
    assert angle(joints["leftUpperLeg"] - joints["rightUpperLeg"], belt) < 15

    # In the picture the avatar looks at us: its left is on the right, and nothing else is so high.
    seen, hand, head = drawn.coloured(), drawn.pixels["leftHand"], drawn.pixels["head"]
    assert seen[int(hand[1]), int(hand[0])]
    columns = np.flatnonzero(seen[: int(hand[1])].any(axis=0))
    assert columns.min() > head[0] + 20


@pytest.mark.parametrize("name", ["02_01", "02_03"])  # a walk, a run
def test_the_avatar_moves_as_the_capture_does(
    data_dir: Path, avatar: Avatar, sink: Sink, name: str
) -> None:
    clip = read_c3d(data_dir / f"real/{name}.c3d", LABELS)
    solver = HumanoidSolver(MODEL.info)
    measured = np.full(len(LABELS), Provenance.MEASURED, np.uint8)
    sigma = np.full(len(LABELS), 0.001, np.float32)
    poses = [Pose(i, 0.0, xyz, measured, sigma) for i, xyz in enumerate(clip.xyz[:100])]
    solved = [replace(pose, posture=solver.solve(pose)) for pose in poses]
    whole = [pose for pose in solved if pose.posture]  # not where the capture lacks a marker
    assert len(whole) > 60
    for pose in whole[::12]:
        sink(pose)
        check(avatar.drawn(1), pose.posture)


def test_the_relay_outlives_what_it_cannot_use(avatar: Avatar, sink: Sink) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(b"no OSC", ("127.0.0.1", avatar.port))
    for path in ("nothing", "/nothing", "../../pyproject.toml"):
        with pytest.raises(HTTPError, match="404"):
            urlopen(avatar.url + path)
    sink(greeting())
    avatar.drawn(1)


def test_who_looks_to_the_side_and_raises_the_left_arm(avatar: Avatar, sink: Sink) -> None:
    pose = greeting()
    sink(pose)
    drawn = avatar.drawn(1)
    joints, rest = drawn.joints, drawn.rest
    scale = rest["hips"][1] / 0.875
    np.testing.assert_allclose(joints["hips"], [-scale, rest["hips"][1], 2 * scale], atol=1e-5)
    # Who looks along our -x looks along three's x, and has the left arm in three's -z.
    assert angle(joints["leftUpperLeg"] - joints["rightUpperLeg"], np.array([0, 0, -1])) < 0.1
    assert angle(joints["leftHand"] - joints["leftUpperArm"], np.array([0, 1, 0])) < 1
    assert angle(joints["rightHand"] - joints["rightUpperArm"], np.array([0, 0, 1])) < 1
