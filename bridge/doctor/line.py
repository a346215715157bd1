"""Findings about the line: whether anything comes, from whom, how steadily, and what is lost."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from bridge.doctor.finding import Finding, Grade, corrected
from bridge.doctor.heard import WIRES, Heard
from drivers.osc_udp import RECEIVE_BUFFER
from drivers.url import Url
from drivers.wire.guess import guess_wire

RATE_OFF = 0.05  # share by which the rate may differ from the layout's
JITTER = 6.0  # intervals, and
PAUSE = 0.05  # s: a hundredth of the frames may come so late
LOST = 0.01  # share of frames
DAMAGED = 0.001  # share of packets
STAMPS_OFF = 0.1  # share by which a device's second may differ from ours: more is another unit
DRIFT_KNOWN = 10.0  # s of frames that tell the drift
DRIFT_MOST = 4e-4  # no quartz is so wrong
SPARE = 1.0  # s of packets that a receive buffer should hold
OVERHEAD = 768  # bytes that the system adds to each packet in its buffer

Array = npt.NDArray[np.float64]


def line_findings(heard: Heard) -> Iterator[Finding]:
    """All that frames, bytes and counters tell without looking at the positions."""
    yield from _trouble(heard)
    yield from _senders(heard)
    if not heard.frames:
        yield from _nothing_read(heard) if heard.received else _silence(heard)
        return
    yield from _rate(heard)
    yield from _losses(heard)
    yield from _clock(heard)
    yield from _buffer(heard)


def _silence(heard: Heard) -> Iterator[Finding]:
    url = Url.parse(heard.address)
    if url.scheme == "serial":
        text = (
            f"the port is open, but nothing came in {heard.seconds:.1f} s: is the device switched "
            "on and sending, and is this its port? `markerbridge devices` tries all ports and "
            "rates"
        )
    elif url.scheme == "osc":
        host, port = url.address()
        text = (
            f"nothing came to UDP port {port} in {heard.seconds:.1f} s: does the sender aim at "
            f"this machine and at port {port}, and does a firewall let it through?"
        )
        if host in ("127.0.0.1", "localhost", "::1"):
            anywhere = corrected(heard.address.replace(f"//{host}", "//0.0.0.0", 1), {})
            text += (
                f" {host} hears only programs of this machine: for another machine's write "
                f"{anywhere}"
            )
    else:
        text = f"no frame came in {heard.seconds:.1f} s"
    yield Finding(Grade.WRONG, "silence", text)


_DEFAULTS = {"codec": "cobs", "dialect": "native"}
_REASONS = {
    "no_layout": "their layout, which names the markers, never came: the sender has to send it "
    "first and then once a second",
    "layout_mismatch": "they do not fit their layout",
    "foreign": "they are OSC, but of another program's addresses",
    "bad_osc": "they are no OSC",
    "bad_layout": "their layout cannot be mapped: a label of the option labels occurs twice",
    "unconfirmed": "no marker came often enough to be believed",
}


def _nothing_read(heard: Heard) -> Iterator[Finding]:
    count = sum(len(entry.data) for entry in heard.received)
    begin = f"{count:,} bytes came in {heard.seconds:.1f} s, but no frame"
    url = Url.parse(heard.address)
    guess = guess_wire(url.scheme, heard.received) if url.scheme in WIRES else None
    written = _DEFAULTS | url.options
    if guess and not guess.options.items() <= written.items():
        named = " ".join(f"{name} {value}" for name, value in guess.options.items())
        yield Finding(Grade.WRONG, "wire", f"{begin}: {named} reads them", guess.options)
        return
    counted = [(name, n) for name, n in heard.counters.most_common() if n and name != "bytes"]
    known = [_REASONS[name] for name, _ in counted if name in _REASONS]
    why = known[0] if known else "no codec or dialect makes sense of them"
    if url.scheme == "serial" and not known:
        why += "; is the rate right (baud=)? `markerbridge devices` tries the usual ones"
    table = ", ".join(f"{name} {n}" for name, n in counted)
    yield Finding(Grade.WRONG, "wire", f"{begin}: {why}{f' ({table})' if table else ''}")


def _trouble(heard: Heard) -> Iterator[Finding]:
    # A silent port is opened again and again.
    if lost := heard.counters["disconnects"] - heard.counters["silences"]:
        yield Finding(
            Grade.POOR, "line", f"the line was lost {lost} times: a loose plug, or a tired cable?"
        )
    bad = {
        name: n
        for name, n in heard.counters.items()
        if n and (name.startswith("bad_") or name == "overlong") and name != "bad_layout"
    }
    if bad and heard.frames:
        share = sum(bad.values()) / (len(heard.frames) + sum(bad.values()))
        table = ", ".join(f"{name} {n}" for name, n in bad.items())
        yield Finding(
            Grade.POOR if share > DAMAGED else Grade.NOTE,
            "damage",
            f"{share:.1%} of the packets cannot be read ({table})",
        )


def _senders(heard: Heard) -> Iterator[Finding]:
    if n := heard.counters["other_sender"]:
        names = ", ".join(name for name, _ in heard.senders.most_common(4))
        chief = heard.senders.most_common(1)[0][0].rpartition(":")[0]
        yield Finding(
            Grade.POOR,
            "senders",
            f"several senders share the port ({names}); {n} packets of all but one were left out: "
            f"let each send to a port of its own, or name the one to hear, allow={chief}",
        )
    if n := heard.counters["refused"]:
        yield Finding(
            Grade.NOTE if heard.frames else Grade.WRONG,
            "refused",
            f"{n} packets of senders that the option allow does not name were not read",
        )


def _rate(heard: Heard) -> Iterator[Finding]:
    frames = heard.frames
    t = np.array([frame.t for frame in frames])
    nominal = frames[-1].layout.rate
    if len(frames) < 2 or t[-1] <= t[0]:
        yield Finding(Grade.WRONG, "rate", f"only {len(frames)} frames came")
        return
    arrived = np.diff(t)
    text = f"{len(frames)} frames in {heard.seconds:.1f} s: {(len(t) - 1) / (t[-1] - t[0]):.1f} Hz"
    text += f"; intervals p50 {_ms(arrived, 50)}, p99 {_ms(arrived, 99)} by arrival"
    stamped = np.diff([frame.t_device for frame in frames])
    if not np.isnan(stamped).any():
        text += f", p50 {_ms(stamped, 50)}, p99 {_ms(stamped, 99)} by the device's stamps"
    yield Finding(Grade.NOTE, "rate", text)
    rate = 1.0 / _interval(heard)
    if heard.convention and t[-1] - t[0] > 1.0 and abs(rate / nominal - 1) > RATE_OFF:
        options = {"rate": f"{rate:.4g}"} if "rate" in heard.known else {}
        advice = "" if options else ": set the sender's rate, or the rate in its layout, right"
        yield Finding(
            Grade.POOR,
            "layout-rate",
            f"the stream says that it has {nominal:g} Hz, and comes at {rate:.1f}{advice}",
            options,
        )
    late = float(np.percentile(arrived, 99))
    if late > max(JITTER / nominal, PAUSE):
        yield Finding(
            Grade.POOR,
            "jitter",
            f"frames come in bursts: a hundredth of them {late * 1000:.0f} ms or more after the "
            "one before. Wi-Fi does so: a cable helps; on USB, its adapter's latency timer",
        )


def _interval(heard: Heard) -> float:
    """Seconds between frames as they are sent: those that never came count as well."""
    steps = np.diff([frame.index for frame in heard.frames])
    sent = steps[(steps > 0) & (steps < heard.frames[-1].layout.rate)].sum() or len(steps)
    return float((heard.frames[-1].t - heard.frames[0].t) / sent)


def _step(heard: Heard, stamps: Array) -> float:
    """Seconds of the device's clock from a frame to the next, usually."""
    steps = np.diff([frame.index for frame in heard.frames])
    return float(np.median(np.diff(stamps) / np.maximum(steps, 1)))


def _losses(heard: Heard) -> Iterator[Finding]:
    count = heard.counters
    total = len(heard.frames) + count["missing"] + count["late"]
    lost = count["missing"] / total
    if lost:
        yield Finding(
            Grade.POOR if lost > LOST else Grade.NOTE,
            "lost",
            f"{count['missing']} of {total} frames never came ({lost:.1%})",
        )
    if count["late"]:
        depth = int(Url.parse(heard.address).options.get("reorder", "0"))
        options = {"reorder": str(max(2, depth + 1))} if heard.convention and depth < 3 else {}
        text = f"{count['late']} frames came after later ones, and too late"
        yield Finding(
            Grade.POOR if count["late"] > DAMAGED * total else Grade.NOTE, "late", text, options
        )
    if (n := count["duplicates"]) > LOST * total:
        yield Finding(
            Grade.POOR,
            "duplicates",
            f"{n} frames came more than once: does the sender send on two ways, or do two send?",
        )


def _clock(heard: Heard) -> Iterator[Finding]:
    t = np.array([frame.t for frame in heard.frames])
    stamps = np.array([frame.t_device for frame in heard.frames])
    if np.isnan(stamps).any() or len(t) < 2 or t[-1] <= t[0]:
        if heard.convention:
            yield Finding(Grade.NOTE, "clock", "the device sends no stamps: time is of arrival")
        return
    pace = _step(heard, stamps) / _interval(heard)
    if t[-1] - t[0] > 1.0 and abs(pace - 1) > STAMPS_OFF:
        yield Finding(
            Grade.POOR,
            "stamps",
            f"the device's stamps gain {pace:.4g} s in a second: are they no seconds? The sender "
            "has to send seconds",
        )
        return
    if n := heard.counters["clock_jumps"]:
        yield Finding(
            Grade.POOR,
            "clock-jumps",
            f"the device's clock was set {n} times meanwhile: its stamps should be of a clock that "
            "only runs",
        )
    text = f"the device's clock is {heard.offset:.3f} s behind the host's"
    if stamps[-1] - stamps[0] < DRIFT_KNOWN:
        text += f"; --seconds {DRIFT_KNOWN + 5:g} would tell its drift"
        yield Finding(Grade.NOTE, "clock", text)
        return
    grade = Grade.POOR if abs(heard.drift) > DRIFT_MOST else Grade.NOTE
    yield Finding(grade, "clock", f"{text} and loses {heard.drift * 1e6:.0f} ppm against it")


def _buffer(heard: Heard) -> Iterator[Finding]:
    if heard.receive_buffer is None:
        return
    sizes = sum(len(entry.data) + OVERHEAD for entry in heard.received)
    held = heard.receive_buffer / (sizes / heard.seconds)
    text = f"the receive buffer of {heard.receive_buffer >> 10} KiB holds {held:.1f} s of this"
    if held < SPARE:
        text += f": sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER}"
    yield Finding(Grade.POOR if held < SPARE else Grade.NOTE, "buffer", text)


def _ms(seconds: Array, percent: float) -> str:
    return f"{np.percentile(seconds, percent) * 1000:.2f} ms"
