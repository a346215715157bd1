"""The run loop: frames from a source, through the estimator, to every sink. What they travel on
are the threads here and in the sinks' outlets.
"""

from __future__ import annotations

import logging
import math
import shlex
import threading
from collections import Counter, deque
from dataclasses import dataclass, replace
from typing import Any

from bridge.estimator import PoseEstimator
from bridge.humanoid.solver import HumanoidSolver
from bridge.pose import Pose, Provenance
from bridge.sinks.outlet import COUNTED, Outlet, Tap
from bridge.sinks.sink import Sink, SinkContext, SinkError
from bridge.statistics import Ages, Hop, MarkerStatus, Mean, Presence
from bridge.truth import Truth, rms_mm
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.frame import Floats, Layout, MarkerFrame, Source, SourceError
from drivers.log_source import TRUTH, LogFrames, LogSource
from drivers.session_log import OPENED, LineEvent
from drivers.wire_source import WireSource

log = logging.getLogger(__name__)

FIFO = 1.0  # s of frames that may wait for the estimator
SILENT = 1.0  # s without a frame after which the stream has no rate
POLL = 0.1  # s between looks at whether to stop


@dataclass(frozen=True, slots=True)
class Status:
    """A session at one moment, for the terminal and for machines; times in seconds, errors in mm.

    silent: since a frame was last taken in. ages: by hop. `delay`: of a frame when it comes in,
    more than the quickest of a minute; none where the device sends no stamps. `queue`: when the
    estimator takes it, since it came in; `estimate`: when its pose is known, since then as well;
    and so for each sink `age`, when it is sent. markers: the tracked ones, by label. truth:
    counters of its source, None where there is none.
    """

    model: str
    seconds: float
    silent: float
    frames: int
    rate: float
    layout_rate: float | None
    ages: dict[str, Ages]
    rms_mm: float | None  # over all markers, mean of all frames with a known truth
    rms_now_mm: float | None
    markers: dict[str, MarkerStatus]
    imputed_samples: int
    lost_frames: int
    missing_indices: int
    waiting: int
    source: dict[str, int]
    truth: dict[str, int] | None
    sinks: dict[str, dict[str, Any]]


class Session:
    """One performer's stream. `handle` takes a frame through; `run` does so live, with threads.

    truth: where the simulator sends the clean poses, joined by frame index for the meter.
    """

    def __init__(
        self,
        source: Source,
        estimator: PoseEstimator,
        sinks: list[Sink],
        context: SinkContext,
        *,
        truth: Truth | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.source = source
        self.last_pose: Pose | None = None
        self._estimator = estimator
        self._context = context
        self._outlets = [Outlet(sink, clock) for sink in sinks]
        self._recording = [outlet for outlet in self._outlets if outlet.sink.records]
        wanted = any(sink.wants_posture for sink in sinks)
        self._humanoid = HumanoidSolver(context.info) if wanted else None
        self._truth = truth
        self._clock = clock
        self._started = self._taken = clock.now()
        self._fifo: deque[MarkerFrame] = deque()
        self._wake = threading.Condition()
        self._source_error: Exception | None = None
        self._counters: Counter[str] = Counter()
        self._hops = {name: Hop() for name in ("delay", "queue", "estimate")}
        info = context.info
        self._presence = Presence({label: info.labels.index(label) for label in info.tracked})
        self._rms = Mean()
        self._arrivals: deque[float] = deque(maxlen=240)
        self._layout: Layout | None = None
        self._closed = False
        context.model = estimator.model.path
        self._tap("source", source)
        if truth:
            self._tap(TRUTH, truth.source)

    def handle(self, frame: MarkerFrame) -> Pose:
        """Estimates the pose at one frame and hands it to every sink.

        Raises SourceError where the first layout has no marker that the model tracks.
        """
        self._taken = self._clock.now()
        if frame.layout is not self._layout:
            self._adopt(frame.layout)
        if self._truth:
            self._truth.receive()
        self._record(frame)
        pose = self._estimator.step(frame)
        if self._humanoid:
            pose = replace(pose, posture=self._humanoid.solve(pose))
        estimated = self._clock.now()
        for outlet in self._outlets:
            outlet.put(pose)
        self._count(frame, pose, estimated)
        return pose

    def run(self, stop: threading.Event, seconds: float | None = None) -> None:
        """Handles frames until `stop` is set, the source ends, or `seconds` have passed.

        Raises what the source raised, after all that it delivered has been handled.
        """
        self._started = self._taken = self._clock.now()
        end = None if seconds is None else self._started + seconds
        for outlet in self._outlets:
            outlet.start()
        finished = threading.Event()
        reader = threading.Thread(target=self._read, args=(finished,), name="source", daemon=True)
        reader.start()
        try:
            while not stop.is_set() and (end is None or self._clock.now() < end):
                with self._wake:
                    if not self._fifo:
                        if not reader.is_alive():
                            break
                        self._wake.wait(POLL)
                    frame = self._fifo.popleft() if self._fifo else None
                    self._wake.notify_all()
                if frame is not None:
                    self.handle(frame)
                else:
                    self._tell_lost()
        finally:
            finished.set()
            reader.join(2.0)
        while self._fifo:  # what has come in goes out
            self.handle(self._fifo.popleft())
        if self._source_error:
            raise self._source_error

    def close(self) -> None:
        """Closes source and sinks, recordings whole; a second call does nothing.

        Raises SinkError where a recording could not be saved, after all else is closed.
        """
        if self._closed:
            return
        self._closed = True
        self.source.close()
        if self._truth:
            self._truth.source.close()
        errors = []
        for outlet in self._outlets:
            try:
                outlet.close()
            except SinkError as error:
                errors.append(error)
        if errors:
            raise errors[0]

    @property
    def last_truth(self) -> Floats | None:
        """The true pose at the last pose's frame, where it is known."""
        return None if self.last_pose is None else self._context.truth(self.last_pose.index)

    def status(self) -> Status:
        """What the session has done so far."""
        now = self._clock.now()
        return Status(
            model=str(self._estimator.model.path),
            seconds=now - self._started,
            silent=now - self._taken,
            frames=self._counters["frames"],
            rate=self._recent_rate(),
            layout_rate=self.source.layout.rate if self.source.layout else None,
            ages={name: hop.ages(now) for name, hop in self._hops.items()},
            rms_mm=self._rms.mean,
            rms_now_mm=self._rms.last,
            markers=self._presence.markers(now),
            imputed_samples=self._counters["imputed"],
            lost_frames=self._counters["lost"],
            missing_indices=self.source.counters["missing"],
            waiting=len(self._fifo),
            source=dict(self.source.counters) | {"fifo_overflow": self._counters["fifo_overflow"]},
            truth=dict(self._truth.source.counters) if self._truth else None,
            sinks={
                outlet.sink.name: {
                    **{name: outlet.counters[name] for name in COUNTED},
                    "last_error": outlet.last_error,
                    "age": outlet.hop.ages(now),
                }
                for outlet in self._outlets
            },
        )

    def _tap(self, name: str, source: Source) -> None:
        """Lets the sinks that record know all that comes over a source's line."""
        if not self._recording:
            return
        address = source.address if isinstance(source, LogSource) else source.name
        for outlet in self._recording:
            outlet.record(LineEvent(name, self._clock.now(), OPENED, address))
        if isinstance(source, WireSource):
            source.recorder = Tap(name, self._recording)

    def _record(self, frame: MarkerFrame) -> None:
        for outlet in self._recording:
            outlet.record(frame)

    def _tell_lost(self) -> None:
        """Where frames came and come no more, engines and view are told that the pose is lost, ten
        times a second: else a body would stand there as if nothing had happened.
        """
        now = self._clock.now()
        if self.last_pose is None or now - self._taken < SILENT:
            return
        lost = self.last_pose.lost(now)
        for outlet in self._outlets:
            if outlet.sink.waiting is not None:  # what keeps all poses is for those that were
                outlet.put(lost)

    def _adopt(self, layout: Layout) -> None:
        """Takes in a new layout; says which tracked markers the stream does not carry."""
        info, name = self._context.info, self.source.name
        lacking = [label for label in info.tracked if label not in layout.labels]
        foreign = [label for label in layout.labels if label not in info.labels]
        advice = ""
        if foreign and not isinstance(self.source, LogFrames):
            advice = (
                ": the option labels=THEIRS:OURS,... maps its names to these, and "
                f"`markerbridge doctor {shlex.quote(name)}` tells which is which"
            )
        if len(lacking) == len(info.tracked) and self._layout is None:
            raise SourceError(
                f"{name}: none of the markers that the model tracks ({', '.join(info.tracked)}) "
                f"is among the stream's ({', '.join(layout.labels)}){advice}"
            )
        if lacking:
            others = f", but {', '.join(foreign)}{advice}" if advice else ""
            log.warning(
                "%s: the stream has no %s, imputed throughout%s",
                *(name, ", ".join(lacking), others),
            )
        self._layout = layout
        self._context.rate = layout.rate
        for outlet in self._outlets:
            outlet.stream_rate = layout.rate

    def _read(self, finished: threading.Event) -> None:
        """The reader's thread: nothing but reading, so the line is never kept waiting."""
        try:
            while not finished.is_set() and not self.source.exhausted:
                frame = self.source.read(POLL)
                if frame is None:
                    continue
                room = max(2.0, FIFO * frame.layout.rate)
                with self._wake:
                    while not self.source.live and len(self._fifo) >= room:
                        if finished.is_set():
                            return
                        self._wake.wait(POLL)
                    self._fifo.append(frame)
                    if len(self._fifo) > room:
                        self._record(self._fifo.popleft())
                        self._counters["fifo_overflow"] += 1
                    self._wake.notify_all()
        except Exception as error:  # for the caller's thread to raise
            self._source_error = error
        finally:
            with self._wake:
                self._wake.notify_all()

    def _count(self, frame: MarkerFrame, pose: Pose, estimated: float) -> None:
        self.last_pose = pose
        if not (math.isnan(frame.t_device) or math.isnan(frame.t_mapped)):
            self._hops["delay"].passed(frame.t_mapped, frame.t)
        self._hops["queue"].passed(frame.t, self._taken)
        self._hops["estimate"].passed(frame.t, estimated)
        self._presence.add(pose.provenance, frame.t)
        self._counters["frames"] += 1
        self._counters["imputed"] += int((pose.provenance == Provenance.IMPUTED).sum())
        self._counters["lost"] += bool((pose.provenance == Provenance.LOST).all())
        if self._arrivals and frame.t - self._arrivals[-1] > SILENT:
            self._arrivals.clear()  # a stream that begins anew is no slow one
        self._arrivals.append(frame.t)
        truth = self._context.truth(frame.index)
        if truth is not None:
            self._rms.add(rms_mm(pose.xyz, truth))

    def _recent_rate(self) -> float:
        if len(self._arrivals) < 2 or self._arrivals[-1] <= self._arrivals[0]:
            return 0.0
        if self._clock.now() - self._arrivals[-1] > SILENT:
            return 0.0
        return (len(self._arrivals) - 1) / (self._arrivals[-1] - self._arrivals[0])
