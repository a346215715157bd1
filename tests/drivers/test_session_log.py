"""The black box: whole whatever happens to it, and played back as it was."""

from __future__ import annotations

import json
import math
import random
import resource
import struct
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from drivers.clock import VirtualClock
from drivers.frame import Layout, MarkerFrame, Source, SourceError
from drivers.log_source import LogSource
from drivers.registry import open_source
from drivers.session_log import (
    FOUND,
    LOST,
    OPENED,
    Entry,
    LineBytes,
    LineEvent,
    LoggedPose,
    LogWriter,
    SessionLog,
)
from drivers.transport import Received
from drivers.url import UrlError
from drivers.wire.cobs import CobsEncoder
from drivers.wire.osc_native import NativeOscEncoder

LAYOUT = Layout(("C7", "LSHO", "RSHO"), 120.0)
ADDRESS = "serial:/dev/ttyUSB0?baud=115200&codec=cobs"
START = 5000.123456789


def moment(index: int, start: float = START) -> float:
    """When frame `index` comes at 120 Hz, as a clock of nanoseconds tells."""
    return round((start + index / 120) * 1e9) / 1e9


def xyz(index: int) -> np.ndarray:
    places = np.random.default_rng(index).normal(size=(3, 3)).astype(np.float32)
    if index % 4 == 0:
        places[index % 3] = np.nan
    return places


def frame(index: int, layout: Layout = LAYOUT) -> MarkerFrame:
    t = moment(index) if index < 1e6 else START
    return MarkerFrame(index, t, index / 120, layout, xyz(index)[: len(layout.labels)], t - 0.001)


def pose(index: int) -> LoggedPose:
    sigma = np.full(3, np.inf if index == 0 else 0.01 * index, np.float32)
    kinds = np.array([0, index % 4, 2], np.uint8)
    return LoggedPose(index, moment(index), LAYOUT, xyz(index), kinds, sigma)


def written(path: Path, *entries: Entry) -> Path:
    log = LogWriter(path, "markerbridge test")
    for entry in entries:
        log.add(entry)
    log.close()
    return path


def packets(count: int, start: float = START) -> list[Entry]:
    """A cobs line: its opening, its layout and `count` frames at 120 Hz."""
    encoder = CobsEncoder()
    layout = encoder.encode_layout(LAYOUT)
    return [
        LineEvent("source", start, OPENED, ADDRESS),
        LineBytes("source", Received(layout, start)),
        *(
            LineBytes(
                "source", Received(encoder.encode_frame(i, i / 120, xyz(i)), moment(i, start))
            )
            for i in range(count)
        ),
    ]


def played(address: str, clock: VirtualClock) -> tuple[Source, list[MarkerFrame]]:
    source = open_source(address, clock)
    return source, list(source)


def test_what_is_written_is_read_back_to_the_bit_and_the_nanosecond(tmp_path: Path) -> None:
    other = Layout(("LTOE",), 59.94)
    lines = [
        Received(b"\0\xff two \0 zeros", START, "10.0.0.7:40312"),
        Received(b"", START + 1e-9),
        Received(bytes(range(256)) * 255, START + 12345.678901234, "[::1]:9"),
    ]
    unstamped = MarkerFrame(7, START, math.nan, LAYOUT, xyz(7))
    frames = [frame(0), frame(1), frame(2, other), frame(2**40), unstamped]
    poses = [pose(i) for i in range(5)]
    path = written(
        tmp_path / "a.mcap",
        LineEvent("source", START, OPENED, ADDRESS),
        *(LineBytes("source", line) for line in lines),
        LineEvent("source", START, LOST),
        LineEvent("source", START, FOUND),
        *frames,
        *poses,
    )
    log = SessionLog(path)
    assert log.sources == {"source": ADDRESS}
    assert log.facts["format"] == "1"
    assert list(log.lines("source")) == [
        *(LineBytes("source", line) for line in lines),
        LineEvent("source", START, LOST),
        LineEvent("source", START, FOUND),
    ]
    for got, put in zip(log.frames(), frames, strict=True):
        assert (got.index, got.t, got.layout) == (put.index, put.t, put.layout)
        np.testing.assert_equal(got.t_device, put.t_device)
        mapped = put.t if math.isnan(put.t_mapped) else put.t_mapped
        assert got.t_mapped == pytest.approx(mapped, abs=1e-9)
        np.testing.assert_array_equal(got.xyz, put.xyz)
    for one, two in zip(log.poses(), poses, strict=True):
        assert (one.index, one.t, one.layout) == (two.index, two.t, two.layout)
        for name in ("xyz", "provenance", "sigma"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_the_mcap_library_reads_it(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", *packets(20), *(frame(i) for i in range(20)), pose(0))
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        topics = {channel.topic: channel for channel in summary.channels.values()}
        assert sorted(topics) == ["events/source", "frames", "poses", "raw/source"]
        assert topics["raw/source"].metadata == {"address": ADDRESS}
        assert json.loads(topics["frames"].metadata["labels"]) == list(LAYOUT.labels)
        found = list(reader.iter_messages())
        assert len(found) == summary.statistics.message_count == 1 + 21 + 20 + 1
        assert {schema.name for schema, _, _ in found if schema} == {
            "markerbridge.Event",
            "markerbridge.Received",
            "markerbridge.Frame",
            "markerbridge.Pose",
        }
        ((name, metadata),) = [(one.name, one.metadata) for one in reader.iter_metadata()]
        assert name == "session"
        assert int(metadata["epoch_ns"]) == pytest.approx(time.time_ns(), abs=60e9)


@pytest.mark.parametrize("compression", CompressionType)
def test_a_log_that_another_tool_wrote_anew_in_chunks_reads_the_same(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = written(tmp_path / "a.mcap", *packets(50), *(frame(i) for i in range(50)))
    again = tmp_path / "b.mcap"
    with path.open("rb") as file:
        reader = make_reader(file)
        writer = Writer(str(again), chunk_size=2000, compression=compression)
        writer.start(profile=reader.get_header().profile, library="another")
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, number, channel.metadata
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.finish()
    one, two = SessionLog(path), SessionLog(again)
    assert one.holds == two.holds
    for got, put in zip(two.frames(), one.frames(), strict=True):
        assert got.t - two.start == pytest.approx(put.t - one.start, abs=1e-6)
        np.testing.assert_array_equal(got.xyz, put.xyz)


def whole_and_read(path: Path) -> tuple[int, int]:
    """How many bytes' records and frames a file gives, read in every way."""
    log = SessionLog(path)
    lines = [entry for name in log.sources for entry in log.lines(name)]
    list(log.poses())
    return len(lines), sum(1 for _ in log.frames())


def test_cut_anywhere_it_gives_what_was_whole_and_says_so_once(tmp_path: Path, caplog) -> None:
    entries = packets(9)
    for index in range(9):
        entries.insert(3 + 2 * index, frame(index))
    path = written(tmp_path / "a.mcap", *entries)
    content = path.read_bytes()
    opened = f'{ADDRESS}"}}'.encode()
    first = content.index(opened) + len(opened)  # where the first message ends
    best = whole_and_read(path)
    assert best == (10, 9)
    before = (0, 0)
    for length in range(0, len(content), 7):
        (tmp_path / "cut.mcap").write_bytes(content[:length])
        caplog.clear()
        if length < first:  # before the first message
            with pytest.raises(SourceError, match=rf"^{tmp_path / 'cut.mcap'} "):
                SessionLog(tmp_path / "cut.mcap")
            continue
        found = whole_and_read(tmp_path / "cut.mcap")
        assert before <= found <= best
        assert len(caplog.records) <= 1
        before = found
    assert before == best


@settings(max_examples=100, deadline=500)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12))
def test_damaged_files_give_an_error_or_what_can_be_read(tmp_path_factory, seed, count) -> None:
    folder = tmp_path_factory.getbasetemp()
    path = folder / "damaged.mcap"
    path.unlink(missing_ok=True)
    written(path, *packets(20), *(frame(i) for i in range(5)), *(pose(i) for i in range(5)))
    chance = random.Random(seed)
    content = bytearray(path.read_bytes())
    for _ in range(count):
        at = chance.randrange(8, len(content))
        content[at] = chance.randrange(256)
    path.write_bytes(content)
    said = ""
    try:
        whole_and_read(path)
        list(open_source(f"log:{path}?speed=max", VirtualClock()))
    except (SourceError, UrlError) as error:
        said = str(error)
    assert not said or (str(path) in said and "\n" not in said)


def test_lengths_that_a_hostile_file_makes_up_take_no_memory(tmp_path: Path) -> None:
    import zstandard

    whole = written(tmp_path / "a.mcap", *packets(3)).read_bytes()
    bomb = zstandard.compress(bytes(500 << 20))  # of a size that the bytes themselves tell
    head = struct.pack("<QQQI", 0, 0, 500 << 20, 0) + b"\4\0\0\0zstd"
    modest = struct.pack("<QQQI", 0, 0, 1000, 0) + b"\4\0\0\0zstd"
    size = struct.pack("<Q", len(bomb))
    chunks = [head + size + bomb, modest + size + bomb]
    records = [b"\6" + struct.pack("<Q", len(chunk)) + chunk for chunk in chunks]
    liar = b"\5" + struct.pack("<Q", 2**63) + b"x"
    metadata = b"\x0c" + struct.pack("<QI", 4, 2**32 - 1)
    tracemalloc.start()
    try:
        for name, more in (("liar", liar), ("bombs", b"".join(records)), ("meta", metadata)):
            path = tmp_path / f"{name}.mcap"
            at = whole.index(b"\x0f" + struct.pack("<Q", 4))  # where the data ends
            path.write_bytes(whole[:at] + more)
            assert whole_and_read(path) == (4, 0)
        assert tracemalloc.get_traced_memory()[1] < 20 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty: markerbridge writes one with --to log:FILE"),
        (b"not a log\n" * 100, "is no MCAP file"),
        (b"\x89MCAP0\r\n", "is an MCAP file, but not one that markerbridge recorded"),
        (b"\x89MCAP0\r\n\x01\x0c\0\0\0\0\0\0\0\4\0\0\0ros2\0\0\0\0", "not one that markerbridge"),
    ],
)
def test_what_is_no_log_is_named(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(SourceError) as caught:
        open_source(f"log:{tmp_path / 'x.mcap'}")
    assert str(caught.value).startswith(str(tmp_path / "x.mcap"))
    assert words in str(caught.value)


def test_a_log_that_is_not_there_or_a_folder_is_named(tmp_path: Path) -> None:
    for path in (tmp_path / "absent.mcap", tmp_path):
        with pytest.raises(SourceError, match=f"cannot read {path}: "):
            open_source(f"log:{path}")


@contextmanager
def full_at(size: int) -> Iterator[None]:
    """No file of this process can grow beyond `size` bytes: the disk is full there."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_costs_what_does_not_fit_and_the_log_says_so(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "a.mcap", "test")
    entries = packets(30)
    for entry in entries[:10]:
        log.add(entry)
    size = (tmp_path / "a.mcap").stat().st_size
    refused = 0
    with full_at(size + 50):  # in the middle of a record
        for entry in entries[10:20]:
            with pytest.raises(OSError, match="File too large"):
                log.add(entry)
            refused += 1
        assert (tmp_path / "a.mcap").stat().st_size == size
        assert len(list(SessionLog(tmp_path / "a.mcap").lines("source"))) == 9
    for entry in entries[20:]:
        log.add(entry)
    log.close()
    read = SessionLog(tmp_path / "a.mcap")
    assert list(read.lines("source")) == [*entries[1:10], *entries[20:]]
    with (tmp_path / "a.mcap").open("rb") as file:
        notes = [m.data for _, c, m in make_reader(file).iter_messages() if c.topic == "events/log"]
    assert [json.loads(note) for note in notes] == [{"event": "gap", "records": refused}]


def test_a_disk_that_stays_full_leaves_a_log_that_can_be_read(tmp_path: Path, caplog) -> None:
    log = LogWriter(tmp_path / "a.mcap", "test")
    for entry in packets(10):
        log.add(entry)
    size = (tmp_path / "a.mcap").stat().st_size
    with full_at(size + 20), pytest.raises(OSError, match="File too large"):
        log.close()
    log.close()
    assert (tmp_path / "a.mcap").stat().st_size == size
    assert len(played(f"log:{tmp_path / 'a.mcap'}?speed=max", VirtualClock())[1]) == 10
    assert not caplog.records  # it ends with a whole record


def test_played_from_now_on_spaced_as_it_was(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", *packets(240))
    clock = VirtualClock(77.0)
    source = open_source(f"log:{path}", clock)
    assert isinstance(source, LogSource)
    assert not source.live
    assert source.read(0.0) is not None  # the layout and frame 0 are due at once
    for index in range(1, 240):
        got = source.read(1.0)
        assert got is not None
        assert (got.index, got.t_device) == (index, pytest.approx(index / 120, abs=1e-6))
        assert got.t == pytest.approx(77.0 + index / 120, abs=1e-9)
        assert clock.now() == pytest.approx(got.t, abs=1e-9)
        np.testing.assert_array_equal(got.xyz, xyz(index))
    assert source.read(1.0) is None
    assert source.exhausted
    assert source.counters["frames"] == 240


@pytest.mark.parametrize(("speed", "seconds"), [("max", 0.0), ("4", 0.5), ("1", 2.0)])
def test_the_speed_is_that_of_playing_and_not_of_the_frames(tmp_path, speed, seconds) -> None:
    path = written(tmp_path / "a.mcap", *packets(241))
    clock = VirtualClock(1.0)
    _, frames = played(f"log:{path}?speed={speed}", clock)
    assert clock.now() - 1.0 == pytest.approx(seconds, abs=1e-6)
    np.testing.assert_allclose([f.t for f in frames], 1.0 + np.arange(241) / 120, atol=1e-9)


def test_at_its_own_time_it_is_played_to_the_bit(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", *packets(100), *(frame(i) for i in range(100)))
    _, frames = played(f"log:{path}?speed=max", VirtualClock(SessionLog(path).start))
    assert [f.t for f in frames] == [moment(i) for i in range(100)]


def test_a_line_that_was_lost_is_lost_again_and_forgets_the_layout_again(tmp_path: Path) -> None:
    before, after = packets(10), packets(30, START + 3.0)
    path = written(
        tmp_path / "a.mcap",
        *before,
        LineBytes("source", Received(b"\1\2 half a packet", START + 1.0)),
        LineEvent("source", START + 1.0, LOST),
        LineEvent("source", START + 2.5, FOUND),
        after[12],  # a frame before the layout of the device that is back
        after[1],
        *after[13:],
    )
    for speed in ("1", "max"):
        source, frames = played(f"log:{path}?speed={speed}", VirtualClock())
        assert [f.index for f in frames] == [*range(10), *range(11, 30)]
        counters = source.counters
        assert (counters["disconnects"], counters["reconnects"]) == (1, 1)
        assert counters["no_layout"] == 1
        assert not any(name.startswith("bad_") for name in counters)


def test_a_log_that_ends_while_the_line_is_lost_ends(tmp_path: Path) -> None:
    lost = [*packets(3), LineEvent("source", START + 1.0, LOST)]
    for more in ([], [LineEvent("source", START + 9.0, FOUND)]):
        path = written(tmp_path / f"{len(more)}.mcap", *lost, *more)
        source, frames = played(f"log:{path}", VirtualClock())
        assert len(frames) == 3
        assert source.exhausted


def test_options_of_the_recorded_address_hold_and_the_logs_own_come_before_them(
    tmp_path: Path,
) -> None:
    entries = packets(4)
    late = [entries[2], entries[4], entries[3], entries[5]]
    recorded = f"{ADDRESS}&reorder=2&labels=C7:LTOE&frame=unity"
    opened = LineEvent("source", START, OPENED, recorded)
    path = written(tmp_path / "a.mcap", opened, entries[1], *late)
    source, frames = played(f"log:{path}?speed=max", VirtualClock())
    assert [f.index for f in frames] == [0, 1, 2, 3]
    assert frames[0].layout.labels == ("LTOE", "LSHO", "RSHO")
    np.testing.assert_array_equal(frames[1].xyz, xyz(1)[:, [0, 2, 1]])
    assert isinstance(source, LogSource)
    assert source.address == recorded
    source, frames = played(f"log:{path}?speed=max&labels=C7:RTOE&reorder=0", VirtualClock())
    assert [f.index for f in frames] == [0, 2, 3]
    assert frames[0].layout.labels == ("RTOE", "LSHO", "RSHO")
    assert isinstance(source, LogSource)
    assert source.address.endswith("labels=C7:RTOE&frame=unity")


def test_of_several_sources_the_first_that_is_not_the_truth_is_played(tmp_path: Path) -> None:
    encoder = NativeOscEncoder()
    other = Layout(("LTOE",), 100.0)
    sent = [encoder.encode_layout(other), encoder.encode_frame(5, 0.5, xyz(1)[:1])]
    path = written(
        tmp_path / "a.mcap",
        LineEvent("truth", START, OPENED, "osc://127.0.0.1:9100"),
        *(LineBytes("truth", Received(data, START, "127.0.0.1:5")) for data in sent),
        *packets(2),
    )
    assert played(f"log:{path}", VirtualClock())[1][0].layout == LAYOUT
    assert played(f"log:{path}?source=truth", VirtualClock())[1][0].layout == other


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("speed=0.5", "option speed=0.5 is wrong: it is a factor from 1 on, or max"),
        ("speed=fast", "option speed=fast is wrong"),
        ("speed=nan", "option speed=nan is wrong"),
        ("source=Ann", "option source=Ann is wrong: the log has source"),
        ("spede=2", "unknown option spede (known: speed, source, codec"),
        ("baud=9600", "unknown option baud"),
        ("codec=morse", "option codec=morse is wrong: known are cobs"),
        ("labels=C7", "option labels=C7 is wrong"),
    ],
)
def test_options_that_cannot_be_meant_are_refused(tmp_path: Path, options, words) -> None:
    path = written(tmp_path / "a.mcap", *packets(1))
    with pytest.raises(UrlError) as caught:
        open_source(f"log:{path}?{options}")
    assert str(caught.value).startswith(f"'log:{path}?{options}': ")
    assert words in str(caught.value)


def test_of_two_senders_the_same_one_is_read_again(tmp_path: Path) -> None:
    encoder = NativeOscEncoder()
    layout = encoder.encode_layout(LAYOUT)
    entries: list[Entry] = [LineEvent("source", START, OPENED, "osc://127.0.0.1:9100")]
    for i in range(20):
        for sender in ("10.0.0.1:7", "10.0.0.2:7"):
            for data in (layout, encoder.encode_frame(i, 0.0, xyz(i + len(entries)))):
                entries.append(LineBytes("source", Received(data, START + i / 100, sender)))
    path = written(tmp_path / "a.mcap", *entries)
    source, frames = played(f"log:{path}?speed=max", VirtualClock())
    assert [f.index for f in frames[-15:]] == list(range(5, 20))
    assert source.counters["other_sender"] > 30


def test_a_log_without_bytes_plays_its_frames(tmp_path: Path) -> None:
    other = Layout(("LTOE",), 120.0)
    frames = [frame(0), frame(1), frame(5, other)]
    path = written(tmp_path / "a.mcap", LineEvent("source", START, OPENED, "c3d:a.c3d"), *frames)
    clock = VirtualClock(9.0)
    source, got = played(f"log:{path}", clock)
    assert source.labels == ("LTOE",)
    assert clock.now() == pytest.approx(9.0 + 5 / 120)
    for one, put in zip(got, frames, strict=True):
        assert (one.index, one.t_device, one.layout) == (put.index, put.t_device, put.layout)
        assert one.t == pytest.approx(put.t - START + 9.0, abs=1e-9)
        assert one.t_mapped == pytest.approx(put.t_mapped - START + 9.0, abs=2e-9)
        np.testing.assert_array_equal(one.xyz, put.xyz)
    poses = written(tmp_path / "b.mcap", pose(0))
    with pytest.raises(SourceError, match="holds neither bytes nor frames of a source"):
        open_source(f"log:{poses}")


def test_a_log_without_a_record_is_removed_and_one_that_is_there_is_kept(tmp_path: Path) -> None:
    written(tmp_path / "empty.mcap")
    assert list(tmp_path.iterdir()) == []
    path = written(tmp_path / "a.mcap", *packets(1))
    content = path.read_bytes()
    with pytest.raises(FileExistsError):
        LogWriter(path, "test")
    assert path.read_bytes() == content
