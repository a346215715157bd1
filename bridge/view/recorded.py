"""A recording as moments to look at: the poses of a log, a capture, or either estimated anew."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from bridge.estimator import PoseEstimator
from bridge.model import Model, ModelInfo
from bridge.pose import Pose, Provenance
from bridge.truth import Truth
from bridge.view.player import Moment
from bridge.view.scene import Worn
from drivers.clock import VirtualClock
from drivers.errors import UsageError
from drivers.frame import Floats, SourceError
from drivers.log_source import TRUTH, play_log
from drivers.registry import open_source
from drivers.session_log import SessionLog
from drivers.url import Url

_LATER = 0.1  # s: a true pose is taken in so much later than its frame at most

Progress = Callable[[Iterable[Moment]], Iterable[Moment]]


class Take:
    """Moments in memory, 0.7 kB each, and half as much again with the truth."""

    def __init__(self, moments: Iterable[Moment], markers: int) -> None:
        poses: list[Pose] = []
        truths: list[Floats] = []
        nothing: Floats = np.full((markers, 3), np.nan, np.float32)
        for pose, truth in moments:
            poses.append(pose)
            truths.append(nothing if truth is None else truth)
        self._times = [(pose.index, pose.t) for pose in poses]
        self._xyz = np.array([pose.xyz for pose in poses], np.float32)
        self._provenance = np.array([pose.provenance for pose in poses], np.uint8)
        self._sigma = np.array([pose.sigma for pose in poses], np.float32)
        known = any(truth is not nothing for truth in truths)
        self._truth = np.array(truths, np.float32) if known else None

    def __len__(self) -> int:
        return len(self._times)

    def __getitem__(self, row: int) -> Moment:
        index, t = self._times[row]
        pose = Pose(index, t, self._xyz[row], self._provenance[row], self._sigma[row])
        truth = None if self._truth is None else self._truth[row]
        if truth is not None and np.isnan(truth).all():
            truth = None
        return Moment(pose, truth)


def recording_url(text: str) -> Url:
    """The address of a recording, or a path to one. Raises UsageError for any other address."""
    scheme = text.partition(":")[0]
    if Path(text).exists() or ":" not in text:
        scheme = "c3d" if Path(text.partition("?")[0]).suffix.lower() == ".c3d" else "log"
        text = f"{scheme}:{text}"
    if scheme not in ("c3d", "log"):
        raise UsageError(
            f"'{text}' is no recording: a path, log:FILE or c3d:FILE is; what comes now is shown "
            "by `markerbridge run SOURCE --to view:`"
        )
    return Url.parse(text)


def read_recording(
    url: Url, info: ModelInfo, model: Model | None, progress: Progress
) -> tuple[Take, Worn]:
    """The moments of a recording, and what was worn.

    model: estimates the body anew from the tracked markers; what a capture has is then the truth.
    Without one, a log's poses are shown as they were, and what a capture has is measured. Raises
    SourceError or UrlError, where there is nothing to show too.
    """
    if url.scheme == "log" and not model:
        log = SessionLog(Path(url.file_path()))
        url.finish()
        if not log.holds["poses"]:
            raise SourceError(
                f"{log.path} holds no poses: --model default estimates them from what came in"
            )
        moments, worn = _logged(log, info), _worn(log, info)
    elif model:
        moments, worn = _estimated(url, model), Worn.of(info)
    else:
        moments, worn = _measured(url, info), Worn()
    take = Take(progress(moments), len(info.labels))
    if not len(take):
        raise SourceError(f"{url.text} holds no frame that can be shown")
    return take, worn


def _logged(log: SessionLog, info: ModelInfo) -> Iterator[Moment]:
    """The poses of a log as they were."""
    clock = VirtualClock()
    truth = _truth(log, info, clock)
    for logged in log.poses():
        rows, columns = logged.layout.places(info.labels)
        count = len(info.labels)
        xyz: Floats = np.full((count, 3), np.nan, np.float32)
        provenance = np.full(count, Provenance.LOST, np.uint8)
        sigma: Floats = np.full(count, np.inf, np.float32)
        xyz[rows], provenance[rows] = logged.xyz[columns], logged.provenance[columns]
        sigma[rows] = logged.sigma[columns]
        t = logged.t - log.start
        pose = Pose(logged.index, t, xyz, provenance, sigma)
        yield Moment(pose, _true(truth, clock, logged.index, t))


def _estimated(url: Url, model: Model) -> Iterator[Moment]:
    """The frames of a recording through an estimator, on virtual time."""
    clock = VirtualClock()
    log = SessionLog(Path(url.file_path())) if url.scheme == "log" else None
    truth = _truth(log, model.info, clock) if log else None
    estimator = PoseEstimator(model)
    with play_log(log, url, clock) if log else open_source(url.text, clock) as source:
        for frame in source:
            if not set(model.info.tracked) & set(frame.layout.labels):
                raise SourceError(
                    f"{url.text}: none of the markers that the model tracks "
                    f"({', '.join(model.info.tracked)}) is among its own"
                )
            pose = estimator.step(frame)
            if log:
                yield Moment(pose, _true(truth, clock, frame.index, frame.t))
            else:
                yield Moment(pose, frame.ordered(model.info.labels))


def _measured(url: Url, info: ModelInfo) -> Iterator[Moment]:
    """The frames of a capture: what is there is measured, what is not is lost."""
    with open_source(url.text, VirtualClock()) as source:
        for frame in source:
            xyz = frame.ordered(info.labels)
            lost = np.isnan(xyz[:, 0])
            if frame.index == 0 and not set(frame.layout.labels) & set(info.labels):
                raise SourceError(
                    f"{url.text} has none of the {len(info.labels)} markers (it has "
                    f"{', '.join(frame.layout.labels)}): labels=THEIRS:OURS,... maps them"
                )
            provenance = np.where(lost, Provenance.LOST, Provenance.MEASURED).astype(np.uint8)
            sigma = np.where(lost, np.inf, 0.0).astype(np.float32)
            yield Moment(Pose(frame.index, frame.t, xyz, provenance, sigma), None)


def _truth(log: SessionLog, info: ModelInfo, clock: VirtualClock) -> Truth | None:
    """The true poses that a log has beside its source."""
    if TRUTH not in log.sources or log.sources.keys() == {TRUTH}:
        return None
    line = Url.parse(f"log:{log.path}").adding({"source": TRUTH})
    return Truth(play_log(log, line, clock), info.labels)


def _true(truth: Truth | None, clock: VirtualClock, index: int, t: float) -> Floats | None:
    if truth is None:
        return None
    clock.sleep_until(t + _LATER)
    truth.receive()
    return truth.at(index)


def _worn(log: SessionLog, info: ModelInfo) -> Worn:
    """What was worn in a recorded session: its model's markers."""
    try:
        tracked = json.loads(log.facts.get("tracked", "[]"))
    except (ValueError, RecursionError):
        tracked = []
    if not isinstance(tracked, list):
        tracked = []
    return Worn.among(tuple(label for label in info.labels if label in tracked))
