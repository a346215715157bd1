"""The programs of this folder, as tests use them: an OSC library in JavaScript, and an avatar."""

from __future__ import annotations

import base64
import io
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

import numpy as np
from PIL import Image

from tests.end_to_end.peers import WAIT

FOLDER = Path(__file__).parent
NODE = Path(sys.executable).with_name("node")
END = b"/end\0\0\0\0,\0\0\0"

Message = tuple[str, str, list]  # address, types, arguments


@contextmanager
def program(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A program of this folder, which ends when its input does."""
    ready = NODE.exists() and (FOLDER / "node_modules/.chromium/chromium").exists()
    assert ready, (
        "run `.venv/bin/npm ci --prefix tests/receivers`: the README's second command does"
    )
    process = subprocess.Popen(
        [str(NODE), str(FOLDER / arguments[0]), *arguments[1:]],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        try:
            process.communicate(timeout=WAIT)
        except subprocess.TimeoutExpired:
            process.kill()
            raise


@dataclass(frozen=True, slots=True)
class Decoder:
    """osc.js at a UDP port."""

    process: subprocess.Popen[str]
    port: int

    def packets(self) -> list[list[Message]]:
        """What osc.js made of each datagram that has come."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
            last.sendto(END, ("127.0.0.1", self.port))
        found: list[list[Message]] = []
        assert self.process.stdout
        for line in self.process.stdout:
            packet = json.loads(line)
            messages = [(m["address"], m["types"], m["values"]) for m in packet["messages"]]
            if messages == [("/end", "", [])]:
                return found
            assert packet["same"], "osc.js would write other bytes"
            assert packet["timeTag"] in (None, [0, 1])  # a bundle's: immediately
            found.append(messages)
        raise AssertionError("the decoder ended")


@contextmanager
def decoding() -> Iterator[Decoder]:
    with program("decode.mjs") as process:
        assert process.stdout
        yield Decoder(process, int(process.stdout.readline()))


@dataclass(frozen=True, slots=True)
class Drawn:
    """A picture (height, width, 3), and where joints are.

    rest, joints: metres, in three's world, by VRM's names of the bones; rest: in the avatar's T.
    pixels: the joints in the picture, column and row.
    """

    picture: np.ndarray
    rest: dict[str, np.ndarray]
    joints: dict[str, np.ndarray]
    pixels: dict[str, np.ndarray]

    def coloured(self) -> np.ndarray:
        """(height, width): where the avatar is. Floor, shadow and background are grey."""
        return np.ptp(self.picture.astype(int), axis=2) > 60


@dataclass(slots=True)
class Avatar:
    """The avatar in a page in a headless browser, and the UDP port that moves it."""

    url: str
    port: int
    bundles: int = 0  # that came

    def drawn(self, bundles: int) -> Drawn:
        """After so many more bundles."""
        self.bundles += bundles
        deadline = time.monotonic() + WAIT
        while (told := self._told())["bundles"] < self.bundles:
            assert time.monotonic() < deadline, f"{told['bundles']} of {self.bundles} bundles came"
        assert told["bundles"] == self.bundles
        image = Image.open(io.BytesIO(base64.b64decode(told["picture"]))).convert("RGB")
        rest, joints, pixels = (
            {name: np.array(place) for name, place in told[kind].items()}
            for kind in ("rest", "joints", "pixels")
        )
        return Drawn(np.asarray(image), rest, joints, pixels)

    def _told(self) -> dict:
        with urlopen(self.url + "picture", timeout=WAIT) as answer:
            return json.load(answer)


@contextmanager
def avatar(*query: str) -> Iterator[Avatar]:
    """query: `markers`, to show these beside it."""
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        program("relay.mjs", "0", "--headless", folder, *query) as process,
    ):
        assert process.stdout
        told = json.loads(process.stdout.readline())
        yield Avatar(told["url"], told["udp"])
