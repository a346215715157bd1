"""Processes and receivers for the tests that use real lines."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

WAIT = 30.0  # s: a process that takes longer to do the least thing is stuck


class Command:
    """A `markerbridge` process, in its own session as a shell's job is."""

    def __init__(self, *arguments: str, cwd: Path | None = None) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "bridge.cli", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
            text=True,
            cwd=cwd,
            start_new_session=True,
        )

    def interrupt(self) -> None:
        """What Ctrl-C does."""
        self.process.send_signal(signal.SIGINT)

    def end(self, timeout: float = WAIT) -> tuple[int, str, str]:
        """Waits for the exit; status, output and errors."""
        try:
            out, err = self.process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            out, err = self.process.communicate()
            raise AssertionError(f"still running after {timeout} s: {err}") from None
        return self.process.returncode, out, err


@contextmanager
def running(*arguments: str, cwd: Path | None = None) -> Iterator[Command]:
    command = Command(*arguments, cwd=cwd)
    try:
        yield command
    finally:
        if command.process.poll() is None:
            command.process.kill()
        command.process.communicate()


class Receiver:
    """Collects every datagram that comes to a UDP port of 127.0.0.1."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self.port: int = self._socket.getsockname()[1]
        self.datagrams: list[bytes] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._collect)
        self._thread.start()

    def _collect(self) -> None:
        while True:
            try:
                self.datagrams.append(self._socket.recv(65_536))
            except TimeoutError:
                if self._stop.is_set():  # and nothing more has come
                    return

    def __enter__(self) -> Receiver:
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()


def wait_for(condition, what: str, timeout: float = WAIT) -> None:
    """Waits for another process to get somewhere."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"waited {timeout} s for {what}"
        time.sleep(0.01)


def listening(address: str) -> bool:
    """Whether somebody holds the UDP port of `osc://HOST:PORT`."""
    port = int(address.rpartition(":")[2])
    return f":{port:04X} " in Path("/proc/net/udp").read_text()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
