"""Poses and postures for the sinks' tests, and what is sent of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_message import OscMessage

from bridge.humanoid.skeleton import BONES, PARENTS, ROW, Posture
from bridge.model import Model
from bridge.pose import Pose, Provenance
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkContext
from drivers.udp_sender import LOOPBACK
from tests.end_to_end.peers import Receiver, wait_for

INFO = Model("default").info
COUNT = len(INFO.labels)
CONTEXT = SinkContext(INFO, lambda index: None, 100.0)

SQUARE = float(np.sqrt(0.5))
LEFT = (0.0, 0.0, SQUARE, SQUARE)  # a quarter turn to the left, about up
RAISED = (0.0, SQUARE, 0.0, SQUARE)  # what points to the left points up: a quarter about forward
NONE = (0.0, 0.0, 0.0, 1.0)

Turn = Sequence[float]

# Each joint from its parent's, metres; all of them floats without rounding.
_REST = {
    "Hips": (0, 0, 1),
    "Spine": (0, 0, 0.125),
    "Chest": (0, 0, 0.125),
    "Neck": (0, 0, 0.25),
    "Head": (0, 0, 0.125),
    "Shoulder": (0.0625, 0, 0.1875),
    "UpperArm": (0.125, 0, 0),
    "LowerArm": (0.25, 0, 0),
    "Hand": (0.25, 0, 0),
    "UpperLeg": (0.125, 0, 0),
    "LowerLeg": (0, 0, -0.5),
    "Foot": (0, 0, -0.4375),
}


def _rest(bone: str) -> np.ndarray:
    side = -1 if bone.startswith("Left") else 1
    return np.array(_REST[bone.removeprefix("Left").removeprefix("Right")]) * [side, 1, 1]


def product(a: Turn, b: Turn) -> np.ndarray:
    """The rotation a after b, by Hamilton's formula."""
    u, v = np.array(a[:3]), np.array(b[:3])
    return np.append(a[3] * v + b[3] * u + np.cross(u, v), a[3] * b[3] - u @ v)


def turned(turn: Turn, vector: Sequence[float]) -> np.ndarray:
    """A vector turned by a unit quaternion."""
    u, v = np.array(turn[:3]), np.array(vector)
    return v + 2 * turn[3] * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v))


def posture(
    local: Mapping[str, Turn] | None = None,
    hips: Sequence[float] = (1, 2, 1),
    sigma: Mapping[str, float] | None = None,
) -> Posture:
    """The T-pose but for some bones' local rotations; sigma 0.01 m but for some bones."""
    own = [np.array((local or {}).get(bone, NONE)) for bone in BONES]
    joints, turns = [np.array(hips, float)], [own[0]]
    for row, bone in enumerate(BONES[1:], 1):
        parent = PARENTS[row]
        joints.append(joints[parent] + turned(turns[parent], _rest(bone)))
        turns.append(product(turns[parent], own[row]))
    uncertain = np.full(len(BONES), 0.01, np.float32)
    for bone, value in (sigma or {}).items():
        uncertain[ROW[bone]] = value
    return Posture(
        *(np.array(rows, np.float32) for rows in (joints, turns, own)),
        uncertain,
        np.array([_rest(bone) for bone in BONES], np.float32),
    )


def standing(index: int = 60, t: float = 50.5) -> Pose:
    """As the golden texts say: turned to the left, the left arm raised, markers in a row."""
    xyz = np.stack([np.arange(COUNT) / 64, np.full(COUNT, 2.0), np.full(COUNT, 1.5)], axis=1)
    kinds = np.full(COUNT, Provenance.ESTIMATED, np.uint8)
    kinds[:20] = Provenance.MEASURED
    body = posture({"Hips": LEFT, "LeftUpperArm": RAISED})
    sigma = np.full(COUNT, 0.03125, np.float32)
    return Pose(index, t, xyz.astype(np.float32), kinds, sigma, body)


def pose(index: int = 7, t: float = 50.0, seed: int = 0) -> Pose:
    """Anything: markers, and a humanoid that is bent at every joint."""
    random = np.random.default_rng(seed)
    turns = random.normal(size=(len(BONES), 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return Pose(
        index,
        t,
        random.normal(size=(COUNT, 3)).astype(np.float32),
        random.integers(0, 3, COUNT).astype(np.uint8),
        random.random(COUNT).astype(np.float32),
        posture(dict(zip(BONES, turns, strict=True)), random.normal(size=3)),
    )


def unknown(index: int = 0, t: float = 0.0) -> Pose:
    """Before the first known pose."""
    return Pose(
        index,
        t,
        np.full((COUNT, 3), np.nan, np.float32),
        np.full(COUNT, Provenance.LOST, np.uint8),
        np.full(COUNT, np.inf, np.float32),
    )


def lost(before: Pose, t: float) -> Pose:
    """A pose that is lost stays where it was."""
    assert before.posture is not None
    sigma = np.full(COUNT, np.inf, np.float32)
    kinds = np.full(COUNT, Provenance.LOST, np.uint8)
    body = replace(before.posture, sigma=np.full(len(BONES), np.inf, np.float32))
    return replace(before, t=t, provenance=kinds, sigma=sigma, posture=body)


def sent(address: str, *poses: Pose, datagrams: int = 1) -> list[bytes]:
    """What comes to a port, at least so many datagrams, until the sink is closed."""
    with Receiver() as receiver:
        sink = open_sink(address.format(receiver.port), CONTEXT)
        for each in poses:
            sink(each)
        sink.close()
        wait_for(lambda: len(receiver.datagrams) >= datagrams, "datagrams", 5)
    return receiver.datagrams


def made(address: str, *poses: Pose, limit: int = LOOPBACK) -> list[list[bytes]]:
    """What is sent of each pose, and then at the end, without a socket."""
    wire = _Wire(limit)
    with mock.patch("bridge.sinks.engine.UdpSender", return_value=wire):
        sink = open_sink(address, CONTEXT)
    for each in poses:
        sink(each)
        wire.parts.append([])
    sink.close()
    return wire.parts


def read(datagrams: Sequence[bytes]) -> list[tuple[str, list[Any]]]:
    """Addresses and arguments of all messages, as python-osc reads them."""
    found: list[tuple[str, list[Any]]] = []
    for datagram in datagrams:
        whole = OscBundle(datagram) if OscBundle.dgram_is_bundle(datagram) else None
        messages = [OscMessage(datagram)] if whole is None else list(whole)
        found += [(message.address, message.params) for message in messages]
    return found


class _Wire:
    """A UdpSender that keeps what it is given, a list per pose."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.parts: list[list[bytes]] = [[]]

    def send(self, datagram: bytes | bytearray) -> None:
        self.parts[-1].append(bytes(datagram))

    def close(self) -> None:
        pass
