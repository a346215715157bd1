from __future__ import annotations

import socket
from contextlib import closing

import pytest

from drivers.clock import SYSTEM_CLOCK
from drivers.frame import Layout, SourceError
from drivers.osc_udp import OscSource, UdpTransport
from drivers.registry import open_source
from drivers.udp_sender import AddressError, UdpSender
from drivers.url import Url, UrlError
from drivers.wire.registry import take_decoder


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("nonsense", "has no scheme"),
        ("carrier-pigeon:/x", "is no source: known are serial, osc, c3d"),
        ("serial:", "names no path"),
        ("serial:/dev/null?codec=morse", "codec=morse is wrong: known are cobs"),
        ("serial:/dev/null?baud=fast", "option baud=fast is wrong"),
        ("serial:/dev/null?boud=9600", "unknown option boud (known: baud, codec, frame, axes"),
        ("serial:/dev/null?baud", "options are written ?name=value"),
        ("osc://127.0.0.1", "names no port"),
        ("osc://127.0.0.1:70000", "a number from 0 to 65535"),
        ("osc://[::1", "write HOST:PORT"),
        ("osc:127.0.0.1:9100", "write osc://HOST:PORT"),
        ("osc://127.0.0.1:9100/frames", "write osc://HOST:PORT"),
        ("osc://127.0.0.1:0?dialect=x", "dialect=x is wrong: known are native"),
        ("c3d:a.c3d?speed=-1", "a factor above 0, or max"),
    ],
)
def test_an_address_that_cannot_be_meant_is_refused_in_plain_words(
    address: str, words: str
) -> None:
    with pytest.raises(UrlError) as caught:
        open_source(address)
    assert words in str(caught.value)
    assert caught.value.exit_status == 2


def test_a_source_that_is_not_there_is_named() -> None:
    with pytest.raises(SourceError, match=r"cannot open serial port /dev/no-such-port"):
        open_source("serial:/dev/no-such-port")
    with pytest.raises(SourceError, match=r"no-such\.c3d: no such file"):
        open_source("c3d:no-such.c3d")


def test_both_ways_to_write_a_path_are_the_same() -> None:
    assert Url.parse("serial:/dev/x").file_path() == Url.parse("serial:///dev/x").file_path()


def test_a_second_listener_on_a_port_is_refused() -> None:
    with open_source("osc://127.0.0.1:0") as first:
        assert isinstance(first, OscSource)
        with pytest.raises(SourceError, match="another program uses it"):
            open_source(f"osc://127.0.0.1:{first.port}")


def test_a_layout_refuses_double_labels_and_impossible_rates() -> None:
    with pytest.raises(ValueError, match="occur twice: C7"):
        Layout(("C7", "LSHO", "C7"), 120.0)
    with pytest.raises(ValueError, match="rate 0"):
        Layout(("C7",), 0.0)


@pytest.mark.parametrize(
    "wire", ["serial:x?codec=lines", "serial:x?codec=fastrak", "osc://?dialect=vmc"]
)
def test_a_rate_that_no_layout_can_have_is_refused(wire: str) -> None:
    with pytest.raises(UrlError, match="option rate=1e7 is wrong"):
        take_decoder(Url.parse(f"{wire}&rate=1e7"))


def test_an_option_that_is_given_twice_is_not_silently_the_last() -> None:
    with pytest.raises(UrlError, match="option labels is given twice"):
        Url.parse("osc://:9100?labels=a:C7&labels=b:LTOE")


@pytest.mark.parametrize("host", ["192.168.1..20", "a" * 70])
def test_a_host_that_cannot_be_one_is_refused_in_plain_words(host: str) -> None:
    with pytest.raises(SourceError, match=f"cannot listen on UDP {host}:9100"):
        open_source(f"osc://{host}:9100")
    with pytest.raises(SourceError, match=f"cannot find {host}"):
        open_source(f"osc://127.0.0.1:0?dialect=qtm&control={host}")
    with pytest.raises(AddressError, match=f"cannot send to {host}:9100"):
        UdpSender(host, 9100)
    with pytest.raises(AddressError, match=r"127\.0\.0\.1:0: ports are"):
        UdpSender("127.0.0.1", 0)


def test_a_name_that_has_both_is_the_ipv4_address_for_who_sends_and_who_listens(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ask = socket.getaddrinfo

    def both(host: str, port: int, **asked: int) -> list:
        return [one for name in ("::1", "127.0.0.1") for one in ask(name, port, **asked)]

    monkeypatch.setattr(socket, "getaddrinfo", both)
    with closing(UdpTransport("localhost", 0, SYSTEM_CLOCK)) as transport:
        with closing(UdpSender("localhost", transport.port)) as sender:
            sender.send(b"here")
        received = transport.receive(5.0)
    assert received is not None
    assert received.data == b"here"
    assert transport.host == "127.0.0.1"
