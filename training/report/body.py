"""A body of 41 markers with something told of each in colour."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Literal

import numpy as np
import numpy.typing as npt
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from bridge.view.skeleton import stick_rows
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from simulators.performer import Walker
from training.poses import body_poses
from training.report.page import new_figure

Array = npt.NDArray[np.float64]
_Across = Literal["left", "center", "right"]
_Up = Literal["bottom", "center", "top"]

_WALK = 132  # frames: a cycle of the synthetic walk
_TITLES = ("from the front", "from its left")
_AXES = ((0, 2), (1, 2))  # of the body frame, across and up, for each title; both seen reversed


def body_figure(values: Mapping[str, float], tracked: Collection[str], label: str) -> Figure:
    """The body from the front and from its left, each marker of `values` a disc in its colour.

    tracked: the markers to be drawn as white discs. label: of the colour bar, with the unit.
    """
    views = _stride()[:, _AXES].transpose(1, 0, 2) * np.array([-1.0, 1.0])
    sticks = stick_rows(MARKERS)
    shown = [MARKERS.index(name) for name in values]
    worn = [MARKERS.index(name) for name in tracked]
    # Each marker is named where it stands freer.
    named = np.argmax([_clearance(view) for view in views], axis=0)
    figure, panels = new_figure(1, 2, height=7.0)
    for number, (axes, view) in enumerate(zip(panels, views, strict=True)):
        axes.add_collection(LineCollection(list(view[sticks]), colors="0.75", zorder=1))
        x, z = view.T
        axes.scatter(x[worn], z[worn], s=90, c="white", edgecolors="black", zorder=3)
        discs = axes.scatter(
            x[shown], z[shown], s=90, c=list(values.values()), edgecolors="white", zorder=2
        )
        for row in np.flatnonzero(named == number):
            beside, across, up = _free_side(view, row)
            axes.annotate(
                MARKERS[row],
                view[row],
                xytext=beside,
                textcoords="offset points",
                ha=across,
                va=up,
                fontsize="x-small",
                path_effects=[withStroke(linewidth=2, foreground="white")],
            )
        axes.set_title(_TITLES[number])
        axes.set_aspect("equal")
        axes.set_xlim(x.mean() - 0.55, x.mean() + 0.5)
        axes.set_ylim(-1.5, 0.25)
        axes.set_xlabel("across the view [m]")
        axes.grid(visible=False)
    panels[0].set_ylabel("above the neck (C7) [m]")
    figure.colorbar(discs, ax=panels, label=label, shrink=0.7)
    return figure


def _stride() -> Floats:
    """The synthetic walker (41, 3) with its feet farthest apart, metres, body frame."""
    walker = Walker()
    walk = body_poses(np.array([walker.pose(index) for index in range(_WALK)]))
    left, right = (walk[:, MARKERS.index(name)] for name in ("LANK", "RANK"))
    widest: Floats = walk[np.linalg.norm(left - right, axis=1).argmax()]
    return widest


def _free_side(view: Array, row: np.intp) -> tuple[tuple[int, int], _Across, _Up]:
    """Where the name of a marker of a view (M, 2) has room: offset in points, and alignment.

    That is the side to which the other markers, the near ones most, push it.
    """
    away = view[row] - np.delete(view, row, axis=0)
    x, z = (away / np.linalg.norm(away, axis=1, keepdims=True) ** 3).sum(axis=0)
    if abs(x) >= abs(z):
        return ((8, 0), "left", "center") if x > 0 else ((-8, 0), "right", "center")
    return ((0, 7), "center", "bottom") if z > 0 else ((0, -7), "center", "top")


def _clearance(view: Array) -> Array:
    """The distance (M,) of each marker of a view (M, 2) to the next."""
    apart = np.linalg.norm(view[:, None] - view[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest: Array = apart.min(axis=1)
    return nearest
