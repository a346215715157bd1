"""A bridge that does nothing: for each packet on a serial line, one datagram of the same size as
ours. What it takes is the line, the loopback and Python; what a real bridge takes is more.

`python -m tests.benchmarks.null_bridge PORT UDP_PORT BYTES`
"""

from __future__ import annotations

import os
import select
import socket
import sys
import tty

from drivers.wire.cobs import CobsDecoder

SHORTEST = 60  # bytes: what is shorter is a layout's end, or a delimiter


def main() -> None:
    path, port, size = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    line = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(line)
    os.write(line, CobsDecoder.hello)
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.connect(("127.0.0.1", port))
    datagram = bytes(size)
    rest = b""
    while True:
        select.select([line], [], [])
        try:
            *packets, rest = (rest + os.read(line, 65_536)).split(b"\0")
        except OSError:  # the other end is gone
            return
        for packet in packets:
            if len(packet) > SHORTEST and packet[1:2] != b"\x02":
                out.send(datagram)


if __name__ == "__main__":
    main()
