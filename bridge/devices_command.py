"""`markerbridge devices`: serial ports, and what is being sent on them."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from dataclasses import asdict

from bridge import terminal
from drivers.options import checked, positive
from drivers.serial_devices import BAUDS, Identity, identify_all, ports


def main(argv: list[str]) -> int:
    """Runs the command; 0 also where nothing is there."""
    options = _parser().parse_args(argv)
    found = ports(options.ports)
    if found and not options.json:
        count = "a port" if len(found) == 1 else f"{len(found)} ports"
        seconds = options.listen * len(BAUDS)
        print(f"listening on {count} for {seconds:g} s at most", file=sys.stderr)
    findings = identify_all(found, options.listen)
    if options.json:
        terminal.answer(json.dumps([asdict(finding) for finding in findings]))
    elif not findings:
        terminal.answer("no serial port is there: is the device plugged in? Others can be named")
    else:
        terminal.answer("\n".join(map(_line, findings)))
    return 0


def _line(finding: Identity) -> str:
    port = finding.port
    number = f"serial number {port.serial_number}" if port.serial_number else ""
    about = ", ".join(filter(None, (port.maker, port.product, number, port.by_id)))
    return f"{port.path}{f' ({about})' if about else ''}: {_told(finding)}"


def _told(finding: Identity) -> str:
    if finding.address:
        return f"write {shlex.quote(finding.address)}"
    if finding.trouble:
        return finding.trouble
    if any(finding.heard.values()):
        table = ", ".join(f"{count} bytes at {baud}" for baud, count in finding.heard.items())
        return f"something is sent ({table}), but no codec reads it: another rate, or no tracker?"
    return "open, but nothing is sent: is the device switched on?"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge devices",
        description="Lists serial ports, says hello on each in all codecs, listens, and tells the "
        "address to use where a codec reads what is sent.",
    )
    add = parser.add_argument
    add("ports", nargs="*", metavar="PORT", help="the ports to try (default: all there are)")
    add(
        "--listen",
        type=checked(positive),
        default=1.5,
        metavar="S",
        help="how long to listen at each rate (default: 1.5)",
    )
    add("--json", action="store_true", help="what was found as JSON on standard output")
    return parser
