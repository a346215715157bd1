"""One performer's way through the bridge: marker frames, estimator, every sink."""

from __future__ import annotations

import logging
import math
import shlex
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from bridge.estimator import PoseEstimator
from bridge.pose import Pose
from bridge.regression import Estimate
from bridge.rehearsal import Rehearsal
from bridge.sinks.outlet import COUNTED, Outlet, Tap
from bridge.sinks.sink import Sink, SinkContext, close_all
from bridge.statistics import Ages, Hop, MarkerStatus, Mean, Presence
from bridge.truth import Truth, rms_mm
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.frame import Floats, Layout, MarkerFrame, Source, SourceError
from drivers.log_source import TRUTH, LogFrames, LogSource
from drivers.session_log import OPENED, LineEvent
from drivers.wire_source import WireSource

if TYPE_CHECKING:
    from bridge.humanoid.solver import HumanoidSolver

log = logging.getLogger(__name__)

SILENT = 1.0  # s without a frame after which the stream has no rate
HOPS = ("delay", "parse", "queue", "estimate")  # beside the sinks


@dataclass(frozen=True, slots=True)
class Status:
    """A session at one moment, for the terminal and for machines; times in seconds, errors in mm.

    silent: since a frame was last taken in. ages: by hop. `delay`: of a frame when it comes in,
    more than the quickest of a minute; none where the device sends no stamps. All others since it
    came in: `parse`, when it is read; `queue`, when the estimator takes it; `estimate`, when its
    pose is known; and for each sink `age`, when it is sent. markers: the tracked ones, by label.
    truth: counters of its source, None where there is none. performers: of several, each one's
    own; all else is then of all of them, markers by `PERFORMER:LABEL`.
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
    performers: dict[str, Status] = field(default_factory=dict)


@dataclass(slots=True)
class Backlog:
    """Frames of a source that wait, and how many were dropped because too many did."""

    frames: deque[MarkerFrame] = field(default_factory=deque)
    overflow: int = 0


class Session:
    """One performer's stream; `handle` takes a frame through (`bridge.stage` does so live).

    truth: where the simulator sends the clean poses, joined by frame index for the meter. shared:
    the source's line is that of others, too, so that it is not recorded.
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
        shared: bool = False,
    ) -> None:
        self.source = source
        self.backlog = Backlog()
        self.last_pose: Pose | None = None
        self.estimator = estimator
        self.outlets = [Outlet(sink, clock) for sink in sinks]
        self._context = context
        self._recording = [outlet for outlet in self.outlets if outlet.sink.records]
        wanted = any(sink.wants_posture for sink in sinks)
        self._humanoid = _humanoid(context) if wanted else None
        self._rehearsal: Rehearsal | None = None
        self._frame: MarkerFrame | None = None  # the last one
        self._truth = truth
        self._clock = clock
        self._started = self._taken = clock.now()
        self._counters: Counter[str] = Counter()
        self._hops = {name: Hop() for name in HOPS}
        info = context.info
        self._presence = Presence({label: info.labels.index(label) for label in info.tracked})
        self._rms = Mean()
        self._arrivals: deque[float] = deque(maxlen=240)
        self._layout: Layout | None = None
        self._closed = False
        context.model = estimator.model.path
        if not shared:
            self._tap("source", source)
        if truth:
            self._tap(TRUTH, truth.source)

    @property
    def performer(self) -> str:
        """Whose it is; empty where there is one alone."""
        return self._context.performer

    def start(self) -> None:
        """From now on time counts, and sinks have threads of their own."""
        self._started = self._taken = self._clock.now()
        for outlet in self.outlets:
            outlet.start()

    def handle(self, frame: MarkerFrame) -> Pose:
        """Estimates the pose at one frame and hands it to every sink.

        Raises SourceError where the first layout has no marker that the model tracks, unless there
        may be other performers, who go on.
        """
        held = self.begin(frame)
        if held is not None:
            return held
        return self.finish(frame, self.estimator.ask())

    def begin(self, frame: MarkerFrame) -> Pose | None:
        """The first half of `handle`, up to what the estimator asks its regression; where it has
        nothing to ask, the pose, and there is no second half.
        """
        self._taken = self._clock.now()
        if frame.layout is not self._layout:
            self._adopt(frame.layout)
        if self._truth:
            self._truth.receive()
        self.record(frame)
        held = self.estimator.begin(frame)
        return None if held is None else self._deliver(frame, held)

    def finish(self, frame: MarkerFrame, estimate: Estimate) -> Pose:
        """The second half, with what the regression says."""
        return self._deliver(frame, self.estimator.finish(frame, estimate))

    def rehearse(self) -> None:
        """Makes the next frame quicker; of no effect on it otherwise. By one thread at a time."""
        if self._frame is None:
            return
        if self._rehearsal is None:
            humanoid = _humanoid(self._context) if self._humanoid else None
            self._rehearsal = Rehearsal(self.estimator.model, humanoid)
        self._rehearsal(self._frame)

    def record(self, frame: MarkerFrame) -> None:
        """Tells the sinks that record of a frame."""
        for outlet in self._recording:
            outlet.record(frame)

    def tell_lost(self) -> None:
        """Where frames came and come no more, engines and view are told that the pose is lost: else
        a body would stand there as if nothing had happened. To be called some times a second.
        """
        now = self._clock.now()
        if self.last_pose is None or now - self._taken < SILENT:
            return
        lost = self.last_pose.lost(now)
        for outlet in self.outlets:
            if outlet.sink.waiting is not None:  # what keeps all poses is for those that were
                outlet.put(lost)

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
        close_all(self.outlets)

    @property
    def last_truth(self) -> Floats | None:
        """The true pose at the last pose's frame, where it is known."""
        return None if self.last_pose is None else self._context.truth(self.last_pose.index)

    def status(self) -> Status:
        """What the session has done so far."""
        now = self._clock.now()
        return Status(
            model=str(self.estimator.model.path),
            seconds=now - self._started,
            silent=now - self._taken,
            frames=self._counters["frames"],
            rate=self._recent_rate(),
            layout_rate=self.source.layout.rate if self.source.layout else None,
            ages={name: hop.ages(now) for name, hop in self._hops.items()},
            rms_mm=self._rms.mean,
            rms_now_mm=self._rms.last,
            markers=self._presence.markers(now),
            imputed_samples=self._presence.imputed,
            lost_frames=self._presence.lost,
            missing_indices=self.source.counters["missing"],
            waiting=len(self.backlog.frames),
            source=dict(self.source.counters) | {"fifo_overflow": self.backlog.overflow},
            truth=dict(self._truth.source.counters) if self._truth else None,
            sinks={
                outlet.sink.name: {
                    **{name: outlet.counters[name] for name in COUNTED},
                    "last_error": outlet.last_error,
                    "age": outlet.hop.ages(now),
                }
                for outlet in self.outlets
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

    def _adopt(self, layout: Layout) -> None:
        """Takes in a new layout; says which tracked markers the stream does not carry."""
        info, name = self._context.info, self.source.name
        whose = f"{name}: {self.performer}" if self.performer else name
        lacking = [label for label in info.tracked if label not in layout.labels]
        foreign = [label for label in layout.labels if label not in info.labels]
        advice = ""
        if foreign and not isinstance(self.source, LogFrames):
            advice = (
                ": the option labels=THEIRS:OURS,... maps its names to these, and "
                f"`markerbridge doctor {shlex.quote(name)}` tells which is which"
            )
        if len(lacking) == len(info.tracked):
            problem = (
                f"{whose}: none of the markers that the model tracks ({', '.join(info.tracked)}) "
                f"is among the stream's ({', '.join(layout.labels)}){advice}"
            )
            if self._layout is None and not self.performer:
                raise SourceError(problem)
            log.warning("%s", problem)  # the others' show goes on
        elif lacking:
            others = f", but {', '.join(foreign)}{advice}" if advice else ""
            log.warning(
                "%s: the stream has no %s, imputed throughout%s",
                *(whose, ", ".join(lacking), others),
            )
        self._layout = layout
        self._context.rate = layout.rate
        for outlet in self.outlets:
            outlet.stream_rate = layout.rate

    def _deliver(self, frame: MarkerFrame, pose: Pose) -> Pose:
        """Hands a pose, with its times, to every sink; then counts it, as that delays nobody."""
        posture = self._humanoid.solve(pose) if self._humanoid else None
        estimated = self._clock.now()
        pose = Pose(
            *(pose.index, pose.t, pose.xyz, pose.provenance, pose.sigma, posture),
            *(self._context.performer, frame.t_mapped, frame.t_parsed, estimated),
        )
        for outlet in self.outlets:
            outlet.put(pose)
        self._count(frame, pose)
        return pose

    def _count(self, frame: MarkerFrame, pose: Pose) -> None:
        self.last_pose, self._frame = pose, frame
        hops = self._hops
        if not (math.isnan(frame.t_device) or math.isnan(frame.t_mapped)):
            hops["delay"].passed(frame.t_mapped, frame.t)
        if not math.isnan(frame.t_parsed):
            hops["parse"].passed(frame.t, frame.t_parsed)
        hops["queue"].passed(frame.t, self._taken)
        hops["estimate"].passed(frame.t, pose.t_estimated)
        self._presence.add(pose.provenance, frame.t)
        self._counters["frames"] += 1
        if self._arrivals and frame.t - self._arrivals[-1] > SILENT:
            self._arrivals.clear()  # a stream that begins anew is no slow one
        self._arrivals.append(frame.t)
        truth = self._context.truth(frame.index)
        if truth is not None:
            self._rms.add(rms_mm(pose.xyz, truth))

    def _recent_rate(self) -> float:
        arrivals = self._arrivals.copy()  # another thread may clear them
        if len(arrivals) < 2 or arrivals[-1] <= arrivals[0]:
            return 0.0
        if self._clock.now() - arrivals[-1] > SILENT:
            return 0.0
        return (len(arrivals) - 1) / (arrivals[-1] - arrivals[0])


def _humanoid(context: SinkContext) -> HumanoidSolver:
    from bridge.humanoid.solver import HumanoidSolver  # compiled: of no use to many a session

    return HumanoidSolver(context.info)
