"""What other programs send: each dialect read from messages that python-osc built, and written."""

from __future__ import annotations

import logging
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder

from drivers.convention import Convention
from drivers.frame import Layout, MarkerFrame
from drivers.url import Url, UrlError
from drivers.wire.codec import Decoder, Encoder
from drivers.wire.registry import take_decoder, take_encoder
from tests.drivers.strategies import frames, layouts, same_positions

DIALECTS = ("qtm", "natnet", "vmc", "vrchat")  # those without layouts
RATE = 120.0


def url(dialect: str, **options: str) -> Url:
    pairs = "".join(f"&{name}={value}" for name, value in options.items())
    return Url.parse(f"osc://127.0.0.1:9100?dialect={dialect}{pairs}")


def decoder_of(dialect: str, **options: str) -> Decoder:
    return take_decoder(url(dialect, **options))[0]


def encoder_of(dialect: str, *labels: str) -> Encoder:
    encoder, _ = take_encoder(url(dialect))
    assert encoder.encode_layout(Layout(labels, RATE)) == b""
    return encoder


def message(address: str, types: str, *values: object) -> bytes:
    builder = OscMessageBuilder(address)
    for tag, value in zip(types, values, strict=True):
        builder.add_arg(value, tag)
    return builder.build().dgram


def bundle(*messages: bytes) -> bytes:
    builder = OscBundleBuilder(IMMEDIATELY)
    packet = builder.build().dgram
    return packet + b"".join(len(each).to_bytes(4, "big") + each for each in messages)


def play(decoder: Decoder, *frames: list[bytes], rate: float = RATE) -> list[MarkerFrame]:
    """Reads the packets of each frame at its time."""
    read = []
    for i, packets in enumerate(frames):
        for packet in packets:
            read += decoder.feed(packet, i / rate)
    return read


def as_dict(frame: MarkerFrame) -> dict[str, tuple[float, ...] | None]:
    """Markers by label, None where missing."""
    return {
        label: None if np.isnan(row).any() else tuple(row.tolist())
        for label, row in zip(frame.layout.labels, frame.xyz, strict=True)
    }


# What a performer wears, as each dialect names it.
_NAMES = {"qtm": "M{}", "natnet": "M{}", "vmc": "M{}", "vrchat": "{}"}


@pytest.mark.parametrize("dialect", DIALECTS)
@given(st.data())
def test_every_frame_survives_the_wire(dialect: str, data) -> None:
    """Once the labels are believed; a frame without any marker is told by qtm alone."""
    layout = data.draw(layouts(9))
    layout = Layout(tuple(_NAMES[dialect].format(i + 1) for i in range(len(layout.labels))), RATE)
    if dialect == "vrchat" and len(layout.labels) == 9:
        layout = Layout((*layout.labels[:8], "head"), RATE)
    encoder, decoder = encoder_of(dialect, *layout.labels), decoder_of(dialect)
    whole = np.ones((len(layout.labels), 3), np.float32)
    play(decoder, *([encoder.encode_frame(i, i / RATE, whole)] for i in range(6)))
    assert decoder.layout is not None
    assert decoder.layout.labels == layout.labels
    index, _, xyz = data.draw(frames(layout))
    read = decoder.feed(encoder.encode_frame(index, 6 / RATE, xyz), 7.0)
    if np.isnan(xyz).any(axis=1).all() and dialect in ("vmc", "vrchat"):
        assert read == []
        return
    (frame,) = read
    assert same_positions(frame.xyz, xyz)
    assert frame.t == 7.0
    if dialect == "qtm":
        assert frame.index == index
    if dialect in ("qtm", "vmc"):
        assert frame.t_device == pytest.approx(6 / RATE, abs=1e-6)
    else:
        assert math.isnan(frame.t_device)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_python_osc_reads_what_is_written(dialect: str) -> None:
    encoder = encoder_of(dialect, "1", "2")
    packet = encoder.encode_frame(7, 2**32 / 1e6, np.float32([[1, 2, 3], [4, 5, 6]]))
    read = [(each.address, each.params) for each in OscBundle(packet)]
    rotation = [0.0, 0.0, 0.0, 1.0]
    assert (
        read
        == {
            "qtm": [
                ("/qtm/data", [1, 0, 0, 7, 0, 0, 2]),
                ("/qtm/3d/1", [1.0, 2.0, 3.0]),
                ("/qtm/3d/2", [4.0, 5.0, 6.0]),
            ],
            "natnet": [("/marker", [1, 1.0, 2.0, 3.0]), ("/marker", [2, 4.0, 5.0, 6.0])],
            "vmc": [
                ("/VMC/Ext/OK", [1]),
                ("/VMC/Ext/T", [pytest.approx(4294.967, abs=1e-3)]),
                ("/VMC/Ext/Tra/Pos", ["1", 1.0, 2.0, 3.0, *rotation]),
                ("/VMC/Ext/Tra/Pos", ["2", 4.0, 5.0, 6.0, *rotation]),
            ],
            "vrchat": [
                ("/tracking/trackers/1/position", [1.0, 2.0, 3.0]),
                ("/tracking/trackers/2/position", [4.0, 5.0, 6.0]),
            ],
        }[dialect]
    )


@pytest.mark.parametrize(
    ("dialect", "missing"),
    [("qtm", 2), ("natnet", 2), ("vmc", 1), ("vrchat", 1)],  # of two, how many are written
)
def test_a_missing_marker_is_written_as_the_program_does(dialect: str, missing: int) -> None:
    encoder = encoder_of(dialect, *(("1", "2") if dialect == "vrchat" else ("A", "B")))
    packet = encoder.encode_frame(0, 0.0, np.float32([[1, 2, 3], [np.nan] * 3]))
    markers = [each for each in OscBundle(packet) if len(each.params) > 2]
    markers = [each for each in markers if each.address != "/qtm/data"]
    assert len(markers) == missing
    if dialect == "qtm":
        assert np.isnan(markers[1].params).all()
    if dialect == "natnet":
        assert (markers[0].address, markers[0].params[:5]) == ("/rigidBody/A", [1, "A", 1, 2, 3])
        assert [each.params[-1] for each in markers] == [1, 0]  # tracked or not


def qtm_head(index: int, microseconds: int) -> bytes:
    words = divmod(microseconds, 1 << 32)
    low = words[1] - (1 << 32 if words[1] >= 1 << 31 else 0)
    return message("/qtm/data", "iiiiiii", words[0], low, 0, index, 0, 0, 1)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_device_whose_clock_runs_wild_is_written_all_the_same(dialect: str) -> None:
    encoder = encoder_of(dialect, "1")
    for t_device in (-5.0, 1e9, 1e12):
        assert len(encoder.encode_frame(2**40, t_device, np.ones((1, 3), np.float32))) > 16


@pytest.mark.parametrize("label", ["007", "1234567890", "-1", "١"])
def test_a_name_that_only_looks_like_a_number_is_a_body_of_natnet(label: str) -> None:
    encoder, decoder = encoder_of("natnet", label), decoder_of("natnet")
    packet = encoder.encode_frame(0, 0.0, np.ones((1, 3), np.float32))
    assert as_dict(play(decoder, *[[packet]] * 4)[-1]) == {label: (1.0, 1.0, 1.0)}


def test_qtm_time_and_frame_number_are_the_devices() -> None:
    decoder = decoder_of("qtm")
    marker = message("/qtm/3d/L Hand", "ffff", 1.0, 2.0, 3.0, 0.5)
    start = 3 << 31  # past the lower word, and its sign bit
    packets = ([bundle(qtm_head(100 + 2 * i, start + 10_000 * i), marker)] for i in range(6))
    read = play(decoder, *packets)
    assert [frame.index for frame in read] == [104, 106, 108, 110]
    assert read[-1].t_device == pytest.approx(start / 1e6 + 0.05, abs=1e-6)
    assert as_dict(read[-1]) == {"L Hand": (1.0, 2.0, 3.0)}


@pytest.mark.parametrize(
    ("types", "values"),
    [
        ("hiiiii", (5_000_000, 0, 42, 0, 0, 1)),  # until protocol 1.10
        ("iiiiiiiii", (0, 5_000_000, 0, 9, 9, 42, 0, 0, 1)),
    ],
)
def test_heads_of_other_versions_of_qtm_are_read(types: str, values: tuple[int, ...]) -> None:
    decoder = decoder_of("qtm")
    marker = message("/qtm/3d/A", "fff", 1.0, 2.0, 3.0)
    read = play(decoder, *[[bundle(message("/qtm/data", types, *values), marker)]] * 3)
    assert (read[0].index, read[0].t_device) == (42, 5.0)


def test_a_qtm_frame_whose_head_is_spoilt_takes_no_other_frames_number() -> None:
    decoder = decoder_of("qtm")
    marker = message("/qtm/3d/A", "fff", 1.0, 2.0, 3.0)
    good = [bundle(qtm_head(i, 0), marker) for i in range(5)]
    bad = bundle(message("/qtm/data", "iii", 0, 0, 4), marker)
    read = play(decoder, [*good[:4], bad, marker, good[4]])
    assert [frame.index for frame in read] == [2, 3, 4]
    assert decoder.counters["no_index"] == 2
    assert len(play(decoder, *[[marker]] * 100)) > 40  # another sender, which has no numbers


def test_what_qtm_says_is_counted_and_its_first_error_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    decoder = decoder_of("qtm")
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            decoder.feed(message("/qtm/error", "s", "Parse error"), 0.0)
        decoder.feed(message("/qtm/cmd_res", "s", "Connected"), 0.0)
        decoder.feed(message("/qtm/no_data", "N", None), 0.0)
    assert [record.getMessage() for record in caplog.records] == ["QTM says: 'Parse error'"]
    wanted = {"errors": 3, "answers": 1, "no_data": 1, "no_markers": 5}
    assert decoder.counters == wanted


NATNET = {
    "the bridge's markers": (
        "1",
        [bundle(message("/marker", "ifff", 1, 1.0, 2.0, 3.0))],
    ),
    "a body by its address": (
        "Rigid Body 1",
        [
            bundle(
                message(
                    "/rigidBody/Rigid Body 1",
                    "isfffffffffffffi",
                    *(4, "Rigid Body 1", 1.0, 2.0, 3.0, *[0.5] * 10, 1),
                )
            )
        ],
    ),
    "bodies at one address": (
        "Hand",
        [bundle(message("/rigidBody", "isfffffff", 4, "Hand", 1.0, 2.0, 3.0, *[0.5] * 4))],
    ),
    "one by one, for Max": (
        "12",
        [
            message("/frame/start", "i", 5),
            message("/marker", "isfff", 12, "position", 1.0, 2.0, 3.0),
            message("/marker", "isf", 12, "residual", 0.1),
            message("/frame/end", "i", 5),
        ],
    ),
    "a body's number, for Isadora": (
        "body7",
        [
            message("/rigidbody/7/tracked", "i", 1),
            message("/rigidbody/7/position", "fff", 1.0, 2.0, 3.0),
            message("/rigidbody/7/quat", "ffff", 0.0, 0.0, 0.0, 1.0),
        ],
    ),
    "for TouchDesigner": (
        "body7",
        [message("/rigidbody/7/transformation", "fffffff", 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)],
    ),
}


@pytest.mark.parametrize(("label", "packets"), NATNET.values(), ids=NATNET.keys())
def test_natnet_is_read_as_several_programs_send_it(label: str, packets: list[bytes]) -> None:
    decoder = decoder_of("natnet")
    read = play(decoder, *[packets] * 8)
    assert len(read) >= 5
    assert as_dict(read[-1]) == {label: (1.0, 2.0, 3.0)}
    assert not {"foreign", "bad_packet", "bad_osc"} & set(decoder.counters)


def test_a_bundled_natnet_frame_has_number_and_time() -> None:
    decoder = decoder_of("natnet")
    read = play(
        decoder,
        *(
            [
                bundle(
                    message("/frame/start", "i", 50 + i),
                    message("/frame/timestamp", "i", 1000 + 10 * i),
                    message("/marker/3/position", "fff", 1.0, 2.0, 3.0),
                    message("/frame/end", "i", 50 + i),
                )
            ]
            for i in range(4)
        ),
    )
    assert [(frame.index, frame.t_device) for frame in read] == [(52, 1.02), (53, 1.03)]


def test_a_body_that_is_not_tracked_is_missing() -> None:
    decoder = decoder_of("natnet")
    bodies = [
        bundle(message("/rigidBody/B", "isfffffffi", 1, "B", 1.0, 2.0, 3.0, *[0.0] * 4, tracked))
        for tracked in (1, 1, 1, 1, 0)
    ]
    read = play(decoder, *([body] for body in bodies))
    assert [as_dict(frame)["B"] for frame in read[-2:]] == [(1.0, 2.0, 3.0), None]


def device(kind: str, serial: str, x: float = 1.0) -> bytes:
    values = (serial, x, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
    return message(f"/VMC/Ext/{kind}/Pos", "sfffffff", *values)


def test_headset_controllers_and_trackers_are_vmc_markers() -> None:
    decoder = decoder_of("vmc")
    frame = [device("Hmd", "H"), device("Con", "C"), device("Tra", "腰")]
    noise = [
        message("/VMC/Ext/Bone/Pos", "sfffffff", "Hips", *[0.0] * 7),
        message("/VMC/Ext/Blend/Val", "sf", "あ", 0.5),
        device("Tra", "腰").replace(b"/VMC/Ext/Tra/Pos\0\0\0\0", b"/VMC/Ext/Tra/Pos/Local\0\0"),
    ]
    read = play(decoder, *[[bundle(*frame, *noise)]] * 5)
    assert as_dict(read[-1]) == dict.fromkeys(("H", "C", "腰"), (1.0, 2.0, 3.0))
    assert decoder.counters["foreign"] == 15


@pytest.mark.parametrize("together", [True, False])
def test_a_vmc_frame_in_several_bundles_or_messages_is_one_frame(together: bool) -> None:
    decoder = decoder_of("vmc")

    def packets(i: int) -> list[bytes]:
        time = message("/VMC/Ext/T", "f", i / 64)
        halves = [[time, device("Tra", "A", i)], [device("Tra", "B", i), device("Tra", "C", i)]]
        if together:
            return [bundle(*half) for half in halves]
        return [each for half in halves for each in half]

    read = play(decoder, *(packets(i) for i in range(30)), rate=64)
    assert len(read) >= 26
    for frame in read[-20:]:
        xs = {place and place[0] for place in as_dict(frame).values()}
        assert len(xs) == 1  # all three of one moment
        assert frame.t_device * 64 in xs


def test_a_vmc_clock_that_stands_still_is_no_clock() -> None:
    """Seconds since 1970 in a float32 move on by 128 at a time."""
    decoder = decoder_of("vmc")
    packet = bundle(message("/VMC/Ext/T", "f", 1.7e9), device("Tra", "A"))
    read = play(decoder, *[[packet]] * 8)
    assert [math.isnan(frame.t_device) for frame in read[1:]] == [True] * (len(read) - 1)


def test_a_performer_that_is_not_ready_is_counted() -> None:
    decoder = decoder_of("vmc")
    decoder.feed(bundle(message("/VMC/Ext/OK", "iii", 0, 3, 0)), 0.0)
    decoder.feed(bundle(message("/VMC/Ext/OK", "i", 1)), 0.0)
    assert decoder.counters == {"not_ready": 1, "no_markers": 2}


@pytest.mark.parametrize("together", [True, False])
def test_vrchat_trackers_come_one_by_one_or_together(together: bool) -> None:
    decoder = decoder_of("vrchat")
    places = ("head", "1", "2", "3")

    def packets(i: int) -> list[bytes]:
        each = [
            message(f"/tracking/trackers/{place}/{what}", "fff", float(i), 0.0, 1.0)
            for place in places
            for what in ("position", "rotation")
        ]
        return [bundle(*each)] if together else each

    read = play(decoder, *(packets(i) for i in range(20)))
    assert len(read) >= 16
    for frame in read[-10:]:
        assert len(set(as_dict(frame).values())) == 1
    assert set(read[-1].layout.labels) == set(places)
    assert "foreign" not in decoder.counters


def test_whole_numbers_and_doubles_are_taken_for_floats() -> None:
    decoder = decoder_of("vrchat")
    packet = message("/tracking/trackers/1/position", "idf", 1, 2.0, 3.0)
    assert as_dict(play(decoder, *[[packet]] * 6)[-1]) == {"1": (1.0, 2.0, 3.0)}
    huge = message("/tracking/trackers/1/position", "dff", 1e300, 2.0, 3.0)
    assert as_dict(play(decoder, *[[huge]] * 6)[-1]) == {"1": None}


def test_vrchat_has_nine_places() -> None:
    encoder, _ = take_encoder(url("vrchat"))
    labels = tuple(f"m{i}" for i in range(9))
    encoder.encode_layout(Layout(labels, RATE))
    packet = encoder.encode_frame(0, 0.0, np.ones((9, 3), np.float32))
    places = [each.address.split("/")[3] for each in OscBundle(packet)]
    assert places == ["1", "2", "3", "4", "5", "6", "7", "8", "head"]
    for wrong in ((*labels, "one more"), ("1", "head", "LFHD")):
        with pytest.raises(ValueError, match="nine markers at most, or name them all"):
            encoder.encode_layout(Layout(wrong, RATE))


@pytest.mark.parametrize("dialect", ["qtm", "natnet"])
@pytest.mark.parametrize("label", ["L*", "[1]", "a\nb", "x" * 201])
def test_labels_that_an_address_cannot_hold_are_refused(dialect: str, label: str) -> None:
    encoder, _ = take_encoder(url(dialect))
    with pytest.raises(ValueError, match="a name here is at most 200 letters"):
        encoder.encode_layout(Layout((label,), RATE))


@pytest.mark.parametrize(
    ("dialect", "packet"),
    [
        ("qtm", message("/qtm/3d/A", "ff", 1.0, 2.0)),
        ("qtm", message("/qtm/3d/A", "fffff", 1.0, 2.0, 3.0, 4.0, 5.0)),
        ("qtm", message("/qtm/3d/A", "ffs", 1.0, 2.0, "x")),
        ("qtm", message("/qtm/3d/", "fff", 1.0, 2.0, 3.0)),
        ("qtm", message("/qtm/data", "iiii", 1, 2, 3, 4)),
        ("qtm", message("/qtm/data", "iiiiiif", 1, 2, 3, 4, 5, 6, 7.0)),
        ("qtm", message("/qtm/data", "", *())),
        ("natnet", message("/marker", "", *())),
        ("natnet", message("/marker", "i", 1)),
        ("natnet", message("/marker", "sfff", "1", 1.0, 2.0, 3.0)),
        ("natnet", message("/marker", "isff", 1, "position", 1.0, 2.0)),
        ("natnet", message("/marker/1/position", "ff", 1.0, 2.0)),
        ("natnet", message("/rigidBody/A", "isfff", 1, "A", 1.0, 2.0, 3.0)),
        ("natnet", message("/rigidBody/A", "isfffffff", 1, "", *[1.0] * 7)),
        ("natnet", message("/frame/start", "s", "x")),
        ("vmc", message("/VMC/Ext/Tra/Pos", "sfff", "A", 1.0, 2.0, 3.0)),
        ("vmc", message("/VMC/Ext/Tra/Pos", "ffffffff", *[1.0] * 8)),
        ("vmc", message("/VMC/Ext/Tra/Pos", "sfffffff", "a\nb", *[1.0] * 7)),
        ("vmc", message("/VMC/Ext/Tra/Pos", "sfffffff", "a" * 256, *[1.0] * 7)),
        ("vmc", message("/VMC/Ext/T", "ff", 1.0, 2.0)),
        ("vrchat", message("/tracking/trackers/1/position", "ffff", *[1.0] * 4)),
        ("vrchat", message("/tracking/trackers/head/position", "", *())),
    ],
)
def test_what_is_not_as_it_must_be_is_counted(dialect: str, packet: bytes) -> None:
    decoder = decoder_of(dialect)
    assert decoder.feed(packet, 0.0) == []
    assert decoder.counters == {"bad_packet": 1, "no_markers": 1}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_what_is_of_another_program_is_foreign(dialect: str) -> None:
    decoder = decoder_of(dialect)
    for address in ("/tracking/trackers/9/position", "/qtm/6d/A", "/VMC/Ext/Bone/Pos", "/rb"):
        decoder.feed(message(address, "f", 1.0), 0.0)
    assert decoder.counters == {"foreign": 4, "no_markers": 4}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_line_that_was_found_again_starts_without_a_layout(dialect: str) -> None:
    encoder, decoder = encoder_of(dialect, "1", "2"), decoder_of(dialect)
    xyz = np.ones((2, 3), np.float32)
    play(decoder, *([encoder.encode_frame(i, i / RATE, xyz)] for i in range(6)))
    assert decoder.layout is not None
    decoder.reset()
    assert decoder.layout is None


@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_rate_is_measured_or_given(dialect: str) -> None:
    encoder = encoder_of(dialect, "1", "2")
    xyz = np.ones((2, 3), np.float32)
    packets = [[encoder.encode_frame(i, i / 60, xyz)] for i in range(200)]
    measured, given_ = decoder_of(dialect), decoder_of(dialect, rate="90")
    for decoder, rate in ((measured, 60.0), (given_, 90.0)):
        play(decoder, *packets, rate=60)
        assert decoder.layout is not None
        assert decoder.layout.rate == rate
    for wrong in ("0", "fast", "1e6"):
        with pytest.raises(UrlError, match=f"rate={wrong} is wrong"):
            decoder_of(dialect, rate=wrong)


def test_each_dialect_knows_its_world() -> None:
    """One metre ahead, and two up, of ours."""
    ours = np.float32([[0.5, 1.0, 2.0]])
    theirs = {
        "qtm": (500.0, 1000.0, 2000.0),
        "natnet": (0.5, 2.0, -1.0),
        "vmc": (0.5, 2.0, 1.0),
        "vrchat": (0.5, 2.0, 1.0),
    }
    for dialect, there in theirs.items():
        convention: Convention = take_decoder(url(dialect))[1]
        np.testing.assert_allclose(convention.xyz_in(np.float32([there])), ours, rtol=1e-6)


def test_a_bad_control_address_is_refused_in_plain_words() -> None:
    for wrong in ("a/b", ":5", "host:0", "host:x"):
        with pytest.raises(UrlError, match=f"control={wrong} is wrong"):
            decoder_of("qtm", control=wrong)
    address = url("vmc", control="localhost")
    take_decoder(address)
    with pytest.raises(UrlError, match="unknown option control"):
        address.finish()
