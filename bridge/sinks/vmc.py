"""Virtual Motion Capture protocol: `vmc://127.0.0.1:39539`, every marker as a tracker.

Per frame one bundle: /VMC/Ext/OK i, /VMC/Ext/T f (seconds since the first pose: epoch seconds
would not fit a float32), /VMC/Ext/Tra/Pos s 7f per marker (its label; position in Unity's space;
no rotation: a marker is a point). See https://protocol.vmc.info.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from bridge.pose import Pose
from bridge.sinks.sink import Sink, SinkContext
from drivers.coordinates import FRAMES
from drivers.options import positive
from drivers.udp_sender import UdpSender
from drivers.url import Url

_BUNDLE_HEAD = 16  # bytes: "#bundle" and the time tag


class VmcSink(Sink):
    """Trackers for VMC receivers. Before the first known pose it says "not ready" (OK 0)."""

    def __init__(self, url: Url, context: SinkContext) -> None:
        self.name = url.text
        self.rate = url.take("rate", 250.0, positive)  # receivers have crashed above
        url.finish()
        self._out = UdpSender(*url.address(39539))
        trackers = [_tracker(label) for label in context.info.labels]
        self._known = _Bundles([_ok(1), _time(), *trackers], self._out.limit)
        self._unknown = _Bundles([_ok(0), _time()], self._out.limit)
        self._start: float | None = None

    def __call__(self, pose: Pose) -> None:
        if self._start is None:
            self._start = pose.t
        seconds = pose.t - self._start
        if np.isnan(pose.xyz).any():
            bundles = self._unknown.filled(np.array([seconds]))
        else:
            trackers = np.zeros((len(pose.xyz), 7))
            trackers[:, :3] = FRAMES["unity"].from_ours(pose.xyz)
            trackers[:, 6] = 1.0
            bundles = self._known.filled(np.concatenate(([seconds], trackers.ravel())))
        for bundle in bundles:
            self._out.send(bundle)

    def close(self) -> None:
        self._out.close()


class _Bundles:
    """Messages built once, in bundles of at most `limit` bytes; then only their floats change."""

    def __init__(self, messages: list[OscMessage], limit: int) -> None:
        self._parts: list[tuple[bytearray, np.ndarray]] = []
        for group in _grouped(messages, limit):
            builder = OscBundleBuilder(IMMEDIATELY)
            places: list[int] = []
            end = _BUNDLE_HEAD
            for message in group:
                builder.add_content(message)
                end += 4 + len(message.dgram)
                floats = sum(isinstance(value, float) for value in message.params)
                # The floats are the last arguments of every message here, and all is 4-aligned.
                places.extend(range(end // 4 - floats, end // 4))
            self._parts.append((bytearray(builder.build().dgram), np.array(places, int)))

    def filled(self, values: np.ndarray) -> Iterator[bytearray]:
        """The bundles with `values` for their floats, in order; overwritten by the next call."""
        for datagram, places in self._parts:
            np.frombuffer(datagram, ">f4")[places] = values[: len(places)]
            values = values[len(places) :]
            yield datagram


def _grouped(messages: list[OscMessage], limit: int) -> Iterator[list[OscMessage]]:
    group: list[OscMessage] = []
    size = _BUNDLE_HEAD
    for message in messages:
        length = 4 + len(message.dgram)
        if group and size + length > limit:
            yield group
            group, size = [], _BUNDLE_HEAD
        group.append(message)
        size += length
    yield group


def _ok(value: int) -> OscMessage:
    builder = OscMessageBuilder("/VMC/Ext/OK")
    builder.add_arg(value, "i")
    return builder.build()


def _time() -> OscMessage:
    builder = OscMessageBuilder("/VMC/Ext/T")
    builder.add_arg(0.0, "f")
    return builder.build()


def _tracker(label: str) -> OscMessage:
    builder = OscMessageBuilder("/VMC/Ext/Tra/Pos")
    builder.add_arg(label, "s")
    for _ in range(7):
        builder.add_arg(0.0, "f")
    return builder.build()
