"""Mosquitto, the real broker, and mosquitto_sub, which hears what it passes on."""

from __future__ import annotations

import queue
import signal
import socket
import subprocess
import threading
from pathlib import Path

from tests.end_to_end.peers import WAIT, wait_for

SERVER = Path("/usr/sbin/mosquitto")  # not on everybody's path
MISSING = "install Debian's mosquitto and mosquitto-clients: the README's second command does"
# As root it would no longer read our folders; a pose is not to wait for the next (docs/scale.md).
OWN = ("user root", "persistence false", "set_tcp_nodelay true", "max_queued_messages 100000")


class Broker:
    """A broker on a free port of this machine, which can be killed and started again.

    more: further lines of its configuration.
    """

    def __init__(self, folder: Path, *more: str) -> None:
        assert SERVER.is_file(), MISSING
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port: int = probe.getsockname()[1]
        self._config = folder / "mosquitto.conf"
        lines = [*OWN, f"listener {self.port} 127.0.0.1", *(more or ["allow_anonymous true"])]
        self._config.write_text("\n".join([*lines, ""]))
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(
            [SERVER, "-c", self._config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        wait_for(self._listens, "mosquitto to listen", 10)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def signal(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def _listens(self) -> bool:
        assert self.process.poll() is None, f"mosquitto does not take {self._config}"
        try:
            socket.create_connection(("127.0.0.1", self.port)).close()
        except ConnectionRefusedError:
            return False
        return True

    def __enter__(self) -> Broker:
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()


class Subscriber:
    """All that mosquitto_sub hears of a topic: (topic, retained, payload), in order."""

    def __init__(self, broker: Broker, topic: str = "#", *options: str) -> None:
        self._process = subprocess.Popen(
            ["mosquitto_sub", "-p", str(broker.port), "-t", topic, "-F", "%t %r %x", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self._heard: queue.Queue[tuple[str, bool, bytes]] = queue.Queue()
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def next(self) -> tuple[str, bool, bytes]:
        return self._heard.get(timeout=WAIT)

    def until(self, topic: str, payload: bytes) -> list[tuple[str, bool, bytes]]:
        """What is heard up to this message, itself the last."""
        heard = [self.next()]
        while heard[-1][0] != topic or heard[-1][2] != payload:
            heard.append(self.next())
        return heard

    def _listen(self) -> None:
        assert self._process.stdout
        for line in self._process.stdout:
            topic, retained, payload = line.split()
            self._heard.put((topic, retained == "1", bytes.fromhex(payload)))

    def __enter__(self) -> Subscriber:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.kill()
        self._process.wait()
        self._thread.join()
        assert self._process.stdout
        self._process.stdout.close()
