"""`markerbridge simulate`: plays a capture or the embedded performer as a tracker would."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from drivers.c3d_file import read_c3d
from drivers.clock import SYSTEM_CLOCK
from drivers.convention import Convention
from drivers.errors import UsageError
from drivers.frame import Floats, Layout
from drivers.marker_set import MARKERS
from drivers.options import checked, positive
from drivers.performers import labels_of, parse_names
from drivers.signals import stopping
from drivers.url import Url
from drivers.wire.codec import Decoder, Encoder
from drivers.wire.registry import take_decoder, take_encoder
from drivers.wire_source import reorder_of
from simulators.corruption import Corruption
from simulators.device import Device, Wire, truth_wire
from simulators.fault_options import add_fault_options, faults_of
from simulators.faults.chain import FaultChain
from simulators.faults.plan import FaultPlan, read_plan
from simulators.lines import PtyLine, UdpLine
from simulators.performer import load_performer
from simulators.several import side_by_side

_APART = 0.05  # m between the markers by which names are told
_SEVERAL = 8  # frames after which a host has learnt the names of a wire
# Options of the host's side that its codec does not know.
_HOST_OPTIONS = {"serial": ("baud",), "osc": ("allow", "control")}


def main(argv: list[str], tracked_markers: Callable[[str], tuple[str, ...]]) -> int:
    """Runs the command; `tracked_markers` gives the markers that a model file tracks."""
    options = _parser().parse_args(argv)
    layout, poses = open_poses(options.source, loop=options.loop)
    labels = _chosen(options.markers, options.model, layout, tracked_markers)
    if options.performers:
        if options.truth:
            raise UsageError("--truth is for one performer: leave out --performers")
        labels = labels_of(labels, options.performers)
        layout, poses = side_by_side(layout, poses, options.performers)
    if options.seconds is not None:
        poses = itertools.islice(poses, round(options.seconds * layout.rate))
    plan = read_plan(Path(options.faults), labels) if options.faults else FaultPlan()
    faults = FaultChain(plan, Layout(labels, layout.rate), options.seed)
    wire, hello = _open_wire(options.to, faults.layout)
    truth = _open_truth(options.truth)
    device = Device(
        poses,
        [layout.labels.index(label) for label in labels],
        Corruption(faults_of(options), len(labels), options.seed or 0),
        wire,
        SYSTEM_CLOCK,
        faults=faults,
        speed=options.speed,
        truth=truth_wire(truth, layout) if truth else None,
    )
    try:
        with stopping() as stop:
            if isinstance(wire.line, PtyLine):
                _say(f"{options.to} is there; the clip starts when a host opens it")
                device.wait_for_host(stop, opened=None if hello else wire.line.opened)
            device.play(stop)
            wire.line.drain()
    finally:
        for end in (wire.line, truth):
            if end:
                end.close()
    lost = f", {wire.line.lost} packets lost because nobody read them" if wire.line.lost else ""
    _say(f"{device.sent} frames of {len(labels)} markers sent to {options.to}{lost}")
    if plan.fault:
        _say(", ".join(f"{name} {count}" for name, count in sorted(device.counters.items())))
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


def _open_wire(address: str, layout: Layout) -> tuple[Wire, bool]:
    """The wire at an address, and whether it has a hello by which a host starts the clip.

    What only the host needs may stand in the address too, so that one serves both sides.
    """
    url, host = Url.parse(address), Url.parse(address)
    if url.scheme not in ("serial", "osc"):
        raise UsageError(f"--to '{address}': write serial:PATH or osc://HOST:PORT")
    encoder, convention = take_encoder(url)
    decoder, _ = take_decoder(host)
    reorder_of(host)
    for name in sorted({*host.known, *_HOST_OPTIONS[url.scheme]}.difference(url.known)):
        url.take(name, "", str)
    url.finish()
    try:
        convention, names = _names(encoder, decoder, convention, layout)
    except ValueError as error:
        raise UsageError(f"--to '{address}': {error}") from error
    if names:
        pairs = ",".join(f"{theirs}:{ours}" for theirs, ours in names.items())
        _say(f"this wire has names of its own; for the host's address: labels={pairs}")
    line = PtyLine(Path(url.file_path())) if url.scheme == "serial" else UdpLine(*url.address())
    encoder, _ = take_encoder(Url.parse(address))  # one that has sent nothing yet
    return Wire(line, encoder, layout, convention), bool(decoder.hello)


def _names(
    encoder: Encoder, decoder: Decoder, convention: Convention, layout: Layout
) -> tuple[Convention, dict[str, str]]:
    """How markers are named on a wire: those of the address, or numbers on a wire of numbered
    places; and the names that a host has to be told. Raises ValueError where it has no such names.
    """
    try:
        names = heard_names(encoder, decoder, convention, layout)
    except ValueError as error:
        if convention.labels:
            raise
        numbers = {str(place): label for place, label in enumerate(layout.labels, 1)}
        numbered = Convention(convention.frame, numbers)
        try:
            return numbered, heard_names(encoder, decoder, numbered, layout)
        except ValueError:
            raise error from None
    known = all(convention.labels.get(theirs, theirs) == ours for theirs, ours in names.items())
    return convention, {} if known else names


def heard_names(
    encoder: Encoder, decoder: Decoder, convention: Convention, layout: Layout
) -> dict[str, str]:
    """What a host calls the markers of `layout`: wire's label to ours, told by their places.

    Some wires have numbers in place of labels. Raises ValueError where the wire cannot carry them.
    """
    decoder.feed(encoder.encode_layout(convention.layout_out(layout)), 0.0)
    places = np.ones((len(layout.labels), 3), np.float32)
    places[:, 0] = _APART * np.arange(len(layout.labels))
    names = {}
    for index in range(_SEVERAL):
        t = index / layout.rate
        data = encoder.encode_frame(index, t, convention.xyz_out(places))
        for frame in decoder.feed(data, t):
            for label, (x, _, _) in zip(
                frame.layout.labels, convention.xyz_in(frame.xyz), strict=True
            ):
                if np.isfinite(x):
                    names[label] = layout.labels[round(float(x) / _APART)]
    return names


def _open_truth(address: str | None) -> UdpLine | None:
    if address is None:
        return None
    url = Url.parse(address)
    url.finish()
    if url.scheme != "osc":
        raise UsageError(f"--truth '{address}': write osc://HOST:PORT")
    return UdpLine(*url.address())


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
    add(
        "--performers",
        type=checked(parse_names),
        metavar="A,B,...",
        help="several performers in one stream, side by side, with labels A:LFHD and so on",
    )
    add_fault_options(parser)
    add("--faults", metavar="FILE", help="what goes wrong, and when (TOML; its seed, or --seed)")
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
    parser.set_defaults(seed=None)  # a fault file has a seed of its own
    return parser


def _say(text: str) -> None:
    print(f"markerbridge simulate: {text}", file=sys.stderr, flush=True)
