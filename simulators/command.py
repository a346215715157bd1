"""`markerbridge simulate`: plays a capture or the embedded performer as a tracker would."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from drivers.c3d_file import read_c3d
from drivers.clock import SYSTEM_CLOCK
from drivers.errors import UsageError
from drivers.frame import Floats, Layout
from drivers.marker_set import MARKERS
from drivers.options import checked, positive
from drivers.signals import stopping
from drivers.url import Url
from drivers.wire.cobs import CobsEncoder
from drivers.wire.codec import Encoder
from drivers.wire.osc_native import NativeOscEncoder
from simulators.corruption import Corruption
from simulators.device import Device, Wire, truth_wire
from simulators.fault_options import add_fault_options, faults_of
from simulators.lines import Line, PtyLine, UdpLine
from simulators.performer import load_performer


def main(argv: list[str], tracked_markers: Callable[[str], tuple[str, ...]]) -> int:
    """Runs the command; `tracked_markers` gives the markers that a model file tracks."""
    options = _parser().parse_args(argv)
    layout, poses = open_poses(options.source, loop=options.loop)
    labels = _chosen(options.markers, options.model, layout, tracked_markers)
    if options.seconds is not None:
        poses = itertools.islice(poses, round(options.seconds * layout.rate))
    line, encoder, waits = _open_line(Url.parse(options.to))
    truth = _open_truth(options.truth)
    device = Device(
        poses,
        [layout.labels.index(label) for label in labels],
        Corruption(faults_of(options), len(labels), options.seed),
        Wire(line, encoder, Layout(labels, layout.rate)),
        SYSTEM_CLOCK,
        speed=options.speed,
        truth=truth_wire(truth, layout) if truth else None,
    )
    try:
        with stopping() as stop:
            if waits:
                _say(f"{options.to} is there; the clip starts when a host opens it")
                device.wait_for_host(stop)
            device.play(stop)
            line.drain()
    finally:
        for end in (line, truth):
            if end:
                end.close()
    lost = f", {line.lost} packets lost because nobody read them" if line.lost else ""
    _say(f"{device.sent} frames of {len(labels)} markers sent to {options.to}{lost}")
    return 0


def open_poses(address: str, *, loop: bool = False) -> tuple[Layout, Iterator[Floats]]:
    """Clean poses of `c3d:FILE` or `performer:NAME`, (M, 3) metres each, and their layout.

    A performer never ends; a clip ends unless it loops. Raises UsageError or SourceError.
    """
    url = Url.parse(address)
    url.finish()
    if url.scheme == "c3d":
        clip = read_c3d(url.file_path(), labels=None)
        return clip.layout, itertools.cycle(clip.xyz) if loop else iter(clip.xyz)
    if url.scheme == "performer":
        try:
            walker = load_performer(url.file_path())
        except ValueError as error:
            raise UsageError(str(error)) from error
        return walker.layout, map(walker.pose, itertools.count())
    raise UsageError(f"'{address}' cannot be simulated: write c3d:FILE or performer:walk")


def _chosen(
    wish: str | None, model: str, layout: Layout, tracked_markers: Callable[[str], tuple[str, ...]]
) -> tuple[str, ...]:
    if wish == "all":
        return layout.labels
    labels = tuple(wish.split(",")) if wish else tracked_markers(model)
    unknown = [label for label in labels if label not in MARKERS]
    if unknown:
        raise UsageError(f"--markers: {', '.join(unknown)} not in the marker set")
    if len(set(labels)) != len(labels):
        raise UsageError("--markers: a marker is named twice")
    lacking = [label for label in labels if label not in layout.labels]
    if lacking:
        raise UsageError(f"the capture lacks the markers {', '.join(lacking)}: choose --markers")
    return labels


def _open_line(url: Url) -> tuple[Line, Encoder, bool]:
    """The line, how to write on it, and whether the clip waits for a host."""
    if url.scheme == "serial":
        url.take("codec", "cobs", _only("cobs"))
        url.take("baud", 0, int)  # a pty has none; allowed so that one address serves both sides
        url.finish()
        return PtyLine(Path(url.file_path())), CobsEncoder(), True
    if url.scheme == "osc":
        url.take("dialect", "native", _only("native"))
        url.finish()
        return UdpLine(*url.address()), NativeOscEncoder(), False
    raise UsageError(f"--to '{url.text}': write serial:PATH or osc://HOST:PORT")


def _open_truth(address: str | None) -> UdpLine | None:
    if address is None:
        return None
    url = Url.parse(address)
    url.finish()
    if url.scheme != "osc":
        raise UsageError(f"--truth '{address}': write osc://HOST:PORT")
    return UdpLine(*url.address())


def _only(known: str) -> Callable[[str], str]:
    def check(text: str) -> str:
        if text != known:
            raise ValueError(f"known is {known}")
        return text

    return check


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge simulate",
        description="Plays a capture, or the embedded performer, as a marker tracker would: real "
        "bytes on a serial line or a UDP port, in real time.",
    )
    add = parser.add_argument
    add("source", metavar="SOURCE", help="c3d:FILE or performer:walk")
    add(
        "--to",
        required=True,
        metavar="URL",
        help="serial:PATH (a pty is linked there), or osc://HOST:PORT",
    )
    add("--model", default="default", help="whose tracked markers are sent (default: %(default)s)")
    add("--markers", metavar="A,B,...|all", help="the markers to send, in place of the model's")
    add_fault_options(parser)
    add(
        "--speed",
        type=checked(positive),
        default=1.0,
        metavar="X",
        help="times real time (default: 1)",
    )
    add("--loop", action="store_true", help="start the clip again at its end")
    add(
        "--seconds", type=checked(positive), metavar="S", help="stop after S seconds of the capture"
    )
    add(
        "--truth",
        metavar="URL",
        help="osc://HOST:PORT: where the clean markers go, under the same index",
    )
    return parser


def _say(text: str) -> None:
    print(f"markerbridge simulate: {text}", file=sys.stderr, flush=True)
