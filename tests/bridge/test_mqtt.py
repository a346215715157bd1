"""Poses to a real broker, Mosquitto, and from it to a reader of another make."""

from __future__ import annotations

import logging
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bridge.pose import Pose
from bridge.sinks.outlet import Outlet
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import Sink, SinkError
from drivers.c3d_file import write_c3d
from drivers.clock import SYSTEM_CLOCK
from drivers.udp_sender import AddressError
from drivers.url import UrlError
from drivers.wire.osc_native import NativeOscDecoder
from simulators.performer import load_performer
from tests.bridge.mosquitto import Broker, Subscriber
from tests.bridge.poses import CONTEXT, INFO, lost, made, pose, read, standing, unknown
from tests.end_to_end.peers import running, wait_for

POSE, LAYOUT, STATE = (f"markerbridge/{name}" for name in ("pose", "layout", "state"))


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with Broker(tmp_path) as there:
        yield there


def address(broker: Broker, rest: str = "") -> str:
    return f"mqtt://127.0.0.1:{broker.port}{rest}"


def refusal(sink: Sink, each: Pose) -> str:
    """Why the sink does not take a pose; nothing where it does."""
    try:
        sink(each)
    except SinkError as error:
        return str(error)
    return ""


def test_a_foreign_reader_gets_the_bytes_of_osc(broker: Broker) -> None:
    poses = [pose(i, 50 + i / 120, seed=i) for i in range(20)]
    options = "?frame=unity&unit=cm&uncertain=hide"
    (layout, first), *others = made(f"osc://127.0.0.1:1{options}", *poses)[:20]
    expected = [first, *(datagram for (datagram,) in others)]
    with Subscriber(broker) as reader:
        sink = open_sink(address(broker, options), CONTEXT)
        heard = reader.until(STATE, b"lost")
        for each in poses:
            sink(each)
        sink.close()
        sink.close()
        heard += reader.until(STATE, b"lost")
    assert [payload for topic, _, payload in heard if topic == POSE] == expected
    assert [payload for topic, _, payload in heard if topic == LAYOUT] == [layout]
    assert [payload for topic, _, payload in heard if topic == STATE] == [b"lost", b"live", b"lost"]
    assert not any(retained for _, retained, _ in heard)  # all is new


def test_who_comes_later_has_layout_and_state_at_once(broker: Broker) -> None:
    sink = open_sink(address(broker, "/stage/left?labels=neck:C7"), CONTEXT)
    sink(standing())
    with Subscriber(broker, "stage/left/#") as reader:
        retained = {topic: rest for topic, *rest in (reader.next(), reader.next())}
        assert retained["stage/left/state"] == [True, b"live"]
        is_old, layout = retained["stage/left/layout"]
        decoder = NativeOscDecoder()
        decoder.feed(layout, 0.0)
        assert is_old
        assert decoder.layout is not None
        assert decoder.layout.rate == CONTEXT.rate
        names = [label if label != "C7" else "neck" for label in INFO.labels]
        assert list(decoder.layout.labels) == names
        sink(standing(61))
        topic, is_old, payload = reader.next()
        assert (topic, is_old, read([payload])[0][1][0]) == ("stage/left/pose", False, 61)
    sink.close()


def test_the_state_says_whether_there_is_a_pose_and_the_layout_follows(broker: Broker) -> None:
    context = replace(CONTEXT)
    sink = open_sink(address(broker), context)
    with Subscriber(broker) as reader:
        reader.until(STATE, b"lost")
        sink(unknown())
        sink(standing(1))
        sink(lost(standing(2), 51.0))
        context.rate = 240.0
        sink(standing(3))
        sink.close()
        heard = reader.until(STATE, b"live") + reader.until(STATE, b"lost")
        heard += reader.until(STATE, b"live") + reader.until(STATE, b"lost")
    assert [topic.removeprefix("markerbridge/") for topic, _, _ in heard] == [
        *("layout", "pose", "state", "pose", "state", "pose"),
        *("layout", "state", "pose", "state"),
    ]


def test_each_performer_has_topics_of_his_own(broker: Broker) -> None:
    context = replace(CONTEXT, performer="ann")
    with Subscriber(broker) as reader:
        open_sink(address(broker), context).close()
        assert reader.next()[0] == "markerbridge/ann/state"


def test_a_bridge_that_is_killed_is_lost(broker: Broker, tmp_path: Path) -> None:
    walker = load_performer("walk")
    clip = tmp_path / "walk.c3d"
    write_c3d(clip, walker.layout, np.stack([walker.pose(index) for index in range(1200)]))
    with (
        Subscriber(broker, POSE) as poses,
        Subscriber(broker, STATE) as states,
        running("run", f"c3d:{clip}", "--to", address(broker)) as bridge,
    ):
        states.until(STATE, b"live")
        for _ in range(20):
            poses.next()
        bridge.process.kill()
        assert states.next() == (STATE, False, b"lost")


def test_a_broker_may_come_late_go_and_come_back(broker: Broker, caplog) -> None:
    broker.kill()
    sink = open_sink(address(broker), CONTEXT)
    outlet = Outlet(sink, SYSTEM_CLOCK)
    longest = 0.0

    def put(index: int) -> int:
        nonlocal longest
        began = time.monotonic()
        outlet.put(standing(index, 50 + index / 120))
        longest = max(longest, time.monotonic() - began)
        return outlet.counters["sent"]

    assert put(0) == 0
    assert outlet.last_error == "no connection to the broker: Connection refused"
    for _ in range(2):
        broker.start()
        before = outlet.counters["sent"]
        wait_for(lambda before=before: put(1) > before, "poses to flow", 5)
        with Subscriber(broker) as reader:  # what is retained was told again
            assert {reader.next()[:2], reader.next()[:2]} == {(STATE, True), (LAYOUT, True)}
            put(2)
            assert read([reader.next()[2]])[0][1][0] == 2
        broker.kill()
        before = outlet.counters["errors"]
        wait_for(lambda before=before: put(3) and outlet.counters["errors"] > before, "an error", 5)
    outlet.close()
    assert longest < 0.5  # no pose waits for a connection
    warnings = [each for each in caplog.records if each.levelno >= logging.WARNING]
    assert len(warnings) == 1


def test_a_broker_that_hangs_is_sent_no_more_and_then_goes_on(broker: Broker) -> None:
    sink = open_sink(address(broker), CONTEXT)
    with Subscriber(broker) as reader:
        reader.until(STATE, b"lost")
        broker.signal(signal.SIGSTOP)
        each, taken, problem = standing(), 0, ""
        began = time.monotonic()
        while not problem:
            problem = refusal(sink, replace(each, index=taken))
            taken += not problem
        assert problem == "the broker, or the network to it, is too slow"
        assert time.monotonic() - began < 4
        broker.signal(signal.SIGCONT)
        wait_for(lambda: not refusal(sink, replace(each, index=taken)), "room", 5)
        sink.close()
        heard = [payload for topic, _, payload in reader.until(STATE, b"lost") if topic == POSE]
    indices = [read([payload])[0][1][0] for payload in heard[:: len(heard) // 50]]
    assert len(heard) == taken + 1  # all that was taken comes
    assert indices == sorted(indices)


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 " + 200 * b".", b"\x20\x02\x00\x05"])
def test_what_is_no_broker_or_refuses_us_costs_nothing(answer: bytes, monkeypatch) -> None:
    monkeypatch.setattr("bridge.sinks.publisher.GRACE", 0.2)
    visits = []

    def serve() -> None:
        while True:
            try:
                line, _ = server.accept()
            except OSError:
                return
            visits.append(line)
            if answer:
                line.sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve)
        thread.start()
        sink = open_sink(f"mqtt://127.0.0.1:{server.getsockname()[1]}", CONTEXT)
        if answer:
            wait_for(lambda: len(visits) > 1, "another attempt", 5)
        with pytest.raises(SinkError, match="no connection to the broker: ") as caught:
            sink(standing())
        assert not answer.startswith(b"\x20") or "it says Not authorized" in str(caught.value)
        sink.close()
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
    for line in visits:
        line.close()


@pytest.mark.filterwarnings("ignore:unclosed <ssl")  # paho's, where a certificate is refused
def test_a_user_comes_in_by_password_and_over_tls(tmp_path: Path) -> None:
    key, certificate, users = (tmp_path / name for name in ("key.pem", "cert.pem", "users"))
    make = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2"
    make += " -subj /CN=broker -addext subjectAltName=IP:127.0.0.1"
    subprocess.run(
        [*make.split(), "-keyout", key, "-out", certificate], check=True, capture_output=True
    )
    users.touch(0o600)
    subprocess.run(["mosquitto_passwd", "-b", users, "ann", "s3cret"], check=True)
    (tmp_path / "right").write_text("s3cret\n")
    (tmp_path / "wrong").write_text("guess\n")
    secure = (f"certfile {certificate}", f"keyfile {key}", f"password_file {users}")
    with Broker(tmp_path, "allow_anonymous false", *secure) as broker:
        for options, problem in (
            (f"?tls={certificate}&user=ann&password_file={tmp_path / 'right'}", None),
            (f"?tls={certificate}&user=ann&password_file={tmp_path / 'wrong'}", "Not authorized"),
            (f"?tls={certificate}", "Not authorized"),
            ("?tls=yes", "certificate verify failed"),
        ):
            sink = open_sink(address(broker, options), CONTEXT)
            if problem is None:
                sink(standing())
            else:
                with pytest.raises(SinkError, match=problem):
                    sink(standing())
            sink.close()


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ("?retain=yes", "unknown option retain (known: user, password_file, tls, frame, axes"),
        (
            "?user=ann&password_file=/no/such",
            "option password_file=/no/such is wrong: No such file",
        ),
        ("?password_file=/dev/null", "a password wants user=NAME"),
        ("?tls=maybe", "write yes, no, or a file of certificates (PEM): No such file"),
        ("?tls=/dev/null", "write yes, no, or a file of certificates (PEM)"),
        ("/stage/+", "'stage/+' is no topic"),
        ("/$SYS", "'$SYS' is no topic"),
        (f"/{'x' * 66_000}", "a topic has at most 65000 bytes"),
        ("?labels=neck:NECK", "the model has no marker NECK"),
    ],
)
def test_an_address_that_cannot_be_meant_is_refused(rest: str, words: str) -> None:
    with pytest.raises(UrlError) as caught:
        open_sink(f"mqtt://127.0.0.1:1{rest}", CONTEXT)
    assert words in str(caught.value)


def test_a_password_does_not_belong_into_an_address() -> None:
    with pytest.raises(UrlError) as caught:
        open_sink("mqtt://ann:s3cret@127.0.0.1", CONTEXT)
    assert "write user=NAME&password_file=FILE" in str(caught.value)
    assert "s3cret" not in str(caught.value)


def test_an_unknown_host_is_refused() -> None:
    with pytest.raises(AddressError, match=r"cannot send to host\.invalid:1883"):
        open_sink("mqtt://host.invalid", CONTEXT)
    with pytest.raises(AddressError, match="ports are 1 to 65535"):
        open_sink("mqtt://127.0.0.1:0", CONTEXT)


def test_without_paho_it_says_what_to_install(monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, "bridge.sinks.publisher", raising=False)
    monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
    with pytest.raises(SinkError, match=r"pip install 'markerbridge\[mqtt\]'"):
        open_sink("mqtt://127.0.0.1", CONTEXT)
