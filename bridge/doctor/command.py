"""`markerbridge doctor`: listens to a source and says in plain words what it sees."""

from __future__ import annotations

import argparse
import json
import shlex
import sys

from bridge import terminal
from bridge.doctor.examination import examine
from bridge.doctor.finding import Finding, Grade
from bridge.doctor.heard import listen
from bridge.model import DEFAULT, Model
from drivers.options import checked, positive
from drivers.registry import open_source
from drivers.signals import stopping

_WORDS = {Grade.WRONG: "wrong", Grade.POOR: "poor", Grade.NOTE: "note"}


def main(argv: list[str]) -> int:
    """Runs the command; 0 where nothing is wrong or poor, else 1."""
    options = _parser().parse_args(argv)
    info = Model(options.model).info
    with stopping() as stop, open_source(options.source) as source:
        if not options.json:
            print(f"listening to {options.source} for {options.seconds:g} s", file=sys.stderr)
        heard = listen(source, options.seconds, stop)
    findings, address = examine(heard, info)
    well = all(finding.grade is Grade.NOTE for finding in findings)
    if options.json:
        terminal.answer(json.dumps(_as_json(options.source, well, findings, address)))
    else:
        lines = [_line(finding) for finding in findings]
        if address != options.source:
            lines.append(f"write: {shlex.quote(address)}")
        elif well:
            lines.append("all well")
        terminal.answer("\n".join(lines))
    return 0 if well else 1


def _line(finding: Finding) -> str:
    written = [f"{k}={value}" if value else f"no {k}" for k, value in finding.options.items()]
    options = "&".join(written)
    return f"{_WORDS[finding.grade]}: {finding.text}{f' -> {options}' if options else ''}"


def _as_json(source: str, well: bool, findings: list[Finding], address: str) -> dict[str, object]:
    return {
        "source": source,
        "well": well,
        "address": address,
        "findings": [
            {
                "grade": _WORDS[finding.grade],
                "about": finding.about,
                "text": finding.text,
                "options": dict(finding.options),
            }
            for finding in findings
        ],
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge doctor",
        description="Listens to a source and says what is wrong with it: the line, the clock, the "
        "labels, the coordinates; and what to write into its address. Walk about meanwhile. Status "
        "0 where nothing is wrong, else 1.",
    )
    add = parser.add_argument
    add("source", metavar="SOURCE", help="serial:PATH, osc://HOST:PORT or another source")
    add(
        "--seconds",
        type=checked(positive),
        default=5.0,
        metavar="S",
        help="how long to listen (default: 5)",
    )
    add("--model", default=DEFAULT, help="whose tracked markers (default: the one that ships)")
    add("--json", action="store_true", help="the findings as JSON on standard output")
    return parser
