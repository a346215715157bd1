"""The report of `markerbridge select-markers --by error`: the markers that the others are estimated
best from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from training.corpus import Corpus
from training.marker_wishes import SHOULDERS, Wishes
from training.report.page import NEAREST, OURS, PALETTE, Report, new_figure
from training.report.selection import add_comparison
from training.search_study import SearchStudy
from training.set_comparison import SetScores

_SIGNS = "sD^v<>Ph*X"  # of the sets beside ours, over and over


def search_report(
    folder: Path,
    study: SearchStudy,
    corpus: Corpus,
    command: str,
    left_out: Sequence[tuple[str, str]],
) -> Report:
    """The report, not yet written. command: the line that started it; left_out: what could not be
    used, and why.
    """
    report = Report(folder, "Choice of markers by the error of what is estimated")
    _what_was_run(report, study, corpus, command, left_out)
    _number(report, study)
    _sets(report, study)
    tried = {
        name: study.scores[one.markers]
        for name, one in study.sets.items()
        if one.markers in study.scores
    }
    if tried:
        _comparison(report, study, tried)
    return report


def _what_was_run(
    report: Report,
    study: SearchStudy,
    corpus: Corpus,
    command: str,
    left_out: Sequence[tuple[str, str]],
) -> None:
    report.section(
        "What was run",
        "The markers are chosen that leave least to be guessed of the others, in people never "
        "seen. One affine map from what is worn to all the rest, held back as if the markers were "
        "measured with some noise, and its error on the captures left out both follow from second "
        "moments, so thousands of sets can be scored. From several starts one marker or two are "
        "exchanged for others as long as that helps. Errors are over all 41 markers, the worn ones "
        "being exact, and so compare sets of any size.",
        "The captures that the sets are scored on choose among them too: expect a little more "
        "error on others.",
    )
    chosen = study.chosen.markers
    report.table(
        "study",
        "The study.",
        ("", ""),
        (
            ("command", command),
            ("captures", f"{len(corpus.captures):,}, {corpus.frames.sum():,} complete frames"),
            ("wishes", _told(study.wishes)),
            ("sets scored in closed form", f"{study.searched:,}"),
            ("chosen", ", ".join(chosen)),
            ("give the body frame", ", ".join(study.wishes.references)),
        ),
    )
    report.left_out(left_out)


def _told(wishes: Wishes) -> str:
    """The wishes as the options that say them."""
    told = [f"--count {wishes.count}"]
    for field in fields(wishes):
        value = getattr(wishes, field.name)
        if isinstance(value, tuple) and value:
            told.append(f"--{field.name} {','.join(value)}")
        elif value is True:
            told.append(f"--{field.name}")
    return " ".join(told)


def _number(report: Report, study: SearchStudy) -> None:
    report.section(
        "How many markers",
        "The best sets found of each size, in closed form: what one more marker brings.",
    )
    report.figure(
        "number",
        "Error over all 41 markers in closed form against the number of markers chosen. Signs: "
        "the sets that ours is told beside.",
        number_figure(study),
    )
    report.table(
        "by_size",
        "The same as numbers.",
        ("number", "markers", "closed form [mm]"),
        [(len(one.markers), ", ".join(one.markers), one.error_mm) for one in study.by_size],
    )


def _sets(report: Report, study: SearchStudy) -> None:
    report.section(
        "Sets",
        "Near the best there are many sets that do as well: neighbours on one limb, and the two "
        "sides of the body, can stand for each other. Of those the best is told of alone.",
    )
    report.table(
        "sets",
        "The best sets that differ in two markers and more, and those they are told beside.",
        ("set", "markers", "number", "closed form [mm]", "chosen"),
        [
            (
                name,
                ", ".join(one.markers),
                len(one.markers),
                one.error_mm,
                "yes" if one is study.chosen else "",
            )
            for name, one in study.sets.items()
        ],
    )


def _comparison(report: Report, study: SearchStudy, tried: dict[str, SetScores]) -> None:
    report.section(
        "With the estimator",
        "Models are trained with the best of these sets and those beside them, every one without "
        "some of the performers, and scored on the real captures of these (of files left out, "
        "where nobody says who performed). Of the best sets the one with the least RMS over all 41 "
        "markers is chosen; it comes first."
        + (f" {' and '.join(SHOULDERS)} are worn beside all." if study.wishes.alone else ""),
    )
    chosen = next(name for name, one in study.sets.items() if one is study.chosen)
    add_comparison(report, {chosen: tried[chosen], **tried})


def number_figure(study: SearchStudy) -> Figure:
    """The error against the number of markers."""
    figure, (axes,) = new_figure()
    sizes = [len(one.markers) for one in study.by_size]
    errors = [one.error_mm for one in study.by_size]
    axes.plot(sizes, errors, "o-", color=OURS, label="best set found")
    for number, (name, one) in enumerate(study.others.items()):
        axes.plot(
            len(one.markers),
            one.error_mm,
            _SIGNS[number % len(_SIGNS)],
            color=NEAREST if number == 0 else PALETTE[2 + number % 4],
            label=name,
        )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(bottom=0)
    axes.set_xlabel("markers chosen")
    axes.set_ylabel("error over all 41 markers [mm]")
    axes.legend()
    return figure
