"""Foreign senders: liblo's oscsend and python-osc, over a real UDP port."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
from pythonosc.udp_client import SimpleUDPClient

from drivers.osc_udp import OscSource
from drivers.registry import open_source


def test_liblos_oscsend_is_understood() -> None:
    assert shutil.which("oscsend"), "install Debian's liblo-tools: the README's second command does"
    with open_source("osc://127.0.0.1:0") as source:
        assert isinstance(source, OscSource)
        send = ["oscsend", "127.0.0.1", str(source.port)]
        layout = ["/markerbridge/layout", "dss", "60", "C7", "LSHO"]
        frame = ["/markerbridge/frame", "idffffff", "9", "1.5", "1", "2", "3", "-1", "0.5", "0"]
        subprocess.run([*send, *layout], check=True)
        subprocess.run([*send, *frame], check=True)
        received = source.read(5.0)
    assert received is not None
    assert (received.index, received.t_device) == (9, 1.5)
    assert received.layout.labels == ("C7", "LSHO")
    assert received.layout.rate == 60.0
    np.testing.assert_array_equal(received.xyz, np.float32([[1, 2, 3], [-1, 0.5, 0]]))


def test_python_oscs_client_is_understood() -> None:
    """It knows no doubles unless told, and sends the time as a float."""
    with open_source("osc://127.0.0.1:0") as source:
        assert isinstance(source, OscSource)
        client = SimpleUDPClient("127.0.0.1", source.port)
        client.send_message("/markerbridge/layout", [120.0, "C7"])
        client.send_message("/markerbridge/frame", [3, 0.25, 1.0, 2.0, 3.0])
        received = source.read(5.0)
        client._sock.close()
    assert received is not None
    assert (received.index, received.t_device) == (3, 0.25)
    np.testing.assert_array_equal(received.xyz, np.float32([[1, 2, 3]]))
