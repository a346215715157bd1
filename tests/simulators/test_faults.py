"""Each fault: what it does on the device, and what the host makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.wire.osc_native import NativeOscDecoder, NativeOscEncoder
from simulators.body_parts import BODY_PARTS
from simulators.faults.chain import FaultChain
from simulators.faults.packets import Packet, Truncate
from simulators.faults.plan import parse_plan
from tests.simulators.played import LAYOUT, START, Played, play, position

FRAMES = 1200  # of ten seconds
TRACKED = LAYOUT.labels


def one(kind: str, **numbers: object) -> str:
    """A fault file with one fault."""
    lines = [f"kind = {kind!r}"]
    for key, value in numbers.items():
        lines.append(f"{key.rstrip('_')} = {str(value).lower() if value is True else repr(value)}")
    return "[[fault]]\n" + "\n".join(lines).replace("'", '"')


def missing(played: Played) -> np.ndarray:
    """(frames, markers): which are missing."""
    return np.isnan(np.stack([frame.xyz for frame in played.frames])).any(axis=2)


def truth(played: Played) -> np.ndarray:
    return np.stack([position(index) for index in played.indices])


def seen(played: Played) -> np.ndarray:
    return np.stack([frame.xyz for frame in played.frames])


def device_accounts(played: Played) -> None:
    """Every packet that was made went out or was counted."""
    did = played.device.counters
    made = did["packets"] + did["duplicate"]
    assert made == did["whole"] + did["spoilt"] + did["no_line"] + did["loss"]


ALL_KINDS = [
    one("swap", markers=["LFHD", "RFHD"], chance=0.1),
    one("ghost", marker="LTOE", chance=0.1),
    one("noise", size="1mm"),
    one("dropout", share=0.2, frames=[10, 100]),
    one("occlusion", part="left arm", chance=0.01, for_=0.2),
    one("drift", ppm=50),
    one("clock_jump", seconds=1.5, chance=0.002),
    one("loss", chance=0.05),
    one("duplicate", chance=0.05, copies=2),
    one("truncate", chance=0.05),
    one("flip", chance=0.05, bits=3),
    one("jitter", up_to=0.02),
    one("reorder", chance=0.05, by=2),
    one("stall", chance=0.002, for_=0.3),
    one("unplug", chance=0.002, for_=0.3),
]


@pytest.mark.parametrize("plan", [*ALL_KINDS, "\n".join(ALL_KINDS)])
def test_a_seed_is_a_run_and_every_packet_is_accounted_for(plan: str) -> None:
    first, again = play("seed = 3\n" + plan, 3.0), play(plan, 3.0, seed=3)
    other, clean = play(plan, 3.0, seed=4), play("", 3.0)
    assert first.line.packets == again.line.packets
    assert first.device.counters == again.device.counters
    assert first.line.packets != clean.line.packets
    if "drift" not in plan or "swap" in plan:  # a drift has nothing to do with chance
        assert other.line.digest != first.line.digest or other.now != first.now
    for played in (first, other):
        device_accounts(played)
        assert played.device.sent == 360
        assert played.indices == sorted(set(played.indices))


def test_one_fault_does_not_change_the_random_numbers_of_another() -> None:
    loss, noise = one("loss", chance=0.05), one("noise", size="1mm")
    assert play(loss).indices == play(f"{loss}\n{noise}").indices


def test_one_plan_serves_two_devices() -> None:
    plan = parse_plan("\n".join(ALL_KINDS), LAYOUT.labels)
    one_chain, other = FaultChain(plan, LAYOUT), FaultChain(plan, LAYOUT)
    for index in range(240):
        t, xyz = index / LAYOUT.rate, position(index)
        np.testing.assert_array_equal(one_chain.markers(t, xyz), other.markers(t, xyz))
        assert one_chain.stamp(t) == other.stamp(t)
        packet = Packet(xyz.tobytes(), t, t)
        assert one_chain.packets(packet) == other.packets(packet)
        assert one_chain.unplugged(t) == other.unplugged(t)
    assert one_chain.counters == other.counters


# When.


def test_a_fault_without_a_when_acts_throughout() -> None:
    assert play(one("loss")).frames == []


def test_a_moment_is_one_frame_without_a_duration_and_a_stretch_with_one() -> None:
    part = {"part": "head", "at": 2.0}
    assert np.flatnonzero(missing(play(one("occlusion", **part)))[:, 0]).tolist() == [240]
    hidden = missing(play(one("occlusion", **part, for_=0.5)))[:, 0]
    assert np.flatnonzero(hidden).tolist() == list(range(240, 300))


def test_every_so_often_is_from_beginning_to_beginning() -> None:
    played = play(one("occlusion", part="head", at=1.0, for_=0.05, every=3.0))
    expected = [120 + 360 * i + k for i in range(4) for k in range(6) if 120 + 360 * i < FRAMES]
    assert np.flatnonzero(missing(played)[:, 0]).tolist() == expected
    assert played.device.counters["occlusion"] == 2 * len(expected)


def test_a_chance_is_per_frame_and_may_last() -> None:
    hidden = missing(play(one("dropout", markers=["LTOE"], chance=0.05), 60.0))[:, -1]
    assert hidden.mean() == pytest.approx(0.05, abs=0.008)
    hidden = missing(play(one("dropout", markers=["LTOE"], chance="1%", for_=0.25), 60.0))[:, -1]
    edges = np.flatnonzero(np.diff(hidden.astype(int)))
    lengths = np.diff(edges)[0 if hidden[edges[0] + 1] else 1 :: 2]
    assert len(lengths) > 20
    assert (lengths % 30 == 0).all()  # of 30 frames; two may follow on each other


# Markers.


def test_noise_has_its_size_on_its_markers_alone() -> None:
    played = play(one("noise", size="2mm", markers=["LTOE", "LFHD"]), 30.0)
    difference = seen(played) - truth(played)
    rows = [TRACKED.index("LTOE"), TRACKED.index("LFHD")]
    np.testing.assert_allclose(difference[:, rows].std(axis=(0, 1)), 0.002, rtol=0.03)
    assert np.delete(difference, rows, axis=1).max() == 0
    assert played.device.counters["noise"] == 2 * 3600


def test_dropout_takes_its_share_in_bursts() -> None:
    hidden = missing(play(one("dropout", share="20%", frames=[10, 100]), 60.0))
    assert hidden.mean() == pytest.approx(0.2, abs=0.05)
    for marker in hidden.T:
        lengths = np.diff(np.flatnonzero(np.diff(marker.astype(int))))
        assert lengths.size > 12
        assert (lengths[0 if not marker[0] else 1 :: 2] >= 10).all()
    assert (hidden.any(axis=1) & ~hidden.all(axis=1)).any()  # each for itself


def test_dropout_of_named_markers_hides_them_together() -> None:
    played = play(one("dropout", markers=["LWRB", "LTOE"], at=1.0, for_=2.0))
    hidden = missing(played)
    assert np.flatnonzero(hidden.any(axis=0)).tolist() == [4, 6]
    assert hidden[120:360, [4, 6]].all()
    assert hidden.sum() == played.device.counters["dropout"] == 480


@pytest.mark.parametrize("part", [name for name, on in BODY_PARTS.items() if set(on) & {*TRACKED}])
def test_occlusion_hides_all_markers_of_the_part_and_no_other(part: str) -> None:
    hidden = missing(play(one("occlusion", part=part, at=0.0, for_=1.0), 2.0))
    on = [label in BODY_PARTS[part] for label in TRACKED]
    assert any(on)
    assert (hidden[:120] == on).all()
    assert not hidden[120:].any()


def test_swap_exchanges_two_labels() -> None:
    played = play(one("swap", markers=["LFHD", "LTOE"], at=1.0, for_=0.1))
    difference = (seen(played) != truth(played)).any(axis=2)
    assert np.flatnonzero(difference.any(axis=0)).tolist() == [0, 6]
    turn = slice(120, 132)
    np.testing.assert_array_equal(seen(played)[turn, 0], truth(played)[turn, 6])
    np.testing.assert_array_equal(seen(played)[turn, 6], truth(played)[turn, 0])
    assert difference.sum() == played.device.counters["swap"] == 24


def test_a_ghost_is_the_marker_in_a_mirror() -> None:
    played = play(
        "[[fault]]\nkind = 'ghost'\nmarker = 'LTOE'\nmirror = { y = 2.5 }\nat = 1.0\nfor = 0.1"
    )
    difference = seen(played) - truth(played)
    assert not np.delete(difference, 6, axis=1).any()
    y = truth(played)[120:132, 6, 1]
    np.testing.assert_allclose(difference[120:132, 6, 1], 2 * (2.5 - y), atol=1e-6)
    floor = play(one("ghost", marker="LTOE", at=1.0))
    np.testing.assert_array_equal(seen(floor)[120, 6] * [1, 1, -1], truth(floor)[120, 6])


def test_a_ghost_may_come_as_well_under_a_label_that_nobody_knows() -> None:
    played = play(one("ghost", marker="LTOE", label="*7", at=1.0, for_=0.1))
    assert played.source.labels == (*TRACKED, "*7")
    np.testing.assert_array_equal(seen(played)[:, :7], truth(played))
    assert np.flatnonzero(~missing(played)[:, 7]).tolist() == list(range(120, 132))


# Stamps.


@pytest.mark.parametrize("ppm", [50, -200])
def test_drift_is_measured_and_mapped_away(ppm: float) -> None:
    played = play(one("drift", ppm=ppm) + "\n" + one("jitter", up_to=0.004), 120.0)
    assert played.frames[-1].t_device == pytest.approx(14399 / 120 * (1 + ppm * 1e-6), abs=1e-5)
    assert played.source.clock_map.drift * 1e6 == pytest.approx(-ppm, abs=5)
    late = played.frames[3600:]
    error = [frame.t_mapped - START - frame.index / 120 for frame in late]
    assert np.abs(error).max() < 1e-3
    assert played.source.counters["clock_jumps"] == 0


@pytest.mark.parametrize("seconds", [3600.0, 0.4, -0.4, -3.0])
def test_a_clock_that_is_set_is_noticed_once_and_mapped_right(seconds: float) -> None:
    played = play(one("clock_jump", seconds=seconds, at=5.0))
    stamps = np.diff([frame.t_device for frame in played.frames])
    assert np.flatnonzero(np.abs(stamps - 1 / 120) > 1e-3).tolist() == [599]
    assert played.device.counters["clock_jump"] == 1
    assert played.source.counters["clock_jumps"] == 1
    error = [frame.t_mapped - START - frame.index / 120 for frame in played.frames]
    assert np.abs(error).max() < 1e-3


# Packets.


def test_lost_packets_are_missing_and_nothing_else() -> None:
    played = play(one("loss", chance=0.05), 60.0)
    lost = played.device.counters["loss"]
    assert lost / played.device.counters["packets"] == pytest.approx(0.05, abs=0.008)
    layouts_lost = 60 - played.source.counters["layouts"]
    ends = (played.indices[0], played.device.sent - 1 - played.indices[-1])
    assert played.source.counters["missing"] == lost - layouts_lost - sum(ends)
    assert len(played.frames) == 7200 - lost + layouts_lost


def test_a_copy_is_delivered_once() -> None:
    played = play(one("duplicate", chance=0.1, copies=2))
    assert played.indices == list(range(FRAMES))
    copied = played.device.counters["duplicate"]
    assert copied > 100
    assert played.source.counters["duplicates"] + played.source.counters["layouts"] == copied + 10
    assert played.source.counters["missing"] == 0


@pytest.mark.parametrize("bits", [1, 5])
def test_no_packet_with_a_flipped_bit_is_delivered_and_each_is_counted(bits: int) -> None:
    played = play(one("flip", chance=0.1, bits=bits), 30.0)
    flipped = played.device.counters["flip"]
    assert played.device.counters["spoilt"] == flipped > 300
    np.testing.assert_array_equal(seen(played), truth(played))
    counters = played.source.counters
    # A bit may make an end mark, and two packets of one.
    assert flipped <= counters["bad_crc"] + counters["bad_cobs"] <= (1 + bits) * flipped
    assert 3600 - len(played.frames) - flipped + (30 - counters["layouts"]) == 0


def test_over_udp_each_truncated_packet_is_counted_and_no_other_harmed() -> None:
    played = play(
        one("truncate", chance=0.1), 30.0, encoder=NativeOscEncoder(), decoder=NativeOscDecoder()
    )
    cut, counters = played.device.counters["truncate"], played.source.counters
    assert cut > 300
    assert counters["bad_osc"] + counters["bad_packet"] == cut
    assert len(played.frames) + counters["layouts"] + cut == played.device.counters["packets"]
    np.testing.assert_array_equal(seen(played), truth(played))


def test_on_a_serial_line_a_truncated_packet_is_lost_alone() -> None:
    played = play(one("truncate", chance=0.05), 30.0)
    cut, counters = played.device.counters["truncate"], played.source.counters
    lost = played.device.counters["packets"] - len(played.frames) - counters["layouts"]
    # One that lost no more than its end mark is closed by the next one's beginning.
    assert 0.9 * cut < lost <= cut
    assert lost <= counters["bad_crc"] + counters["bad_cobs"] + 0.05 * cut  # or all but a byte
    np.testing.assert_array_equal(seen(played), truth(played))


def test_what_cannot_be_cut_stays() -> None:
    packet = Packet(b"!", 0.0, 0.0)
    assert Truncate(kind="truncate").apply(packet) == [packet]


def test_jitter_delays_but_keeps_the_order() -> None:
    played = play(one("jitter", up_to=0.02), 30.0)
    assert played.indices == list(range(3600))
    delays = np.array(played.now) - np.arange(3600) / 120
    assert delays.min() >= 0
    assert 0.0195 < delays.max() <= 0.02
    assert played.device.counters["jitter"] == played.device.counters["packets"]
    error = [frame.t_mapped - START - frame.index / 120 for frame in played.frames[1200:]]
    assert np.abs(error).max() < 1.5e-3  # by the quickest, not by when they came


@pytest.mark.parametrize("by", [1, 2])
def test_overtaken_packets_are_put_right_by_a_buffer_that_is_deep_enough(by: int) -> None:
    played = play(one("reorder", chance=0.05, by=by), 30.0, reorder=by)
    counters = played.source.counters
    assert played.indices == list(range(3600))
    assert counters["missing"] == counters["late"] == counters["duplicates"] == 0
    held = played.device.counters["reorder"]
    assert held > 150
    # Some are layouts; of those whose successors are late as well not all are overtaken.
    assert 0.8 * held <= counters["reordered"] <= held


def test_without_a_buffer_overtaken_packets_are_late() -> None:
    played = play(one("reorder", chance=0.05, by=2), 30.0)
    counters = played.source.counters
    assert len(played.frames) + counters["late"] == 3600
    assert counters["late"] > 100
    assert counters["missing"] == 0  # late is not missing
    assert played.indices == sorted(played.indices)


# The line.


@pytest.mark.parametrize("seconds", [0.3, 0.9])
def test_after_a_stall_everything_is_there_at_once_under_its_own_time(seconds: float) -> None:
    played = play(one("stall", at=3.0, for_=seconds))
    assert played.indices == list(range(FRAMES))
    held = slice(360, 360 + round(seconds * 120))
    np.testing.assert_allclose(played.now[held], 3.0 + seconds, atol=1e-9)
    assert played.device.counters["stall"] == pytest.approx(seconds * 120, abs=2)
    error = [frame.t_mapped - START - frame.index / 120 for frame in played.frames]
    assert np.abs(error).max() < 1e-6
    assert played.source.counters["clock_jumps"] == played.source.counters["disconnects"] == 0


def test_a_stall_that_a_host_takes_for_dead_loses_nothing_either() -> None:
    played = play(one("stall", at=3.0, for_=3.0))
    assert played.indices == list(range(FRAMES))
    assert played.source.counters["silences"] >= 1
    assert played.source.counters["disconnects"] == played.source.counters["reconnects"]


def test_the_stream_goes_on_when_the_plug_is_in_again() -> None:
    played = play(one("unplug", at=2.0, for_=0.5))
    counters = played.source.counters
    assert counters["disconnects"] == counters["reconnects"] == 1
    assert played.device.counters["unplug"] == 1
    gone = np.flatnonzero(np.diff(played.indices) > 1)
    assert played.indices[gone[0]] == 239
    assert played.now[gone[0] + 1] - 2.5 <= 0.1 + 1 / 120
    came = len(played.frames) + counters["layouts"]
    did = played.device.counters
    assert did["packets"] - came == did["no_line"] + played.line.lost
    assert not any(name.startswith("bad_") for name in counters)


def test_a_hundred_plugs_are_survived() -> None:
    played = play(one("unplug", at=0.5, for_=0.3, every=1.0), 100.0)
    counters = played.source.counters
    assert played.device.counters["unplug"] == 100
    assert counters["disconnects"] == counters["reconnects"] == 100
    gaps = np.diff(played.now)
    assert (gaps > 0.25).sum() >= 99
    assert gaps.max() < 0.3 + 0.1 + 2 / 120
