"""The report of `markerbridge select-markers`: how sure the choice of markers is (paper 3.1.2), and
how it does beside others (paper section 5).
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from bridge.body_frame import REFERENCES
from training.corpus import Corpus
from training.marker_selection import RESTARTS, VARIANCE
from training.report import paper
from training.report.body import body_figure
from training.report.page import OURS, PALETTE, PAPER, Report, new_figure
from training.selection_study import SelectionStudy
from training.set_comparison import SetScores

_SETS = 15  # most frequent sets in the table
_OTHER = PALETTE[5]  # markers that training does not take


def selection_report(
    folder: Path,
    study: SelectionStudy,
    compared: Sequence[SetScores],
    corpus: Corpus,
    command: str,
    left_out: Sequence[tuple[str, str]],
) -> Report:
    """The report, not yet written. compared: the automatic set first, empty where none was asked
    for. command: the line that started it; left_out: what could not be used, and why.
    """
    report = Report(folder, "Choice of principal markers")
    _what_was_run(report, study, corpus, command, left_out)
    _frequencies(report, study)
    _sets(report, study)
    if compared:
        _comparison(report, compared)
    return report


def _what_was_run(
    report: Report,
    study: SelectionStudy,
    corpus: Corpus,
    command: str,
    left_out: Sequence[tuple[str, str]],
) -> None:
    report.section(
        "What was run",
        "The fewest markers that tell most of the body are chosen from the principal components of "
        "all poses: the coordinates are put into clusters by K-means, and markers are taken away "
        "as long as all clusters are covered. K-means starts at random, so the choice is made many "
        "times, each time from its own seed. “The paper” is Liu, Zhang, Wang and McMillan, Human "
        "Motion Estimation from a Reduced Marker Set (2006); its captures were others.",
    )
    report.table(
        "study",
        "The study.",
        ("", ""),
        (
            ("command", command),
            ("captures", f"{len(corpus.captures):,}, {corpus.frames.sum():,} complete frames"),
            ("runs", f"{len(study.runs):,} (each one in runs.csv)"),
            ("starts of K-means in each", f"{study.restarts:,} (the paper does not say)"),
            (
                "principal components",
                f"{study.chosen.components}, for {100 * VARIANCE:.0f} % of the variance",
            ),
            ("clusters", f"{study.chosen.clusters}"),
            ("what training takes", f"{', '.join(study.chosen.markers)} (of {RESTARTS:,} starts)"),
            ("worn in any case", ", ".join(REFERENCES)),
        ),
    )
    report.left_out(left_out)


def _frequencies(report: Report, study: SelectionStudy) -> None:
    shares = study.shares
    stable = [label for label, share in shares.items() if share > paper.SELECTED_IN]
    report.section(
        "How often each marker is chosen (figure 4)",
        f"The paper found the same {paper.SELECTED_MARKERS} markers in more than "
        f"{100 * paper.SELECTED_IN:.0f} % of its {paper.SELECTION_RUNS:,} runs. Here "
        f"{', '.join(stable) or 'no marker'} {'are' if len(stable) > 1 else 'is'} chosen as often; "
        f"{len(shares)} markers are chosen in some run. Of the {len(study.chosen.markers)} that "
        f"training takes a run has {study.shared:.1f} on average.",
        "Markers that sit near each other, or on the two sides of the body, tell much the same, "
        "and can stand for each other from run to run. So training does not trust to a few starts "
        f"of K-means: it takes the best of {RESTARTS:,}.",
    )
    report.figure(
        "figure_4",
        f"Share of {len(study.runs):,} runs in which each marker is chosen, and how many markers a "
        "run chooses.",
        frequency_figure(study),
    )
    report.table(
        "shares",
        "The same as numbers.",
        ("marker", "runs [%]", "taken by training"),
        [
            (label, 100 * share, "yes" if label in study.chosen.markers else "")
            for label, share in shares.items()
        ],
    )
    report.figure(
        "body",
        "The same on a body. White: the references, worn in any case and never chosen.",
        body_figure(
            {label: 100 * shares.get(label, 0.0) for label in study.labels},
            REFERENCES,
            "chosen in so many of the runs [%]",
        ),
    )


def _sets(report: Report, study: SelectionStudy) -> None:
    sets = list(study.sets.items())
    report.section(
        "Sets",
        f"The runs choose {len(sets):,} different sets; the most frequent one in "
        f"{100 * sets[0][1]:.1f} % of the runs.",
    )
    report.table(
        "sets",
        f"The most frequent sets, at most {_SETS}.",
        ("markers", "number", "runs [%]"),
        [(", ".join(markers), len(markers), 100 * share) for markers, share in sets[:_SETS]],
    )


def _comparison(report: Report, compared: Sequence[SetScores]) -> None:
    report.section(
        "Automatic and manual sets",
        "The paper asks how markers chosen by hand, for example on the extremities, would do. Here "
        "models are trained with each set, every one without some of the performers, and scored on "
        "the real captures of these (of files left out, where nobody says who performed). RMS over "
        "all 41 markers, the worn ones being exact, compares sets of different size as well.",
        "The automatic set was chosen once, from all captures, those of the performers left out "
        "among them; no more of them than that reached the models.",
    )
    manual = {f"manual {number}": one for number, one in enumerate(compared[1:], 1)}
    add_comparison(report, {"automatic": compared[0], **manual})


def add_comparison(report: Report, compared: Mapping[str, SetScores]) -> None:
    """The scores of sets, by their names, as a figure and tables; the first is the one chosen."""
    report.figure(
        "comparison",
        "RMS over all 41 markers: bars are means over the captures, dots the performers left out, "
        "a line from set to set for each.",
        comparison_figure(compared),
    )
    report.table(
        "compared",
        "Means over the captures of the performers left out.",
        (
            "set",
            "principal markers",
            "number",
            "RMS, unworn [mm]",
            "RMS, all 41 [mm]",
            "jerkiness [mm per 1/120 s]",
        ),
        [
            (
                name,
                ", ".join(one.principal),
                len(one.principal),
                one.mean.rms_mm,
                one.mean.rms_all_mm,
                one.mean.jerk_mm,
            )
            for name, one in compared.items()
        ],
    )
    report.table(
        "performers",
        "RMS over all 41 markers by performer left out, mm.",
        ("left out", *compared),
        [
            (fold, *(one.left_out[fold].rms_all_mm for one in compared.values()))
            for fold in next(iter(compared.values())).left_out
        ],
    )


def frequency_figure(study: SelectionStudy) -> Figure:
    """The paper's figure 4, and how many markers a run chooses."""
    figure, (bars, sizes) = new_figure(1, 2, height=3.8)
    cast(GridSpec, bars.get_gridspec()).set_width_ratios([4, 1])
    shares = study.shares
    for taken, colour, label in (
        (True, OURS, "taken by training"),
        (False, _OTHER, "others"),
    ):
        rows = [row for row, one in enumerate(shares) if (one in study.chosen.markers) == taken]
        heights = 100 * np.array(list(shares.values()))[rows]
        bars.bar(rows, heights, color=colour, label=label)
    bars.axhline(
        100 * paper.SELECTED_IN,
        color=PAPER,
        linestyle="--",
        linewidth=1.2,
        label=f"paper: each of its {paper.SELECTED_MARKERS} in more than "
        f"{100 * paper.SELECTED_IN:.0f} %",
    )
    bars.set_xticks(range(len(shares)), list(shares), rotation=90)
    bars.set_ylim(0, 100)
    bars.set_xlim(-0.7, len(shares) - 0.3)
    bars.set_ylabel("chosen in so many of the runs [%]")
    bars.set_xlabel("marker")
    bars.legend()
    sizes.bar(list(study.sizes), [100 * share for share in study.sizes.values()], color=OURS)
    sizes.set_xticks(list(study.sizes))
    sizes.set_xlabel("markers in a run")
    sizes.set_ylabel("runs [%]")
    for axes in (bars, sizes):
        axes.grid(visible=False, axis="x")
    return figure


def comparison_figure(compared: Mapping[str, SetScores]) -> Figure:
    """RMS over all markers of each set: the mean, and every performer left out."""
    figure, (axes,) = new_figure(height=4.6)
    places = np.arange(len(compared))
    sets = list(compared.values())
    means = [np.nan if one.mean.rms_all_mm is None else one.mean.rms_all_mm for one in sets]
    axes.bar(places, means, width=0.6, color=[OURS, *[_OTHER] * (len(sets) - 1)])
    for fold in sets[0].left_out:
        values = [one.left_out[fold].rms_all_mm for one in sets]
        heights = [np.nan if value is None else value for value in values]
        axes.plot(places, heights, "o-", color="0.2", markeredgecolor="white", linewidth=0.6)
        axes.annotate(
            fold,
            (places[-1], heights[-1]),
            xytext=(8, 0),
            textcoords="offset points",
            va="center",
            fontsize="small",
        )
    letters = max(5, min(20, 78 // len(sets)))  # in a line, so that neighbours keep apart
    labels = [
        f"{name}\n" + textwrap.fill(", ".join(one.principal), letters)
        for name, one in compared.items()
    ]
    axes.set_xticks(places, labels)
    axes.set_xlim(-0.6, len(compared) - 0.4)
    axes.set_ylabel("RMS over all 41 markers [mm]")
    axes.grid(visible=False, axis="x")
    return figure
