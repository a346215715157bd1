"""The missing-marker study in a report: curves and figures (paper section 5)."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from training.missing_study import (
    DAMPING,
    EXPERIMENTS,
    GAP,
    GAP_SHARE,
    HIDDEN,
    NUMBER,
    TITLES,
    MissingScore,
    methods_of,
)
from training.report.page import NEAREST, OURS, PALETTE, PAPER, Report, new_figure

_LINES = {  # label, colour and sign of each method
    "conditional": ("conditional Gaussian alone", PALETTE[2], "s"),
    "temporal": ("temporal: goes on as it went", PALETTE[4], "^"),
    "bridge": ("what the bridge does", OURS, "o"),
    "proximity": ("Breiman's proximities", NEAREST, "D"),
}
_WAYS = {
    "conditional": "The conditional Gaussian fills in each frame for itself.",
    "temporal": "Temporal: a marker goes on at its velocity in the body frame, which fades in "
    f"{DAMPING:g} s.",
    "bridge": "The bridge estimates from the markers present, as the model has learned to; what "
    "that was off by when a marker went missing is added, and fades.",
    "proximity": "Proximities: the mean of training poses, weighted by the trees in which they "
    "share a leaf with this one, repeated until the leaves stay the same (Breiman).",
}
_ROWS = (("rms_mm", "RMS (mm)"), ("jerk_mm", "jerkiness (mm per 1/120 s)"))


def add_missing(report: Report, scores: Sequence[MissingScore]) -> None:
    """Adds the section."""
    methods = methods_of(one.method for one in scores)
    report.section(
        "Missing markers",
        "Errors over the unworn markers, mean over the sequences, when tracked markers are missing "
        "and are filled in in different ways; all of them get the same samples.",
        f"So many markers at once, drawn at random, are hidden for {HIDDEN:g} s and then seen for "
        f"as long; gaps of one length take about {100 * GAP_SHARE:.0f} % of each marker's samples "
        "(the table has the share: long gaps in short captures vary); or single samples are "
        "dropped.",
        *(_WAYS[method] for method in methods),
    )
    report.figure(
        "missing",
        "RMS and jerkiness against what is missing. Dashed: nothing is missing.",
        missing_figure(scores),
    )
    report.table(
        "missing_scores",
        "The same as numbers; RMS also over the frames alone that lack a marker.",
        (
            "experiment",
            "value",
            "missing [%]",
            "method",
            "RMS [mm]",
            "RMS where missing [mm]",
            "γ [mm per 1/120 s]",
        ),
        [
            (
                TITLES[one.experiment],
                one.value,
                one.missing_percent,
                one.method,
                one.rms_mm,
                one.rms_missing_mm,
                one.jerk_mm,
            )
            for one in scores
        ],
    )


def missing_figure(scores: Sequence[MissingScore]) -> Figure:
    """A column of panels per experiment: RMS above, jerkiness below; a line per method."""
    figure, panels = new_figure(len(_ROWS), len(EXPERIMENTS), height=6.4, share_x=True)
    clean = next(one for one in scores if (one.experiment, one.value) == (NUMBER, 0))
    for axes in panels[1:3]:
        axes.sharey(panels[0])
    for (name, title), row in zip(_ROWS, (panels[:3], panels[3:]), strict=True):
        for (experiment, values), axes in zip(EXPERIMENTS.items(), row, strict=True):
            if (level := getattr(clean, name)) is not None:
                axes.axhline(level, color=PAPER, linestyle="--", linewidth=1)
            for method in methods_of(one.method for one in scores):
                label, colour, sign = _LINES[method]
                curve = [
                    (one.value, getattr(one, name))
                    for one in scores
                    if (one.method, one.experiment) == (method, experiment)
                ]
                axes.plot(
                    *zip(*curve, strict=True), color=colour, marker=sign, markersize=4, label=label
                )
            axes.set_xscale("log" if experiment == GAP else "linear")
            axes.set_xticks(values, labels=[f"{value:g}" for value in values])
            axes.minorticks_off()
        row[0].set_ylabel(title)
    for axes, experiment in zip(panels[3:], EXPERIMENTS, strict=True):
        axes.set_xlabel(TITLES[experiment])
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
