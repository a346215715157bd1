"""Sinks of engines: what they send when, in how many packets, and to whom."""

from __future__ import annotations

import socket
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_bundle import OscBundle

from bridge.humanoid.skeleton import BONES, PARENTS
from bridge.pose import Pose, Provenance
from bridge.sinks.engine import EngineSink, Placing
from bridge.sinks.outlet import Outlet
from bridge.sinks.registry import open_sink
from bridge.sinks.trackers import BONE_OF
from bridge.sinks.vrchat import euler
from drivers.clock import VirtualClock
from drivers.coordinates import FRAMES
from drivers.marker_set import MARKERS
from drivers.udp_sender import ETHERNET
from drivers.wire.osc_qtm import QtmDecoder
from tests.bridge.humanoid_reference import quaternions
from tests.bridge.poses import (
    CONTEXT,
    COUNT,
    INFO,
    LEFT,
    RAISED,
    lost,
    made,
    pose,
    posture,
    product,
    read,
    sent,
    standing,
    turned,
    unknown,
)
from tests.end_to_end.peers import Receiver, free_port, wait_for

HERE = "127.0.0.1:1"
ENGINES = ["vmc", "vrchat", "vmt", "qtm-osc", "osc"]
UNSURE = 0.2


def doubtful(bone: str, marker: str, at: float = 50.0) -> Pose:
    """Standing, but nobody is sure of a bone and of a marker."""
    before = standing(t=at)
    sigma = before.sigma.copy()
    sigma[INFO.labels.index(marker)] = UNSURE
    body = posture({"Hips": LEFT, "LeftUpperArm": RAISED}, sigma={bone: UNSURE})
    return replace(before, sigma=sigma, posture=body)


def values(messages: list, address: str) -> dict[str, np.ndarray]:
    """The numbers of VMC messages by name."""
    return {params[0]: np.float32(params[1:]) for at, params in messages if at == address}


BONE, TRACKER = "/VMC/Ext/Bone/Pos", "/VMC/Ext/Tra/Pos"


# VMC


def test_vmc_sends_a_bundle_per_pose_with_relative_time() -> None:
    poses = [pose(i, 1.7e9 + i / 120, seed=i) for i in range(3)]
    parts = made(f"vmc://{HERE}", *poses)
    assert [len(part) for part in parts] == [1, 1, 1, 0]
    for i, (datagram,) in enumerate(parts[:3]):
        assert datagram[8:16] == struct.pack(">Q", 1)  # time tag: immediately
        ok, time, root, *_ = read([datagram])
        assert ok == ("/VMC/Ext/OK", [1])
        assert time == ("/VMC/Ext/T", [pytest.approx(i / 120, abs=1e-6)])
        assert root == ("/VMC/Ext/Root/Pos", ["root", 0, 0, 0, 0, 0, 0, 1])


def test_vmc_sends_bones_markers_or_both() -> None:
    both, bones, markers = (
        read(made(f"vmc://{HERE}?send={what}", standing())[0])
        for what in ("both", "bones", "trackers")
    )
    assert list(values(both, BONE)) == list(BONES)
    assert list(values(both, TRACKER)) == list(INFO.labels)
    assert values(bones, TRACKER) == values(markers, BONE) == {}
    assert [address for address, _ in markers[:3]] == ["/VMC/Ext/OK", "/VMC/Ext/T", TRACKER]
    for name, numbers in values(both, BONE).items():
        np.testing.assert_array_equal(values(bones, BONE)[name], numbers)
    for name, numbers in values(both, TRACKER).items():
        np.testing.assert_array_equal(values(markers, TRACKER)[name][:3], numbers[:3])
        np.testing.assert_array_equal(values(markers, TRACKER)[name][3:], [0, 0, 0, 1])


def test_only_those_who_need_a_posture_want_one() -> None:
    moving = "?uncertain=hold"
    wanting = {
        *("vmc", "vrchat", "vmt", "vmc?send=bones"),
        *("qtm-osc" + moving, "osc" + moving, "vmc?send=trackers&uncertain=fade"),
        "vmc?send=trackers&hips=50cm",
    }
    others = {"qtm-osc", "osc", "qtm-osc?uncertain=hide", "osc?uncertain=hide", "vmc?send=trackers"}
    for address in wanting | others:
        scheme, mark, options = address.partition("?")
        sink = open_sink(f"{scheme}://{HERE}{mark}{options}", CONTEXT)
        sink.close()
        assert sink.wants_posture == (address in wanting), address


def test_a_receiver_that_hangs_bone_on_bone_has_our_joints() -> None:
    for each in (standing(), pose(seed=1), pose(seed=2)):
        body = each.posture
        assert body is not None
        bones = values(read(made(f"vmc://{HERE}?send=bones", each)[0]), BONE)
        joints, turns = [], []
        for row, numbers in enumerate(bones.values()):
            place, turn, parent = numbers[:3], numbers[3:], PARENTS[row]
            joints.append(place if row == 0 else joints[parent] + turned(turns[parent], place))
            turns.append(turn if row == 0 else product(turns[parent], turn))
        np.testing.assert_allclose(joints, FRAMES["unity"].from_ours(body.joints), atol=1e-5)
        theirs = FRAMES["unity"].rotations_from_ours(body.rotations)
        same = np.abs(np.einsum("ij,ij->i", turns, theirs))  # a quaternion and its negative are
        np.testing.assert_allclose(same, 1.0, atol=1e-5)


@pytest.mark.parametrize("name", FRAMES)
def test_positions_and_rotations_are_as_the_frame_has_them(name: str) -> None:
    body, frame = pose().posture, FRAMES[name]
    assert body is not None
    rows = np.full((len(BONES), 7), np.nan, np.float32)
    Placing(frame).write(body.joints, body.rotations, rows)
    np.testing.assert_array_equal(rows[:, :3], frame.from_ours(body.joints))
    np.testing.assert_array_equal(rows[:, 3:], frame.rotations_from_ours(body.rotations))


@pytest.mark.parametrize("policy", ["show", "fade"])
@pytest.mark.parametrize("scheme", ENGINES)
def test_every_other_row_of_more_markers_is_a_pose_too(scheme: str, policy: str) -> None:
    each = standing()
    xyz, sigma = np.repeat(each.xyz, 2, axis=0)[::2], np.repeat(each.sigma, 2)[::2]
    address = f"{scheme}://{HERE}?uncertain={policy}"
    assert made(address, replace(each, xyz=xyz, sigma=sigma)) == made(address, each)


def test_vmc_is_as_large_as_the_avatar() -> None:
    usual, half = (
        read(made(f"vmc://{HERE}{option}", standing())[0]) for option in ("", "?hips=50cm")
    )
    for address in (BONE, TRACKER):
        for name, numbers in values(usual, address).items():
            np.testing.assert_array_equal(values(half, address)[name][:3], numbers[:3] / 2)
            np.testing.assert_array_equal(values(half, address)[name][3:], numbers[3:])


@pytest.mark.parametrize("option", ["", "?send=bones", "?send=trackers", "?uncertain=hide"])
def test_vmc_is_not_ready_before_the_first_pose_and_while_it_is_lost(option: str) -> None:
    poses = [unknown(0, 50.0), standing(t=51.0), lost(standing(), 52.0), standing(t=53.0)]
    parts = [read(part) for part in made(f"vmc://{HERE}{option}", *poses)[:4]]
    assert parts[0] == [("/VMC/Ext/OK", [0]), ("/VMC/Ext/T", [0.0])]
    assert parts[2] == [("/VMC/Ext/OK", [0]), ("/VMC/Ext/T", [2.0])]
    assert [part[0][1] for part in parts] == [[0], [1], [0], [1]]
    assert len(parts[1]) == len(parts[3]) > 20


@pytest.mark.parametrize("policy", ["fade", "hold"])
def test_vmc_goes_on_with_a_lost_pose_that_fades_or_is_held(policy: str) -> None:
    poses = [unknown(0, 50.0), standing(t=51.0), lost(standing(), 52.0)]
    parts = [read(part) for part in made(f"vmc://{HERE}?uncertain={policy}", *poses)[:3]]
    assert [part[0][1] for part in parts] == [[0], [1], [1]]
    before, after = (values(part, BONE) for part in parts[1:])
    np.testing.assert_allclose(after["Hips"], before["Hips"], atol=1e-6)
    expected = [0, 0, 0, 1] if policy == "fade" else before["LeftUpperArm"][3:]
    np.testing.assert_allclose(after["LeftUpperArm"][3:], expected, atol=1e-6)


def test_vmc_leaves_out_what_is_hidden_and_sends_it_again() -> None:
    poses = [standing(t=50), doubtful("LeftHand", "LFIN", 50.1), standing(t=50.2)]
    parts = [read(part) for part in made(f"vmc://{HERE}?uncertain=hide", *poses)[:3]]
    for names, address, gone in ((BONES, BONE, "LeftHand"), (INFO.labels, TRACKER, "LFIN")):
        sent_then = [list(values(part, address)) for part in parts]
        assert sent_then == [list(names), [name for name in names if name != gone], list(names)]
    for address, other in ((BONE, "Hips"), (TRACKER, "RFIN")):  # the others are in their places
        first, second, _ = (values(part, address)[other] for part in parts)
        np.testing.assert_array_equal(first, second)


def test_vmc_leaves_out_a_marker_without_a_place() -> None:
    each = standing()
    each.xyz[INFO.labels.index("LFIN")] = np.nan
    (part, _) = made(f"vmc://{HERE}?send=trackers", replace(each, posture=None))
    assert set(INFO.labels) - set(values(read(part), TRACKER)) == {"LFIN"}


def test_vmc_holds_the_hips_in_the_world() -> None:
    away = posture({"Hips": RAISED}, (4, 4, 4), {"Hips": UNSURE})
    poses = standing(t=50), replace(standing(t=51), posture=away)
    first, second = (
        values(read(part), BONE)["Hips"]
        for part in made(f"vmc://{HERE}?uncertain=fade", *poses)[:2]
    )
    np.testing.assert_allclose(second, first, atol=1e-6)


def test_another_threshold_is_another_policy() -> None:
    wide, narrow = (
        read(made(f"vmc://{HERE}?uncertain=hide&sigma={sigma}", standing())[0])
        for sigma in ("4cm", "30mm")
    )
    assert len(values(wide, TRACKER)) == COUNT
    assert len(values(narrow, TRACKER)) == 0  # all have 31 mm
    assert len(values(narrow, BONE)) == len(BONES)  # all have 10 mm


def test_off_this_machine_bundles_fit_an_ethernet_packet_and_lose_nothing() -> None:
    (whole,) = made(f"vmc://{HERE}", standing())[0]
    parts = made(f"vmc://{HERE}", standing(), limit=ETHERNET)[0]
    assert len(parts) == 4
    assert max(map(len, parts)) <= ETHERNET
    assert read(parts) == read([whole])
    assert all(OscBundle.dgram_is_bundle(part) for part in parts)


def test_every_marker_sits_on_a_bone() -> None:
    assert sorted(BONE_OF) == sorted(MARKERS)
    assert set(BONE_OF.values()) <= set(BONES)


# VRChat and SteamVR


@given(st.integers(0, 10_000))
def test_euler_angles_applied_z_x_y_are_the_rotation(seed: int) -> None:
    turns = np.random.default_rng(seed).normal(size=(8, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    back = composed(angles(turns))
    assert np.abs(np.einsum("ij,ij->i", back, turns)) == pytest.approx(1.0, abs=1e-5)


def test_looking_straight_up_or_down_is_exact_too() -> None:
    for pitch in (-90, 90, -89.95, 89.95, 90.02):
        for yaw in (-170, -30, 0, 45, 100):
            turn = composed(np.array([[pitch, yaw, 20.0]]))
            back = composed(angles(turn))
            assert abs(back[0] @ turn[0]) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(
        angles(composed(np.array([[90, 30, 0.0], [-90, -60, 0]]))),
        [[90, 30, 0], [-90, -60, 0]],
        atol=0.03,
    )


def angles(turns: np.ndarray) -> np.ndarray:
    """Degrees about x, y and z of quaternions."""
    turned = np.concatenate([np.zeros((len(turns), 3)), turns], axis=1).astype(np.float32)
    rows = np.empty((len(turns), 6), np.float32)
    euler(turned, rows)
    return rows[:, 3:]


def composed(degrees: np.ndarray) -> np.ndarray:
    """Quaternions of turns about z, then x, then y, one matrix after the other."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(np.radians(degrees)).T, np.cos(np.radians(degrees)).T
    one, nil = np.ones_like(sx), np.zeros_like(sx)
    about_x = np.array([[one, nil, nil], [nil, cx, -sx], [nil, sx, cx]])
    about_y = np.array([[cy, nil, sy], [nil, one, nil], [-sy, nil, cy]])
    about_z = np.array([[cz, -sz, nil], [sz, cz, nil], [nil, nil, one]])
    return quaternions(np.einsum("abn,bcn,cdn->nad", about_y, about_x, about_z))


def test_vrchat_gets_zeros_in_the_rest_pose_and_only_the_heads_yaw() -> None:
    resting = replace(standing(), posture=posture())
    rotations = [params for at, params in read(made(f"vrchat://{HERE}", resting)[0]) if "rot" in at]
    assert rotations == [[0.0] * 3] * 9
    nodding = (0.2588190, 0.0, 0.0, 0.9659258)  # 30 degrees up
    looking = replace(standing(), posture=posture({"Hips": LEFT, "Head": nodding}))
    (*_, (address, angles)) = read(made(f"vrchat://{HERE}", looking)[0])
    assert address == "/tracking/trackers/head/rotation"
    assert angles == pytest.approx([0, -90, 0], abs=1e-4)
    assert angles[0] == angles[2] == 0


def test_some_trackers_and_as_much_of_the_head_as_is_wanted() -> None:
    whole = read(made(f"vrchat://{HERE}", standing())[0])
    for head, count in (("yes", 18), ("position", 17), ("no", 16)):
        assert read(made(f"vrchat://{HERE}?head={head}", standing())[0]) == whole[:count]
    feet = read(made(f"vrchat://{HERE}?trackers=3,1,2", standing())[0])
    assert feet == whole[:6] + whole[16:]
    all_eleven = read(made(f"vmt://{HERE}", standing())[0])
    hips_and_hands = read(made(f"vmt://{HERE}?trackers=10,9,1", standing())[0])
    assert hips_and_hands == [all_eleven[1], *all_eleven[9:]]


def test_vrchat_is_sent_nothing_while_nothing_is_known_or_shown() -> None:
    everything = dict.fromkeys(BONES, UNSURE)
    hidden = replace(standing(), posture=posture(sigma=everything))
    parts = made(f"vrchat://{HERE}?uncertain=hide", unknown(), lost(standing(), 1.0), hidden)
    assert parts == [[], [], [], []]


def test_vrchat_leaves_out_a_hidden_tracker() -> None:
    (part, _) = made(f"vrchat://{HERE}?uncertain=hide", doubtful("LeftUpperLeg", "C7"))
    numbers = [address.split("/")[3] for address, _ in read(part)]
    assert numbers[::2] == numbers[1::2] == ["1", "2", "3", "5", "6", "7", "8", "head"]


def test_vmt_switches_off_what_is_hidden_or_lost_and_all_at_the_end() -> None:
    poses = [unknown(), standing(t=50), doubtful("LeftUpperLeg", "C7", 50.1), lost(standing(), 51)]
    parts = made(f"vmt://{HERE}?uncertain=hide&index=20", *poses)
    assert parts[0] == []
    enabled = [[params[1] for _, params in read(part)] for part in parts[1:]]
    assert enabled == [[1] * 11, [1] * 4 + [0] + [1] * 6, [0] * 11, [0] * 11]
    for part in parts[1:]:
        assert [params[0] for _, params in read(part)] == list(range(20, 31))
        assert all(np.isfinite(params).all() for _, params in read(part))


def test_vmt_that_never_sent_ends_silently() -> None:
    assert made(f"vmt://{HERE}", unknown()) == [[], []]


@pytest.mark.parametrize("policy", ["show", "fade", "hide", "hold"])
@pytest.mark.parametrize("scheme", ["vmc", "vmc?send=trackers&hips=1m", "vrchat", "vmt"])
def test_no_engine_is_ever_sent_what_is_no_number(scheme: str, policy: str) -> None:
    """Whatever becomes of the pose; and when it is as it was, so is what is sent."""
    scheme, mark, options = scheme.partition("?")
    nowhere = replace(standing(t=51), posture=None)
    nowhere.xyz[3] = np.nan  # then there is no humanoid
    unsure = replace(standing(t=52), posture=posture(sigma=dict.fromkeys(BONES, np.nan)))
    unsure.sigma[:] = np.nan
    gone = replace(lost(standing(), 53), posture=None)
    between = [nowhere, unsure, lost(standing(), 52.5), gone, unknown(0, 54)]
    poses = [unknown(0, 49), standing(t=50), *between, standing(t=55), standing(t=56)]
    address = f"{scheme}://{HERE}?uncertain={policy}{'&' * bool(mark)}{options}"
    parts = [read(part) for part in made(address, *poses)]
    for _, params in (message for part in parts for message in part):
        assert np.isfinite([value for value in params if not isinstance(value, str)]).all()
    first, last = (dict(part) if scheme == "vrchat" else part[2:] for part in (parts[1], parts[8]))
    assert last == first


# Markers by their labels


def test_our_own_qtm_decoder_reads_every_marker_back_exactly() -> None:
    poses = [pose(i, 50 + i / 120, seed=i) for i in range(6)]
    decoder, frames = QtmDecoder(120.0), []
    for (datagram,) in made(f"qtm-osc://{HERE}", *poses)[:6]:
        frames += decoder.feed(datagram, 0.0)
    assert [frame.index for frame in frames] == [2, 3, 4, 5]  # a label is believed the third time
    assert frames[0].layout.labels == INFO.labels
    for frame in frames:
        millimetres = poses[frame.index].xyz / np.float32(0.001)
        np.testing.assert_array_equal(frame.xyz, millimetres)
        assert frame.t_device == pytest.approx(frame.index / 120, abs=1e-6)


@pytest.mark.parametrize("scheme", ["qtm-osc", "osc"])
def test_frame_unit_and_labels_are_the_users(scheme: str) -> None:
    options = "frame=unity&unit=cm&labels=Nacken:C7"
    each = standing()
    messages = read(made(f"{scheme}://{HERE}?{options}", each)[0])
    row = INFO.labels.index("C7")
    expected = each.xyz[row, [0, 2, 1]] * 100
    if scheme == "qtm-osc":
        assert dict(messages)["/qtm/3d/Nacken"] == pytest.approx(expected)
    else:
        (_, layout), (_, body) = messages
        assert layout[1:][row] == "Nacken"
        assert body[3:][3 * row : 3 * row + 3] == pytest.approx(expected)
        assert body[-1] == pytest.approx(3.125)  # sigma, in their unit too


def test_qtm_has_nan_for_what_is_lost_or_hidden() -> None:
    poses = [unknown(), doubtful("Spine", "LFIN"), lost(standing(), 51)]
    parts = made(f"qtm-osc://{HERE}?uncertain=hide", *poses)[:3]
    nan = [[at for at, params in read(part) if np.isnan(params).any()] for part in parts]
    assert nan[0] == nan[2] == [f"/qtm/3d/{label}" for label in INFO.labels]
    assert nan[1] == ["/qtm/3d/LFIN"]


def test_our_own_wire_is_as_it_was_whatever_is_lost() -> None:
    gone = lost(standing(), 51)
    gone.provenance[0] = Provenance.MEASURED
    (_, params) = read(made(f"osc://{HERE}", gone)[0])[1]
    assert params[2] == "M" + "L" * (COUNT - 1)
    np.testing.assert_array_equal(np.float32(params[3 : 3 + 3 * COUNT]), gone.xyz.ravel())
    assert params[-COUNT:] == [np.inf] * COUNT


def test_our_own_layout_is_sent_once_a_second() -> None:
    parts = made(f"osc://{HERE}", *[pose(i, i / 10) for i in range(31)])
    assert [i for i, part in enumerate(parts) if len(part) == 2] == [0, 10, 20, 30]


def test_markers_are_held_against_the_hips() -> None:
    away = doubtful("Spine", "LFIN", 51)
    away.xyz[INFO.labels.index("LFIN")] += 3
    before, after = made(f"osc://{HERE}?uncertain=hold", standing(), away)[:2]
    first, then = (np.float32(read(part)[-1][1][3:]) for part in (before, after))
    np.testing.assert_allclose(then[: 3 * COUNT], first[: 3 * COUNT], atol=1e-6)
    assert then[3 * COUNT :].max() == np.float32(UNSURE)  # and it is said how uncertain


# Receivers


@pytest.mark.parametrize("scheme", ENGINES)
def test_each_protocol_has_its_port_and_its_rate(scheme: str) -> None:
    address = f"{scheme}://127.0.0.1" + (":7400" if scheme == "qtm-osc" else "")
    sink = open_sink(address, CONTEXT)
    assert isinstance(sink, EngineSink)
    ports = {"vmc": 39539, "vrchat": 9000, "vmt": 39570, "qtm-osc": 7400, "osc": 9200}
    assert sink._out._address[1] == ports[scheme]
    assert sink.rate == (0 if "osc" in scheme else 250)
    assert sink._out.limit > ETHERNET
    sink.close()


def test_at_most_as_many_bundles_a_second_as_receivers_can_take() -> None:
    clock = VirtualClock()
    with Receiver() as receiver:
        sink = open_sink(f"vmc://127.0.0.1:{receiver.port}?rate=50&send=bones", CONTEXT)
        outlet = Outlet(sink, clock)
        outlet.stream_rate = 500.0
        for index in range(500):
            clock.sleep_until(index / 500)
            outlet.put(pose(index, clock.now()))
        outlet.close()
    assert 45 <= len(receiver.datagrams) <= 56
    assert outlet.counters["rate_limited"] == 500 - len(receiver.datagrams)


def test_several_sinks_and_receivers_get_the_same_pose() -> None:
    with Receiver() as first, Receiver() as second, Receiver() as third:
        addresses = [
            f"vmc://127.0.0.1:{first.port}",
            f"vmc://127.0.0.1:{second.port}",
            f"vrchat://127.0.0.1:{third.port}",
            f"vmt://127.0.0.1:{free_port()}",  # nobody is there
        ]
        sinks = [open_sink(address, CONTEXT) for address in addresses]
        for sink in sinks:
            sink(standing())
        receivers = (first, second, third)
        wait_for(lambda: all(each.datagrams for each in receivers), "datagrams", 5)
        for sink in sinks:
            sink.close()
    assert first.datagrams == second.datagrams
    assert read(first.datagrams)[0] == ("/VMC/Ext/OK", [1])
    assert read(third.datagrams)[0] == ("/tracking/trackers/1/position", [1.0, 1.0, 2.0])


@pytest.mark.parametrize("scheme", ENGINES)
@pytest.mark.parametrize("host", ["127.0.0.1", "127.255.255.255"])  # a closed port; broadcast
def test_a_receiver_that_is_gone_costs_nothing(scheme: str, host: str) -> None:
    sink = open_sink(f"{scheme}://{host}:{free_port()}", CONTEXT)
    for index in range(20):
        sink(standing(index))
    sink.close()


def test_a_receiver_that_goes_and_comes_back_goes_on() -> None:
    with Receiver() as receiver:
        sink = open_sink(f"osc://127.0.0.1:{receiver.port}", CONTEXT)
        sink(standing(0, 50.0))
    sink(standing(1, 50.1))
    again = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    again.bind(("127.0.0.1", receiver.port))
    again.settimeout(5)
    sink(standing(2, 50.2))
    assert read([again.recv(65_536)])[0][1][0] == 2
    sink.close()
    again.close()


def test_a_close_that_reaches_nobody_is_no_error() -> None:
    sink = open_sink(f"vmt://127.0.0.1:{free_port()}", CONTEXT)
    assert isinstance(sink, EngineSink)
    sink(standing())
    sink._out.close()
    sink.close()
    sink.close()


def test_all_is_sent_over_a_socket_as_it_is_made() -> None:
    for scheme in ENGINES:
        there = made(f"{scheme}://{HERE}", standing())
        expected = [datagram for part in there for datagram in part]
        address = f"{scheme}://127.0.0.1:" + "{}"
        assert sent(address, standing(), datagrams=len(expected)) == expected
