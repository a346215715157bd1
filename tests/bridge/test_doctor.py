"""The doctor on real captures whose bytes were made wrong in one way: it names the way back."""

from __future__ import annotations

import itertools
import threading
from pathlib import Path

import numpy as np
import pytest

from bridge.doctor.body_fit import BodyFit
from bridge.doctor.examination import examine
from bridge.doctor.finding import Finding, Grade, corrected
from bridge.doctor.heard import Heard, listen, read_again
from bridge.doctor.names import by_name
from bridge.doctor.places import by_place
from bridge.doctor.worlds import WORLDS, kind, nearest_unit
from bridge.model import Model, ModelInfo
from drivers.c3d_file import read_c3d
from drivers.clock import VirtualClock
from drivers.coordinates import FRAMES, UNITS, Frame
from drivers.frame import Floats, Layout
from drivers.transport import Received, memory_line
from drivers.url import Url
from drivers.wire.osc_native import NativeOscDecoder
from drivers.wire.registry import take_encoder
from drivers.wire_source import WireSource
from simulators.performer import Walker

ADDRESS = "osc://127.0.0.1:9100"
CLIP = "real/07_12.c3d"
SENDER = "127.0.0.1:40000"


@pytest.fixture(scope="module")
def info() -> ModelInfo:
    return Model("default").info


@pytest.fixture(scope="module", params=(CLIP, "performer:walk"))
def clip(request: pytest.FixtureRequest, data_dir: Path, info: ModelInfo) -> tuple[Layout, Floats]:
    """The first seconds of a capture, the tracked markers alone."""
    if request.param == "performer:walk":
        walker = Walker()
        rows = [walker.layout.labels.index(label) for label in info.tracked]
        poses = np.stack([walker.pose(index)[rows] for index in range(150)])
        return Layout(info.tracked, 120.0), poses
    capture = read_c3d(data_dir / request.param, info.tracked)
    return capture.layout, capture.xyz[:150]


def sent(layout: Layout, xyz: Floats, address: str = ADDRESS) -> list[Received]:
    """What a sender at this address would put on the line; positions and labels are the wire's."""
    encoder, _ = take_encoder(Url.parse(address))
    packets = [encoder.encode_layout(layout)]
    packets += [encoder.encode_frame(n, n / layout.rate, frame) for n, frame in enumerate(xyz)]
    return [Received(p, 50 + n / layout.rate, SENDER) for n, p in enumerate(packets) if p]


def heard(received: list[Received], address: str = ADDRESS, **known: object) -> Heard:
    seconds = received[-1].t - received[0].t
    return read_again(Heard(address, seconds, received=received, **known), address)


def diagnosis(
    info: ModelInfo, layout: Layout, xyz: Floats, address: str = ADDRESS
) -> tuple[list[Finding], dict[str, str]]:
    """What is found wrong, and the options of the address that mends it."""
    findings, mended = examine(heard(sent(layout, xyz), address), info)
    return [f for f in findings if f.grade is not Grade.NOTE], Url.parse(mended).options


def abouts(findings: list[Finding]) -> list[str]:
    return [finding.about for finding in findings]


def exchanged(layout: Layout, xyz: Floats, *pairs: tuple[str, str]) -> Floats:
    other = xyz.copy()
    for one, two in pairs:
        a, b = layout.labels.index(one), layout.labels.index(two)
        other[:, a], other[:, b] = xyz[:, b], xyz[:, a]
    return other


def test_where_nothing_is_wrong_nothing_is_said(info: ModelInfo, clip: tuple) -> None:
    assert diagnosis(info, *clip) == ([], {})


@pytest.mark.parametrize("name", FRAMES)
def test_a_named_world_is_named(info: ModelInfo, clip: tuple, name: str) -> None:
    layout, xyz = clip
    findings, options = diagnosis(info, layout, FRAMES[name].from_ours(xyz))
    if name in ("cmu", "ros"):  # the same but for how it is turned about up, which means nothing
        assert (findings, options) == ([], {})
        return
    assert abouts(findings) == ["coordinates"]
    assert list(options) == ["frame"]
    found = FRAMES[options["frame"]]
    assert (kind(found), found.unit) == (kind(FRAMES[name]), FRAMES[name].unit)


def test_a_world_that_the_address_names_wrongly_is_named_anew(info: ModelInfo, clip: tuple) -> None:
    findings, options = diagnosis(info, *clip, ADDRESS + "?frame=unity&reorder=2")
    assert abouts(findings) == ["coordinates"]
    assert options == {"reorder": "2", "frame": "cmu"}


@pytest.mark.parametrize("unit", UNITS)
def test_every_unit_is_told(info: ModelInfo, clip: tuple, unit: str) -> None:
    layout, xyz = clip
    _, options = diagnosis(info, layout, xyz / np.float32(UNITS[unit]))
    assert options == {"m": {}, "mm": {"frame": "c3d"}}.get(unit, {"unit": unit})


@pytest.mark.parametrize("world", WORLDS, ids=lambda world: world.axes)
def test_every_kind_of_axes_is_told(info: ModelInfo, clip: tuple, world: Frame) -> None:
    layout, xyz = clip
    _, options = diagnosis(info, layout, world.from_ours(xyz))
    named = FRAMES[options["frame"]] if "frame" in options else Frame(options.get("axes", "x,y,z"))
    assert kind(named) == kind(world)


def test_exchanged_sides_are_told_from_a_mirrored_world(info: ModelInfo, clip: tuple) -> None:
    layout, xyz = clip
    pairs = (("LWRB", "RWRB"), ("LANK", "RANK"), ("LSHO", "RSHO"))
    findings, options = diagnosis(info, layout, exchanged(layout, xyz, *pairs))
    assert abouts(findings) == ["exchanged"]
    written = dict(pair.split(":") for pair in options["labels"].split(","))
    assert written == dict(pairs) | {two: one for one, two in pairs}


def test_each_exchanged_pair_is_told(info: ModelInfo, clip: tuple) -> None:
    layout, xyz = clip
    for one, two in list(itertools.combinations(info.tracked, 2))[::7]:
        findings, options = diagnosis(info, layout, exchanged(layout, xyz, (one, two)))
        assert abouts(findings) == ["exchanged"]
        assert sorted(options["labels"].split(",")) == sorted((f"{one}:{two}", f"{two}:{one}"))


def test_labels_that_the_address_exchanges_are_taken_out_of_it(
    info: ModelInfo, clip: tuple
) -> None:
    findings, options = diagnosis(info, *clip, ADDRESS + "?reorder=1&labels=C7:RANK,RANK:C7")
    assert abouts(findings) == ["exchanged"]
    assert options == {"reorder": "1"}


def test_one_fault_does_not_hide_the_next(info: ModelInfo, clip: tuple) -> None:
    layout, xyz = clip
    xyz = FRAMES["unreal"].from_ours(exchanged(layout, xyz, ("LWRB", "RANK")))
    foreign = Layout(tuple(f"ann:{label.lower()}" for label in layout.labels), layout.rate)
    findings, options = diagnosis(info, foreign, xyz)
    assert abouts(findings) == ["labels", "coordinates", "exchanged"]
    assert options["frame"] == "unreal"
    written = dict(pair.rsplit(":", 1) for pair in options["labels"].split(","))
    assert (written["ann:lwrb"], written["ann:rank"]) == ("RANK", "LWRB")
    assert written["ann:c7"] == "C7"


def test_labels_that_are_numbers_are_told_by_where_the_markers_are(
    info: ModelInfo, clip: tuple
) -> None:
    layout, xyz = clip
    order = np.random.default_rng(3).permutation(len(layout.labels))
    numbers = Layout(tuple(str(n) for n in range(1, 10)), layout.rate)
    findings, options = diagnosis(info, numbers, FRAMES["unity"].from_ours(xyz[:, order]))
    assert abouts(findings) == ["labels"]
    assert options["frame"] == "unity"
    expected = [f"{n}:{layout.labels[row]}" for n, row in enumerate(order, 1)]
    assert options["labels"].split(",") == expected


def test_labels_that_are_all_mixed_up_are_sorted(info: ModelInfo, clip: tuple) -> None:
    layout, xyz = clip
    findings, options = diagnosis(info, layout, np.roll(xyz, 1, axis=1))
    assert abouts(findings) == ["mixed-up"]
    expected = [
        f"{label}:{meant}"
        for label, meant in zip(layout.labels, np.roll(layout.labels, 1), strict=True)
    ]
    assert options["labels"].split(",") == expected


def test_with_all_markers_a_mirror_image_may_be_either_and_both_are_said(
    info: ModelInfo, data_dir: Path
) -> None:
    capture = read_c3d(data_dir / CLIP)
    findings, options = diagnosis(
        info, capture.layout, Frame("-x,y,z").from_ours(capture.xyz[:300])
    )
    assert abouts(findings) == ["coordinates"]
    assert "LWRB:RWRB" in findings[0].text
    assert kind(Frame(options["axes"])) == ("z", True)


def test_what_is_no_body_is_said_to_be_none(info: ModelInfo) -> None:
    walk = np.random.default_rng(0).normal(0, 0.5, (300, 9, 3)).cumsum(axis=0) / 20
    layout = Layout(info.tracked, 120.0)
    findings, _ = diagnosis(info, layout, (walk + 1).astype(np.float32))
    assert set(abouts(findings)) & {"body", "size"}


class TestMarkers:
    """Markers that are not what they should be."""

    def spoilt(self, info: ModelInfo, spoil) -> dict[str, Finding]:
        walker = Walker()
        rows = [walker.layout.labels.index(label) for label in info.tracked]
        xyz = np.stack([walker.pose(index)[rows] for index in range(200)])
        spoil(xyz, info.tracked.index("RANK"))
        findings, _ = diagnosis(info, Layout(info.tracked, 120.0), xyz)
        return {finding.about: finding for finding in findings}

    def test_one_that_is_never_there(self, info: ModelInfo) -> None:
        found = self.spoilt(info, lambda xyz, row: xyz[:, row].fill(np.nan))
        assert "RANK" in found["never-seen"].text

    def test_one_that_stands_still(self, info: ModelInfo) -> None:
        def stop(xyz: Floats, row: int) -> None:
            xyz[:, row] = xyz[0, row]

        assert "RANK" in self.spoilt(info, stop)["still"].text

    def test_one_at_the_origin(self, info: ModelInfo) -> None:
        found = self.spoilt(info, lambda xyz, row: xyz[:, row].fill(0.0))
        assert "RANK" in found["at-origin"].text

    def test_one_that_is_often_missing(self, info: ModelInfo) -> None:
        found = self.spoilt(info, lambda xyz, row: xyz[:100, row].fill(np.nan))
        assert "RANK 50%" in found["missing"].text

    def test_a_model_whose_frame_is_made_of_what_is_not_there_is_not_judged(
        self, info: ModelInfo, data_dir: Path
    ) -> None:
        capture = read_c3d(data_dir / CLIP, info.tracked)
        labels = tuple(label for label in info.tracked if label != "C7")
        rows = [info.tracked.index(label) for label in labels]
        findings, _ = examine(heard(sent(Layout(labels, 120.0), capture.xyz[:, rows])), info)
        by_about = {finding.about: finding for finding in findings}
        assert "C7" in by_about["labels"].text
        assert "without C7" in by_about["body"].text


class TestLine:
    """What bytes, counters and times tell."""

    LAYOUT = Layout(("C7", "LSHO", "RSHO"), 120.0)

    def found(self, info: ModelInfo, received: list[Received], **known: object) -> dict:
        findings, address = examine(heard(received, **known), info)
        return {finding.about: finding for finding in findings} | {"address": address}

    def packets(self, count: int = 300, address: str = ADDRESS) -> list[Received]:
        return sent(self.LAYOUT, np.ones((count, 3, 3), np.float32), address)

    def test_silence(self, info: ModelInfo) -> None:
        (finding,), address = examine(Heard(ADDRESS + "?frame=unity", 5.0), info)
        assert (finding.grade, finding.about) == (Grade.WRONG, "silence")
        assert "osc://0.0.0.0:9100?frame=unity" in finding.text
        assert address == ADDRESS + "?frame=unity"
        (finding,), _ = examine(Heard("serial:/dev/ttyUSB0", 5.0), info)
        assert "markerbridge devices" in finding.text

    def test_another_dialect_reads_it(self, info: ModelInfo) -> None:
        found = self.found(info, self.packets(address=ADDRESS + "?dialect=qtm"))
        assert found["wire"].options == {"dialect": "qtm"}
        assert found["address"].startswith(ADDRESS + "?dialect=qtm")

    def test_frames_without_their_layout(self, info: ModelInfo) -> None:
        found = self.found(info, self.packets()[1:])
        assert "layout" in found["wire"].text
        assert "no_layout 300" in found["wire"].text

    def test_rubbish(self, info: ModelInfo) -> None:
        rng = np.random.default_rng(0)
        rubbish = [Received(rng.bytes(40), 50 + n / 100, SENDER) for n in range(100)]
        assert "bad_osc" in self.found(info, rubbish)["wire"].text

    def test_another_rate_than_the_layouts(self, info: ModelInfo) -> None:
        slow = [Received(p.data, 50 + 2 * (p.t - 50), p.sender) for p in self.packets()]
        found = self.found(info, slow)
        assert "comes at 60.0" in found["layout-rate"].text
        assert "stamps gain 0.5" in found["stamps"].text

    def test_stamps_in_milliseconds(self, info: ModelInfo) -> None:
        encoder, _ = take_encoder(Url.parse(ADDRESS))
        received = [Received(encoder.encode_layout(self.LAYOUT), 50.0, SENDER)]
        xyz = np.ones((3, 3), np.float32)
        for n in range(300):
            packet = encoder.encode_frame(n, n * 1000 / 120, xyz)
            received.append(Received(packet, 50 + n / 120, SENDER))
        assert "1000 s in a second" in self.found(info, received)["stamps"].text

    def test_loss_and_damage(self, info: ModelInfo) -> None:
        packets = self.packets()
        packets = [p for n, p in enumerate(packets) if n == 0 or n % 10]
        packets.insert(40, Received(b"junk", packets[40].t, SENDER))
        found = self.found(info, packets)
        assert found["lost"].grade is Grade.POOR
        assert "29 of" in found["lost"].text
        assert "bad_osc 1" in found["damage"].text

    def test_late_frames_are_mended_by_a_buffer(self, info: ModelInfo) -> None:
        packets = self.packets()
        for n in range(20, 280, 20):
            packets[n], packets[n + 1] = (
                packets[n + 1]._replace(t=packets[n].t),
                packets[n]._replace(t=packets[n + 1].t),
            )
        found = self.found(info, packets)
        assert found["late"].options == {"reorder": "2"}
        assert found["address"] == ADDRESS + "?reorder=2"
        assert "lost" not in found

    def test_bursts(self, info: ModelInfo) -> None:
        bursts = [Received(p.data, 50 + (p.t - 50) // 0.2 * 0.2, SENDER) for p in self.packets()]
        assert "bursts" in self.found(info, bursts)["jitter"].text

    def test_a_second_sender(self, info: ModelInfo) -> None:
        packets = self.packets()
        others = [p._replace(sender="10.0.0.9:5", t=p.t + 0.001) for p in packets[::3]]
        everything = sorted(packets + others, key=lambda p: p.t)
        live = Heard(ADDRESS, 2.5, received=everything)
        live.counters["other_sender"] = len(others)
        findings, _ = examine(read_again(live, ADDRESS), info)
        by_about = {finding.about: finding for finding in findings}
        assert "allow=127.0.0.1" in by_about["senders"].text
        assert "duplicates" not in by_about  # the other's frames are not read

    def test_a_receive_buffer_that_is_too_small(self, info: ModelInfo) -> None:
        assert self.found(info, self.packets(), receive_buffer=20_000)["buffer"].grade is Grade.POOR
        found = self.found(info, self.packets(), receive_buffer=4 << 20)
        assert found["buffer"].grade is Grade.NOTE

    def test_a_clock_that_runs_off(self, info: ModelInfo) -> None:
        walk = self.packets(120 * 30)
        found = self.found(info, [p._replace(t=50 + (p.t - 50) * (1 + 1e-4)) for p in walk])
        assert found["clock"].grade is Grade.NOTE
        assert "loses 100 ppm" in found["clock"].text

    def test_listening_keeps_bytes_and_frames(self) -> None:
        clock = VirtualClock(50.0)
        host, device = memory_line(clock)
        source = WireSource(ADDRESS, lambda: host, NativeOscDecoder(), clock)
        for packet in self.packets():
            clock.call_at(packet.t, lambda data=packet.data: device.send(data))
        found = listen(source, 2.0, threading.Event())
        assert found.seconds == pytest.approx(2.0)
        assert len(found.received) == len(found.frames) + 1
        assert len(found.frames) == pytest.approx(240, abs=2)
        assert found.labels == self.LAYOUT.labels


def test_a_model_without_c7_judges_too(six_model: Model, data_dir: Path) -> None:
    tracked = six_model.info.tracked
    capture = read_c3d(data_dir / "real/07_01.c3d", tracked)
    xyz = capture.xyz[:200]
    assert diagnosis(six_model.info, capture.layout, xyz) == ([], {})
    _, options = diagnosis(six_model.info, capture.layout, FRAMES["unity"].from_ours(xyz))
    assert options == {"frame": "unity"}


def test_names_are_told_by_their_letters() -> None:
    wanted = ("LWRB", "RANK", "C7", "T10")
    assert by_name(wanted, ("lwrb", "c_7")) == {"lwrb": "LWRB", "c_7": "C7"}
    assert by_name(wanted, ("L_WRB", "ANK.Right")) == {"L_WRB": "LWRB", "ANK.Right": "RANK"}
    assert by_name(wanted, ("Q_LWRB", "Left WRB")) in ({"Q_LWRB": "LWRB"}, {"Left WRB": "LWRB"})
    assert by_name(wanted, ("ann:C7", "bob:C7", "bob:T10")) == {"bob:C7": "C7", "bob:T10": "T10"}
    assert by_name(wanted, ("FRANK", "DRANK", "1", "LWR", "C77")) == {}


def test_markers_that_nobody_wears_do_not_disturb_the_search_by_place(
    info: ModelInfo, data_dir: Path
) -> None:
    xyz = read_c3d(data_dir / CLIP, info.tracked).xyz[:300]
    ghosts = np.float32([[[3, 3, 0.1], [-2, 1, 2.5], [0, 4, 1]]]) + 0 * xyz[:, :3]
    found = by_place(BodyFit(info, info.tracked), np.concatenate([ghosts, xyz], axis=1))
    assert found is not None
    assert found[1] == tuple(range(3, 12))


def test_units_are_told_by_size() -> None:
    assert nearest_unit(0.0011) == 0.001
    assert nearest_unit(0.022) == UNITS["in"]
    assert nearest_unit(40.0) is None


def test_an_address_is_corrected_and_all_else_in_it_kept() -> None:
    address = "osc://:9100?dialect=vmc&axes=x,y,z&unit=mm"
    assert corrected(address, {"frame": "unity"}) == "osc://:9100?dialect=vmc&frame=unity"
    assert corrected(address, {"unit": "cm"}) == "osc://:9100?dialect=vmc&axes=x,y,z&unit=cm"
    assert corrected("serial:/dev/x", {}) == "serial:/dev/x"
    labels = {"labels": "a b&c:LWRB,Z%:RWRB"}
    assert Url.parse(corrected(address, labels)).options["labels"] == labels["labels"]
