"""A bridge that does nothing: for each frame's packet on a serial line, one datagram of the same
size as ours. What it takes is the line, the loopback and Python; what a real bridge takes is more.

`python tests/benchmarks/null_bridge.py PORT UDP_PORT BYTES FRAME_BYTES`
"""

from __future__ import annotations

import os
import select
import signal
import socket
import struct
import sys
import tty

from drivers.wire.cobs import CobsDecoder

NOTHING = struct.Struct(">4sI")  # what a datagram begins with: a mark, and a count from 0
MARK = b"none"


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a shell's background jobs ignore it
    path, port, size, frame_size = sys.argv[1], *map(int, sys.argv[2:5])
    line = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(line)
    os.write(line, CobsDecoder.hello)
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.connect(("127.0.0.1", port))
    datagram = bytearray(max(size, NOTHING.size))
    count = 0
    rest = b""
    while True:
        select.select([line], [], [])
        try:
            *packets, rest = (rest + os.read(line, 65_536)).split(b"\0")
        except OSError:  # the other end is gone
            return
        for packet in packets:
            if len(packet) == frame_size:  # else a layout, or nothing between two delimiters
                NOTHING.pack_into(datagram, 0, MARK, count)
                out.send(datagram)
                count += 1


if __name__ == "__main__":
    main()
