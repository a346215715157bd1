"""A screen of its own for tests of the window, and keys pressed on it."""

from __future__ import annotations

import os
import shutil
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager

_KEYCODES = {"q": 24, "s": 39}  # of Xvfb's keyboard
_HELD = 0.03  # s that a key is down: of one that goes up at once the server forgets that it did


@contextmanager
def screen() -> Iterator[str]:
    """An X server that nobody sees; its name, as DISPLAY has it."""
    assert shutil.which("Xvfb"), "install Debian's xvfb: the README's second command does"
    reader, writer = os.pipe()
    command = ["Xvfb", "-displayfd", str(writer), "-screen", "0", "1400x900x24"]
    with tempfile.TemporaryFile() as log:
        server = subprocess.Popen(command, pass_fds=[writer], stderr=log)
    os.close(writer)
    with os.fdopen(reader) as number:
        name = f":{number.readline().strip()}"
    try:
        yield name
    finally:
        server.terminate()
        server.wait()


def press(display: str, *keys: str) -> None:
    """Presses keys as a person at the keyboard does, by X's own protocol (XTEST)."""
    with socket.socket(socket.AF_UNIX) as server:
        server.connect(f"/tmp/.X11-unix/X{display.removeprefix(':')}")
        server.settimeout(10.0)
        server.sendall(struct.pack("<BxHHHHxx", ord("l"), 11, 0, 0, 0))
        accepted, _, _, _, words = struct.unpack("<BBHHH", _read(server, 8))
        assert accepted == 1
        _read(server, 4 * words)
        name = b"XTEST"
        server.sendall(struct.pack("<BxHHxx", 98, 2 + 2, len(name)) + name.ljust(8, b"\0"))
        reply = _read(server, 32)
        assert reply[8], "the X server has no XTEST"
        for key in keys:
            for event in (2, 3):  # down, up
                fake = struct.pack("<BBHBBxxIIxxxxxxxxHHxxxxxxxx", reply[9], 2, 9, event,
                                   _KEYCODES[key], 0, 0, 0, 0)  # fmt: skip
                server.sendall(fake)
                server.sendall(struct.pack("<BxH", 43, 1))  # to hear when it is read
                _read(server, 32)
                time.sleep(_HELD)


def _read(server: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = server.recv(count - len(data))
        assert more, "the X server has hung up"
        data += more
    return data
