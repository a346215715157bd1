"""The report of `markerbridge evaluate`: the tables and figures of the paper, for this model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bridge.model import ModelInfo
from training.evaluation import GAMMA_EDGES, Result, grouped, mean_scores, motion_category
from training.hiding import AFTER
from training.metrics import mean_known, row_mean
from training.report import paper
from training.report.body import body_figure
from training.report.page import Report, shown
from training.report.plots import categories_figure, frames_figure, gamma_figure, latency_figure

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

SHOWN = 3  # sequences drawn frame by frame where none are asked for
_CM_S = 12.0  # cm/s in one mm per 1/120 s
_JERKY = 99.0  # percentile of the frames without a transition above which a frame is jerky

_WITHIN = ("within 1 σ [%]", "within 2 σ [%]")
_PARTS = ("returning", "blending")  # of a marker that was hidden
_SCORES = (
    ("rms_mm", "RMS [mm]"),
    ("nn_rms_mm", "NN RMS [mm]"),
    ("rms_ratio", "ratio"),
    ("jerk_mm", "γ [mm per 1/120 s]"),
    ("nn_jerk_mm", "NN γ [mm per 1/120 s]"),
    ("jerk_ratio", "γ ratio"),
)


@dataclass(frozen=True, slots=True)
class Run:
    """What was run on what.

    model, data, train: names of the file and the folders, the last None without a baseline.
    recalled: how many of the captures scored are among those of `train`. command: the line that
    started it. leaves: local models; 0 of a network. results: of the model. by_history: of the
    same captures, mixed over so many frames of 1/120 s before the present one; 0 among them, empty
    for a network. shown: files to be drawn frame by frame. left_out: files that could not be used,
    and why.
    """

    model: str
    info: ModelInfo
    leaves: int
    data: str
    train: str | None
    recalled: int
    command: str
    results: Sequence[Result]
    by_history: Mapping[int, Sequence[Result]]
    shown: Sequence[str]
    left_out: Sequence[tuple[str, str]]


def evaluation_report(folder: Path, run: Run, found: Mapping[str, Any]) -> Report:
    """The report, not yet written. found: as `training.evaluation.report` gives it."""
    report = Report(folder, f"Evaluation of model {run.model} on {run.data}")
    _what_was_run(report, run)
    _beside_the_paper(report, run, found)
    _groups(report, run, found)
    _frame_by_frame(report, run)
    if run.leaves:
        _transitions(report, run)
        _histories(report, run)
    _by_marker(report, run, found)
    if "hidden" in found:
        _hidden(report, found["hidden"])
    _latency(report, run)
    _sequences(report, found)
    return report


def default_shown(results: Sequence[Result]) -> list[str]:
    """A file from each of the largest categories of motion: the one of median RMS."""
    scored = [result for result in results if result.scores.rms_mm is not None]
    groups = list(grouped(scored, motion_category).values())[:SHOWN]
    by_rms = [sorted(group, key=lambda result: result.scores.rms_mm or 0.0) for group in groups]
    return [group[(len(group) - 1) // 2].file for group in by_rms]


def _what_was_run(report: Report, run: Run) -> None:
    info, training = run.info, run.info.training
    frames = sum(result.frames for result in run.results)
    report.section(
        "What was run",
        "The model estimated every frame as the bridge does live, from the tracked markers alone. "
        f"Errors are those of the {len(info.unworn)} markers that nobody wears, against the "
        "capture; what the capture itself lacks is left out. “The paper” is Liu, Zhang, Wang and "
        "McMillan, Human Motion Estimation from a Reduced Marker Set (2006). Its captures were "
        "others than these, so its figures show where the method stood, not what must come out.",
    )
    rows = [
        ("command", run.command),
        ("model", f"{run.model} (estimator {info.estimator}, {_kind(run)})"),
        ("principal markers", ", ".join(info.principal)),
        ("reference markers", ", ".join(info.references)),
        (
            "trained on",
            f"{shown(training.get('sequences'))} sequences, {shown(training.get('frames'))} frames "
            f"(the paper: {paper.TRAIN_SEQUENCES}, {paper.TRAIN_FRAMES:,})",
        ),
        (
            "scored on",
            f"{run.data}: {len(run.results):,} sequences, {frames:,} frames "
            f"(the paper: {paper.TEST_SEQUENCES}, {paper.TEST_FRAMES:,})",
        ),
        (
            "nearest neighbour (NN)",
            f"searches the training poses of {run.train}" if run.train else "not run",
        ),
    ]
    if run.leaves:
        mixture = f"over {info.history} frames of 1/120 s before the present one"
        rows.insert(4, ("mixture", mixture))
    if run.recalled:
        rows.append(
            (
                "careful",
                f"{run.recalled} of the captures scored are among the training captures of "
                f"{run.train}: their errors are of what is recalled, not estimated",
            )
        )
    report.table("run", "The run.", ("what", "value"), rows)
    report.left_out(run.left_out)


def _kind(run: Run) -> str:
    return f"{run.leaves} local models" if run.leaves else "a network"


def _beside_the_paper(report: Report, run: Run, found: Mapping[str, Any]) -> None:
    notes = [
        "Means over the sequences. The paper does not say in which unit its velocity error is; the "
        "ratio to its nearest neighbour needs none."
    ]
    if run.train is None:
        notes.append(
            "No training captures were given (--train), so there is no nearest neighbour to "
            "compare with: its columns are empty."
        )
    if run.leaves and "forest_error" not in run.info.training:
        notes.append("The model was trained without measuring the error of its classifier.")
    report.section("Beside the paper", *notes)
    mean = found["mean"]
    jerk, nn_jerk = mean["jerk_mm"], mean["nn_jerk_mm"]
    rms_row = ("RMS error", "mm per marker", mean["rms_mm"], mean["nn_rms_mm"], mean["rms_ratio"])
    report.table(
        "paper",
        "Mean errors of this model and of nearest neighbour search (NN), and the paper's (4.2).",
        ("error", "unit", "this model", "NN", "ratio", "paper", "paper's NN", "paper's ratio"),
        [
            (*rms_row, paper.RMS_MM, paper.NN_RMS_MM, paper.RMS_RATIO),
            ("velocity error γ", "mm per 1/120 s", jerk, nn_jerk, mean["jerk_ratio"], *[None] * 3),
            (
                "velocity error γ",
                "cm/s",
                None if jerk is None else _CM_S * jerk,
                None if nn_jerk is None else _CM_S * nn_jerk,
                mean["jerk_ratio"],
                *[None] * 3,
            ),
            (
                "velocity error γ",
                "not stated",
                *[None] * 3,
                paper.JERK,
                paper.NN_JERK,
                paper.JERK_RATIO,
            ),
        ],
    )
    report.table(
        "figures",
        "Other figures that the paper gives. The classifier is the random forest that chooses the "
        "local model (a network has neither); its error is that on frames, or whole segments, of "
        "the training sequences that were held out.",
        ("figure", "this model", "paper", "in section"),
        _figures(run),
    )


def _figures(run: Run) -> list[tuple[str, float | None, float | None, str]]:
    """Each with our value, the paper's, and the section that gives it."""
    training = run.info.training
    error = training.get("forest_error") or {}
    percent = {name: None if share is None else 100 * share for name, share in error.items()}
    ratios = [result.scores.to_json()["jerk_ratio"] for result in run.results]
    below = [ratio <= 1 - paper.JERK_REDUCED_BY for ratio in ratios if ratio is not None]
    return [
        ("classifier error, frames [%]", percent.get("frames"), 100 * paper.FOREST_ERROR, "4.2"),
        ("classifier error, whole segments [%]", percent.get("segments"), None, ""),
        ("local models", run.leaves or None, paper.LEAVES, "4.2"),
        ("segments trained on", training.get("segments"), paper.SEGMENTS, "4.2"),
        (
            f"sequences with γ at least {100 * paper.JERK_REDUCED_BY:.0f} % below the nearest "
            "neighbour's [%] (the paper: “most”)",
            100 * sum(below) / len(below) if below else None,
            None,
            "4.2",
        ),
    ]


def _groups(report: Report, run: Run, found: Mapping[str, Any]) -> None:
    notes = ["Means over the sequences of each group; the dashed lines are the paper's means."]
    if "performers" not in run.info.training:
        notes.append("The model does not say whose motion it was trained on.")
    report.section("By motion and by performer", *notes)
    means = {
        name: mean_scores(group) for name, group in grouped(run.results, motion_category).items()
    }
    report.figure(
        "categories",
        "Error by kind of motion: RMS (left) and velocity error (right), of this model and of "
        "nearest neighbour search.",
        categories_figure(means),
    )
    for name, title, caption in (
        ("categories", "motion", "Errors by kind of motion."),
        (
            "performers",
            "performer",
            "Errors by whether the model was trained on other motion of the performer (seen), of "
            "others alone (new), or nobody knows.",
        ),
    ):
        report.table(
            f"{name}_errors",
            caption,
            (title, "sequences", "frames", *(column for _, column in _SCORES)),
            [
                (group, row["sequences"], row["frames"], *(row[score] for score, _ in _SCORES))
                for group, row in found[name].items()
            ],
        )


def _frame_by_frame(report: Report, run: Run) -> None:
    report.section(
        "Frame by frame",
        "As in the paper's figure 7. Above, the RMS error over the markers that nobody wears, the "
        "paper's means dashed; below, their mean velocity error (jerkiness).",
    )
    results = {result.file: result for result in run.results}
    # One that is asked for may have turned out too short to be scored.
    for number, result in enumerate((results[name] for name in run.shown if name in results), 1):
        motion = result.motion or "motion not described"
        report.figure(
            f"frames_{number}",
            f"{result.file}: {motion}, performer {result.subject}.",
            frames_figure(result),
        )


def _transitions(report: Report, run: Run) -> None:
    notes = [
        "As in the paper's figure 6, which shows its method before the mixture over the frames "
        "before is added: nearly all jerky frames are at transitions, that is where another local "
        "model has most votes than in the frame before. With the mixture a transition lasts as "
        "long as the mixture weighs in a frame before it.",
    ]
    if run.info.estimator != "paper":
        notes.append(
            "This model is not the paper's plain form: it weighs its local models by the votes "
            "also within one frame, so most transitions are gradual even without the mixture."
        )
    report.section("Transitions between local models", *notes)
    titles = {
        "without the mixture": run.by_history[0],
        f"with the mixture over {run.info.history} frames": run.results,
    }
    frames = {title: _jerk_and_transition(results) for title, results in titles.items()}
    jerk, transition = frames["without the mixture"]
    if transition.all():
        return  # without a frame, or without one apart
    jerky = float(np.percentile(jerk[~transition], _JERKY))
    rows = [(title, *_jerky_row(*part, jerky)) for title, part in frames.items()]
    at_transitions = " and ".join(f"{shown(row[4])} % {row[0]}" for row in rows)
    report.figure(
        "transitions",
        "Velocity errors of single markers, in transition frames and in the others, counted per "
        f"mm; from {GAMMA_EDGES[-2]:.0f} mm on all in one. Dotted: from "
        f"there on a frame is called jerky ({jerky:.1f} mm per 1/120 s, the {_JERKY:g}th "
        "percentile of the other frames' mean errors without the mixture). Of the jerky frames "
        f"{at_transitions} are at transitions; the paper: “nearly all” without it (3.4.2).",
        gamma_figure({title: _counts(results) for title, results in titles.items()}, jerky),
    )
    report.table(
        "jerky_frames",
        "Jerky frames, those with a mean velocity error above that.",
        (
            "",
            "frames",
            "of them at transitions [%]",
            "jerky frames",
            "of them at transitions [%]",
            "mean γ at transitions [mm per 1/120 s]",
            "mean γ of others [mm per 1/120 s]",
        ),
        rows,
    )


def _histories(report: Report, run: Run) -> None:
    report.section(
        "Length of the history",
        "The mixture weighs in the local models of h frames before the present one. The paper: "
        "“h = 10-30 works very well” (3.4.2).",
    )
    means = {length: mean_scores(results) for length, results in run.by_history.items()}
    report.table(
        "histories",
        f"Means over the sequences; h in frames of 1/120 s. The model's own is {run.info.history}.",
        ("h", "RMS [mm]", "γ [mm per 1/120 s]", "roughness"),
        [(length, m.rms_mm, m.jerk_mm, m.roughness) for length, m in means.items()],
    )


def _jerk_and_transition(results: Sequence[Result]) -> tuple[Array, Mask]:
    """Of all frames that have a velocity error: its mean (N,), and whether at a transition (N,)."""
    jerk = np.concatenate([result.trace.jerk for result in results])
    transition = np.concatenate([result.transition for result in results])
    known = ~np.isnan(jerk)
    return jerk[known], transition[known]


def _jerky_row(jerk: Array, transition: Mask, threshold: float) -> tuple[float | None, ...]:
    above = jerk > threshold
    return (
        len(jerk),
        _percent(transition),
        int(above.sum()),
        _percent(transition[above]),
        mean_known(jerk[transition]),
        mean_known(jerk[~transition]),
    )


def _percent(mask: Mask) -> float | None:
    return 100 * float(mask.mean()) if len(mask) else None


def _share(part: float | None) -> float | None:
    return None if part is None else 100 * part


def _counts(results: Sequence[Result]) -> npt.NDArray[np.int64]:
    total: npt.NDArray[np.int64] = np.sum([result.gamma for result in results], axis=0)
    return total


def _by_marker(report: Report, run: Run, found: Mapping[str, Any]) -> None:
    report.section("By marker")
    errors = marker_errors(run.results)
    labels = run.info.unworn
    told = {
        label: error
        for label, error in zip(labels, errors.tolist(), strict=True)
        if not np.isnan(error)
    }
    if told:
        report.figure(
            "body",
            "RMS error of each marker that nobody wears, in colour; the tracked markers are white. "
            "The body is the synthetic walker's.",
            body_figure(told, run.info.tracked, "RMS error [mm]"),
        )
    within = [found["sigma"][f"within_{n}"]["markers"] for n in (1, 2)]
    report.table(
        "markers",
        "RMS error of each marker, mean over the sequences, the largest first; and the share of "
        "its coordinate errors within one and two of the standard deviations that the estimator "
        "tells (68 and 95 % of a normal distribution).",
        ("marker", "RMS [mm]", *_WITHIN),
        [
            (labels[row], errors[row], *(_share(part[labels[row]]) for part in within))
            for row in np.argsort(-errors)
        ],
    )


def marker_errors(results: Sequence[Result]) -> Array:
    """Per unworn marker (U,) the root mean squared distance, mm; mean square over the sequences."""
    squared = np.array([result.squared_error for result in results])
    # A coordinate's squared error is a third of the squared distance.
    return 1000 * np.sqrt(3 * row_mean(squared.T))


def _hidden(report: Report, hidden: Mapping[str, Any]) -> None:
    rows, short = hidden["markers"], hidden["too_short"]
    which = f"Marker {rows[0]['marker']}" if len(rows) == 1 else "Each tracked marker in turn"
    report.section(
        "Hidden markers",
        f"{which} hidden for {hidden['seconds']:g} s, from every half second on, "
        f"{hidden['windows']} times.",
        f"When it returns nothing is to jump: the largest velocity error of any of the body's "
        f"markers in the {AFTER:g} s from then on. The capture's own jumps are in it: the row of "
        "no marker has the same frames with nothing hidden. Blending: the largest difference in "
        "velocity to those frames.",
        *([f"Too short for that: {', '.join(short)}."] if short else []),
    )
    if len(rows) > 1:
        rows = [*rows, hidden["mean"]]
    report.table(
        "hidden",
        "Errors of the hidden marker, the longer it is hidden; the share of its coordinate errors "
        "within one and two of the standard deviations that the estimator tells.",
        ("marker", "after [s]", "its error [mm]", "RMS of the unworn markers [mm]", *_WITHIN),
        [
            (
                row["marker"],
                at["age_s"],
                at["error_mm"],
                at["unworn_rms_mm"],
                *(_share(at[f"within_{n}"]) for n in (1, 2)),
            )
            for row in rows
            for at in row["ages"]
        ],
    )
    velocities = ("mean", "p99", "max")
    nothing = {"marker": "none", "returning": hidden["unhidden"], "blending": {}}
    report.table(
        "returning",
        "Sigma over all frames in which the marker is hidden; and the largest velocity error at "
        "its return, mm per 1/120 s, over all hidings.",
        (
            "marker",
            *_WITHIN,
            *(f"{part} {end} [mm per 1/120 s]" for part in _PARTS for end in velocities),
        ),
        [
            (
                row["marker"],
                *(_share(row.get(f"within_{n}")) for n in (1, 2)),
                *(row[part].get(f"{end}_mm") for part in _PARTS for end in velocities),
            )
            for row in [*rows, nothing]
        ],
    )


def _latency(report: Report, run: Run) -> None:
    seconds = np.concatenate([result.seconds for result in run.results])
    report.section(
        "Latency",
        "One call of the estimator from marker frame to pose: body frame, missing markers, "
        "estimate, and back to the world; measured here, while the evaluation ran.",
    )
    if not len(seconds):
        return
    middle, slow = (float(value) for value in np.percentile(1000 * seconds, (50, 99)))
    mean = 1000 * float(seconds.mean())
    report.figure(
        "latency",
        "Time per frame, both axes logarithmic. Dashed: the paper's mean, in Matlab on a 1.4 GHz "
        "laptop of its day.",
        latency_figure(seconds),
    )
    report.table(
        "latency_ms",
        "Time per frame; frames per second are those of the mean (the paper: “over 600”).",
        ("", "p50 [ms]", "p99 [ms]", "mean [ms]", "frames per second"),
        [
            ("this model", middle, slow, mean, round(1000 / mean)),
            ("the paper (4.2)", None, None, 1000 * paper.FRAME_S, paper.FRAMES_PER_SECOND),
        ],
    )


def _sequences(report: Report, found: Mapping[str, Any]) -> None:
    report.section("Every sequence")
    facts = ("file", "subject", "performer", "motion", "category", "frames")
    columns = ("file", "performer", "seen", "motion", "category", "frames")
    report.table(
        "sequences",
        "Errors of every sequence; γ is the mean velocity error, NN the nearest neighbour.",
        (*columns, *(column for _, column in _SCORES)),
        [
            (*(row[fact] for fact in facts), *(row[score] for score, _ in _SCORES))
            for row in found["sequences"]
        ],
    )
