"""The status over HTTP, asked by Python's own client and by clients that mean no good."""

from __future__ import annotations

import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from bridge import status_server
from bridge.status_server import StatusError, StatusServer, parse_endpoint

STATUS = {"frames": 12, "source": {"bytes": 3}, "rms_mm": None}
QUICK = 0.3  # s that a client gets in these tests


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[StatusServer]:
    monkeypatch.setattr(status_server, "PATIENCE", QUICK)
    with StatusServer(("127.0.0.1", 0), lambda: STATUS) as server:
        yield server


def asked(server: StatusServer, method: str = "GET", target: str = "/") -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    try:
        connection.request(method, target)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def dialled(server: StatusServer, request: bytes = b"") -> socket.socket:
    client = socket.create_connection(("127.0.0.1", server.port), timeout=10)
    client.sendall(request)
    return client


def everything(client: socket.socket) -> bytes:
    """What the server sends until it hangs up."""
    found = b""
    try:
        while data := client.recv(65_536):
            found += data
    except ConnectionError:
        pass
    return found


def test_it_answers_with_the_status_as_json(server: StatusServer) -> None:
    state, body = asked(server)
    assert (state, json.loads(body)) == (200, STATUS)
    assert asked(server, target="/?pretty")[0] == 200
    assert asked(server, "HEAD") == (200, b"")


def test_what_is_not_there_and_what_is_no_question_is_refused(server: StatusServer) -> None:
    assert asked(server, target="/etc/passwd") == (404, b"")
    assert asked(server, "POST") == (405, b"")
    for rubbish in (b"\0\xff\r\n\r\n", b"\r\n\r\n", b"GET /\r\n\r\n", b"GET / HTTP/9\r\n\r\n"):
        with dialled(server, rubbish) as client:
            assert everything(client).startswith(b"HTTP/1.1 400 ")
    assert asked(server)[0] == 200


def test_a_connection_is_not_kept(server: StatusServer) -> None:
    with dialled(server, b"GET / HTTP/1.1\r\nConnection: keep-alive\r\n\r\n") as client:
        assert b"\r\nConnection: close\r\n" in everything(client)


def test_clients_that_say_nothing_or_too_much_are_dropped(server: StatusServer) -> None:
    silent = [dialled(server, b"GET / HT") for _ in range(status_server.AT_ONCE)]
    asking = time.monotonic()
    assert asked(server)[0] == 200  # once the others have had their time
    assert time.monotonic() - asking < 10 * QUICK
    for client in silent:
        assert everything(client) == b""
        client.close()
    with dialled(server, b"GET / HTTP/1.1\r\n") as client:
        with pytest.raises(ConnectionError):
            client.sendall(b"X: " + b"x" * 20_000_000)
        assert everything(client) == b""
    assert asked(server)[0] == 200


def test_a_client_that_never_reads_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status_server, "PATIENCE", QUICK)
    large = {"text": "x" * 20_000_000}  # more than any buffer takes
    with (
        StatusServer(("127.0.0.1", 0), lambda: large) as server,
        dialled(server, b"GET / HTTP/1.1\r\n\r\n") as lazy,
    ):
        assert asked(server, "HEAD")[0] == 200
        time.sleep(1.5 * QUICK)
        assert len(everything(lazy)) < 20_000_000


def test_a_crowd_is_served_no_faster_than_it_may(server: StatusServer) -> None:
    """So that nobody keeps the session from its work by asking."""
    start = time.monotonic()
    asking = [threading.Thread(target=asked, args=(server,)) for _ in range(20)]
    for thread in asking:
        thread.start()
    for thread in asking:
        thread.join()
    assert time.monotonic() - start > 18 * status_server.PAUSE


def test_a_status_that_fails_costs_one_answer(caplog: pytest.LogCaptureFixture) -> None:
    statuses = iter([ZeroDivisionError("no luck"), STATUS])

    def status() -> dict[str, object]:
        found = next(statuses)
        if isinstance(found, Exception):
            raise found
        return found

    with StatusServer(("127.0.0.1", 0), status) as server:
        assert asked(server) == (500, b"")
        assert asked(server)[0] == 200
    assert "no luck" in caplog.text


def test_a_port_that_is_taken_is_a_clear_error(server: StatusServer) -> None:
    with pytest.raises(StatusError, match=rf"127\.0\.0\.1:{server.port}: Address already in use"):
        StatusServer(("127.0.0.1", server.port), lambda: STATUS)
    with pytest.raises(StatusError, match=r"no\.such\.host\.invalid"):
        StatusServer(("no.such.host.invalid", 0), lambda: STATUS)


def test_it_ends_at_once_whoever_is_asking() -> None:
    threads = threading.active_count()
    server = StatusServer(("127.0.0.1", 0), lambda: STATUS)
    with dialled(server, b"GET / HT"):
        asked(server)
        start = time.monotonic()
        server.close()
        server.close()
        assert time.monotonic() - start < 1.0
    assert threading.active_count() == threads
    with StatusServer(("127.0.0.1", server.port), lambda: STATUS):
        pass  # the port is free again


@pytest.mark.parametrize(
    ("text", "endpoint"),
    [
        ("9300", ("127.0.0.1", 9300)),
        (":9300", ("127.0.0.1", 9300)),
        ("0.0.0.0:0", ("0.0.0.0", 0)),
        ("studio:80", ("studio", 80)),
        ("[::1]:9300", ("::1", 9300)),
    ],
)
def test_an_endpoint_is_a_host_and_a_port(text: str, endpoint: tuple[str, int]) -> None:
    assert parse_endpoint(text) == endpoint


@pytest.mark.parametrize("text", ["", ":", "studio", "a:b", "a:70000", "-1", "a:1/x", "http://a:1"])
def test_what_is_no_endpoint_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no address: write HOST:PORT"):
        parse_endpoint(text)
