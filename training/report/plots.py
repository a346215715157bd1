"""The figures of an evaluation, drawn as those of the paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from training.evaluation import GAMMA_EDGES, Result, Scores
from training.report import paper
from training.report.page import NEAREST, OURS, PAPER, new_figure

Array = npt.NDArray[np.float64]

OUR_METHOD = "this model"
NEAREST_NEIGHBOUR = "nearest neighbour"
_GAMMA = "velocity error γ [mm per 1/120 s]"


def categories_figure(groups: Mapping[str, Scores]) -> Figure:
    """RMS and velocity error of each group, both methods, with the paper's means."""
    figure, (rms, jerk) = new_figure(1, 2, height=1.9 + 0.5 * len(groups))
    rows = np.arange(len(groups))
    for axes, ours, nearest in ((rms, "rms_mm", "nn_rms_mm"), (jerk, "jerk_mm", "nn_jerk_mm")):
        for name, label, colour, offset in (
            (ours, OUR_METHOD, OURS, -0.2),
            (nearest, NEAREST_NEIGHBOUR, NEAREST, 0.2),
        ):
            values = [getattr(scores, name) for scores in groups.values()]
            if all(value is None for value in values):
                continue
            lengths = [np.nan if value is None else value for value in values]
            axes.barh(rows + offset, lengths, height=0.38, color=colour, label=label)
        axes.set_yticks(rows, list(groups))
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
    rms.set_xlabel("RMS error [mm per marker]")
    _mark_paper(rms.axvline)
    jerk.set_xlabel(_GAMMA)
    _legend_above(figure, rms)
    return figure


def frames_figure(result: Result) -> Figure:
    """The paper's figure 7 for one sequence: RMS and jerkiness frame by frame, both methods."""
    figure, (rms, jerk) = new_figure(2, 1, height=4.6, share_x=True)
    time = np.arange(result.frames) / result.rate
    traces = [(result.nn_trace, NEAREST_NEIGHBOUR, NEAREST), (result.trace, OUR_METHOD, OURS)]
    for trace, label, colour in traces:
        if trace is not None:
            rms.plot(time, trace.rms, color=colour, linewidth=1.2, label=label)
            jerk.plot(time, trace.jerk, color=colour, linewidth=0.9, label=label)
    _mark_paper(rms.axhline)
    for axes in (rms, jerk):
        axes.set_ylim(bottom=0)
        axes.margins(x=0.01)
    rms.set_ylabel("RMS error\n[mm per marker]")
    jerk.set_ylabel("velocity error γ\n[mm per 1/120 s]")
    jerk.set_xlabel("time [s]")
    _legend_above(figure, rms)
    return figure


def gamma_figure(counts: Mapping[str, npt.NDArray[np.int64]], jerky: float) -> Figure:
    """The paper's figure 6 for each title: velocity errors counted, (2, B) as `Result.gamma`.

    jerky: mm per 1/120 s, the velocity error above which a frame counts as jerky.
    """
    figure, panels = new_figure(1, len(counts), height=4.0)
    filled = np.flatnonzero(np.sum(list(counts.values()), axis=(0, 1)))
    last = GAMMA_EDGES[filled[-1] + 1]
    top = max(part.max() for part in counts.values())
    for axes, (title, (others, at_change)) in zip(panels, counts.items(), strict=True):
        axes.stairs(others, GAMMA_EDGES, fill=True, color=OURS, alpha=0.55, label="other frames")
        axes.stairs(at_change, GAMMA_EDGES, color=NEAREST, linewidth=1.8, label="transition frames")
        axes.axvline(jerky, color=PAPER, linestyle=":", label="jerky from here")
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:,.0f}")
        axes.set_xlim(0, last)
        axes.set_ylim(0.7, 2 * top)
        axes.set_title(title)
        axes.set_xlabel(_GAMMA)
    panels[0].set_ylabel("markers × frames [count]")
    _legend_above(figure, panels[0])
    return figure


def latency_figure(seconds: Array) -> Figure:
    """How long a frame takes, (N,) seconds, beside the paper's mean."""
    figure, (axes,) = new_figure(height=3.4)
    ms = 1000 * seconds
    middle, slow = np.percentile(ms, (50, 99))
    edges = np.geomspace(ms.min(), max(ms.max(), 1.01 * ms.min()), 80)
    axes.stairs(*np.histogram(ms, edges), fill=True, color=OURS, alpha=0.55)
    for value, style, label in (
        (middle, "-", f"p50 {middle:.3f} ms"),
        (slow, "-.", f"p99 {slow:.3f} ms"),
    ):
        axes.axvline(value, color=OURS, linestyle=style, label=label)
    axes.axvline(
        1000 * paper.FRAME_S,
        color=PAPER,
        linestyle="--",
        label=f"paper {1000 * paper.FRAME_S:g} ms (2006)",
    )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_major_formatter("{x:,.0f}")
    axes.set_xlabel("time from markers to pose [ms]")
    axes.set_ylabel("frames [count]")
    _legend_above(figure, axes)
    return figure


def _mark_paper(line: Callable[..., object]) -> None:
    """The paper's mean RMS of both methods, as dashed lines in their colours."""
    for value, whose, colour in (
        (paper.RMS_MM, "its method", OURS),
        (paper.NN_RMS_MM, NEAREST_NEIGHBOUR, NEAREST),
    ):
        label = f"paper, {whose}: {value:.0f} mm"
        line(value, color=colour, linestyle="--", linewidth=1.2, label=label)


def _legend_above(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
