"""The report of `markerbridge train`: what the captures are made of (paper sections 3 and 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from scipy.cluster.hierarchy import dendrogram

from bridge.body_frame import CONSTRUCTIONS
from bridge.model import ModelInfo
from drivers.marker_set import MARKERS
from training.clustering import VARIANCE, DivisiveKMeans
from training.corpus import Corpus
from training.fitting import Leaves
from training.marker_wishes import Markers
from training.moments import ONE, columns_of, matrix, mean_and_covariance
from training.motions import category
from training.ppca import components_for
from training.report import paper
from training.report.page import NEAREST, OURS, PAPER, Report, new_figure

Array = npt.NDArray[np.float64]
SHARES = (0.90, 0.95)  # of the variance, for the dimension of a segment
WALKING = "walking"
_SHOWN = 15  # components in figure 5
_FRAME = 120.0  # frames of 1/120 s: the paper's, and the CMU database's


def add_training(
    report: Report,
    command: str,
    corpus: Corpus,
    leaves: Leaves | None,
    info: ModelInfo,
    left_out: Sequence[tuple[str, str]],
) -> None:
    """Adds all sections. command: as it was given. leaves: of a mixture; None of networks.
    left_out: what could not be used, and why.
    """
    kinds = np.array([category(capture.motion) for capture in corpus.captures])
    # The paper's 40 markers, 120 features: all but an origin that never moves in the body frame.
    moving = CONSTRUCTIONS[info.body_frame].features(MARKERS)
    _data(report, command, corpus, kinds, left_out)
    _variance(report, corpus, moving, info)
    _walks(report, corpus, moving, kinds)
    _segments(report, corpus, moving, kinds)
    if leaves is None:
        _networks(report, corpus, info)
    else:
        _clusters(report, corpus, leaves, kinds)
        _forest(report, info)
    _folds(report, info)


def spectrum(moments: Array, labels: Markers) -> Array:
    """Variances (3M,) of the principal components of these M markers, largest first, m²."""
    covariance = mean_and_covariance(matrix(moments), columns_of(labels))[1]
    variances: Array = np.maximum(np.linalg.eigvalsh(covariance)[::-1], 0.0)
    return variances


def dimensions(corpus: Corpus, labels: Markers) -> dict[float, npt.NDArray[np.int64]]:
    """How many components hold each of SHARES of the variance of each segment (S,)."""
    spectra = [spectrum(moments, labels) for moments in corpus.moments]
    return {share: np.array([components_for(one, share) for one in spectra]) for share in SHARES}


def _data(
    report: Report,
    command: str,
    corpus: Corpus,
    kinds: npt.NDArray[np.str_],
    left_out: Sequence[tuple[str, str]],
) -> None:
    performers = {capture.subject for capture in corpus.captures}
    report.section(
        "Data",
        f"Made by: {command}",
        "Captures, and the frames of theirs that have all 41 markers: the others are not trained "
        "on. Performers whom nobody can name count as one.",
    )
    report.table(
        "data",
        "What the model was trained on, beside the paper's training set.",
        ("", "here", "paper"),
        (
            ("sequences", len(corpus.captures), paper.TRAIN_SEQUENCES),
            ("frames", int(corpus.frames.sum()), paper.TRAIN_FRAMES),
            ("performers", len(performers), paper.TRAIN_SUBJECTS),
        ),
    )
    report.table(
        "captures",
        "Every capture.",
        ("file", "performer", "kind of motion", "frames", "complete frames", "segments"),
        [
            (one.name, one.subject, kind, int(read), int(used), int(count))
            for one, kind, read, used, count in zip(
                corpus.captures,
                kinds,
                corpus.frames_read,
                corpus.frames_used,
                np.bincount(corpus.capture, minlength=len(corpus.captures)),
                strict=True,
            )
        ],
    )
    report.left_out(left_out)


def _variance(report: Report, corpus: Corpus, moving: Markers, info: ModelInfo) -> None:
    variances = spectrum(corpus.moments.sum(axis=0), moving)
    covered = 100 * np.cumsum(variances) / variances.sum()
    figure, (axes,) = new_figure()
    count = np.arange(1, len(covered) + 1)
    axes.plot(count, covered, color=OURS, marker=".", label="here")
    axes.plot(
        (paper.PCA_COMPONENTS_95, paper.PCA_COMPONENTS_99),
        (95, 99),
        "x",
        color=PAPER,
        label="paper: 95 % and (at most) 99 %",
    )
    axes.set(xlabel="principal components", ylabel="variance explained [%]", xlim=(0, 40))
    axes.legend()
    needed = [components_for(variances, share) for share in (0.95, 0.99)]
    report.section(
        "Redundancy (figure 3)",
        f"The poses of all captures, {len(moving)} markers in the body frame: {needed[0]} "
        "components hold "
        f"95 % of the variance and {needed[1]} hold 99 %. The paper's {paper.PCA_FRAMES:,} frames "
        f"(walking, running, bending, washing) need {paper.PCA_COMPONENTS_95} and fewer than "
        f"{paper.PCA_COMPONENTS_99}.",
        f"Principal markers of this model: {', '.join(info.principal)}.",
    )
    report.figure("figure_3", "Variance explained by the principal components.", figure)
    report.table(
        "variance",
        "The same as numbers.",
        ("components", "variance explained [%]"),
        [(int(n), float(share)) for n, share in zip(count[:20], covered[:20], strict=True)],
    )


def _walks(report: Report, corpus: Corpus, moving: Markers, kinds: npt.NDArray[np.str_]) -> None:
    walking = np.flatnonzero(kinds == WALKING)
    if not len(walking):
        report.section("Walks (figure 5)", "None of the captures is a walk.")
        return
    report.section(
        "Walks (figure 5)",
        "What the first components hold of each walk, and of all together: as they are, and each "
        "about its own mean, which leaves out how people hold themselves and where their markers "
        "sit.",
    )
    parts = [corpus.moments[corpus.capture == row].sum(axis=0) for row in walking]
    alone = np.array([_shares(spectrum(part, moving)) for part in parts])
    together = _shares(spectrum(np.sum(parts, axis=0), moving))
    centred = _shares(_spectrum_about_own_means(parts, moving))
    figure, (axes,) = new_figure()
    count = np.arange(1, _SHOWN + 1)
    for row, shares in zip(walking, alone, strict=True):
        real = corpus.captures[row].real
        axes.plot(
            count,
            shares[:_SHOWN],
            color=OURS if real else "0.75",
            lw=1.5 if real else 0.7,
            zorder=3 if real else 2,
        )
    axes.plot(count, together[:_SHOWN], color=NEAREST, marker="o", lw=2)
    axes.plot(count, centred[:_SHOWN], color=NEAREST, marker=".", ls="--")
    axes.plot([2], [90], "x", color=PAPER, ms=9)
    axes.set(xlabel="principal components", ylabel="variance explained [%]")
    axes.legend(
        handles=[
            *axes.plot([], [], color=OURS, label="one walk"),
            *axes.plot([], [], color="0.75", label="one walk, synthetic markers"),
            *axes.plot([], [], color=NEAREST, marker="o", label="all walks together"),
            *axes.plot([], [], color=NEAREST, marker=".", ls="--", label="each about its own mean"),
            *axes.plot([], [], "x", color=PAPER, ms=9, label="paper: two hold over 90 %"),
        ]
    )
    two = alone[:, 1]
    report.figure("figure_5", "Walking sequences, one by one and together.", figure)
    report.table(
        "walks_summary",
        "Share of the variance that the first two components hold (%), beside the paper's claim.",
        ("", "least", "median", "most", "paper"),
        (
            (f"{len(two)} walks, each alone", two.min(), np.median(two), two.max(), "over 90"),
            ("all together", None, together[1], None, "a little less"),
            ("all together, each about its own mean", None, centred[1], None, None),
        ),
    )
    report.table(
        "walks",
        "Variance explained (%) by the first components of every walk.",
        ("file", *(str(n) for n in range(1, 6))),
        [
            *(
                (corpus.captures[row].name, *map(float, shares[:5]))
                for row, shares in zip(walking, alone, strict=True)
            ),
            ("all together", *map(float, together[:5])),
            ("all together, each about its own mean", *map(float, centred[:5])),
        ],
    )


def _spectrum_about_own_means(parts: Sequence[Array], labels: Markers) -> Array:
    """Variances (3M,) of the components of several sets of frames, each about its own mean."""
    columns = columns_of(labels)
    matrices = [matrix(part) for part in parts]
    counts = np.array([whole[ONE, ONE] for whole in matrices])
    covariances = [mean_and_covariance(whole, columns)[1] for whole in matrices]
    pooled = np.average(covariances, axis=0, weights=counts)
    variances: Array = np.maximum(np.linalg.eigvalsh(pooled)[::-1], 0.0)
    return variances


def _shares(variances: Array) -> Array:
    """What the first 1, 2, 3, ... components hold, %."""
    shares: Array = 100 * np.cumsum(variances) / variances.sum()
    return shares


def _segments(report: Report, corpus: Corpus, moving: Markers, kinds: npt.NDArray[np.str_]) -> None:
    length = corpus.seconds * _FRAME
    report.section(
        "Segments",
        "Where probabilistic PCA cuts. Lengths are in frames of 1/120 s, as the paper's.",
    )
    report.table(
        "segments_summary",
        "Number and length of the segments.",
        ("", "here", "paper"),
        (
            ("segments", len(length), paper.SEGMENTS),
            ("mean length (frames)", length.mean(), paper.SEGMENT_MEAN),
            ("standard deviation (frames)", length.std(), paper.SEGMENT_SD),
            ("median (frames)", float(np.median(length)), paper.SEGMENT_MEDIAN),
            ("shortest (frames)", length.min(), paper.SEGMENT_MIN),
            ("longest (frames)", length.max(), paper.SEGMENT_MAX),
        ),
    )
    figure, (axes,) = new_figure()
    axes.hist(length, bins=30, color=OURS)
    axes.axvline(float(np.median(length)), color=OURS, ls="--", label="median here")
    axes.axvline(paper.SEGMENT_MEDIAN, color=PAPER, ls=":", label="median of the paper")
    axes.set(xlabel="length [frames of 1/120 s]", ylabel="segments")
    axes.legend()
    report.figure("segment_lengths", "Lengths of the segments.", figure)
    dims = dimensions(corpus, moving)
    of_segment = kinds[corpus.capture]
    names = sorted(
        set(of_segment), key=lambda name: float(np.median(dims[0.95][of_segment == name]))
    )
    report.table(
        "dimensions",
        "Dimension of the segments by kind of motion: components that hold 90 % and 95 % of a "
        f"segment's variance. The paper: as low as {paper.DIMENSION_WALK} for walking, as high "
        f"as {paper.DIMENSION_SALSA} for Salsa dancing.",
        (
            "kind of motion",
            "segments",
            *(f"{w}, {100 * s:.0f} %" for s in SHARES for w in ("least", "median", "most")),
        ),
        [
            (
                str(name),
                int((of_segment == name).sum()),
                *(value for share in SHARES for value in _range(dims[share][of_segment == name])),
            )
            for name in names
        ],
    )
    figure, (axes,) = new_figure(height=1.2 + 0.3 * len(names))
    axes.boxplot(
        [dims[0.95][of_segment == name] for name in names],
        orientation="horizontal",
        tick_labels=[f"{name} ({(of_segment == name).sum()})" for name in names],
        medianprops={"color": OURS, "lw": 2},
        flierprops={"marker": ".", "ms": 3},
    )
    for value in (paper.DIMENSION_WALK, paper.DIMENSION_SALSA):
        axes.axvline(value, color=PAPER, ls=":")
    axes.set(xlabel="components that hold 95 % of a segment's variance (dotted: the paper's range)")
    report.figure("dimensions_by_kind", "Dimension by kind of motion (number of segments).", figure)
    report.table(
        "segments",
        "Every segment: where it starts among the complete frames of its capture.",
        ("file", "start (frame)", "frames", *(f"dimension, {100 * s:.0f} %" for s in SHARES)),
        [
            (corpus.captures[row].name, int(start), int(frames), *map(int, dimension))
            for row, start, frames, *dimension in zip(
                corpus.capture, corpus.start, corpus.frames, *dims.values(), strict=True
            )
        ],
    )


def _range(values: npt.NDArray[np.int64]) -> tuple[int, float, int]:
    return int(values.min()), float(np.median(values)), int(values.max())


def _clusters(report: Report, corpus: Corpus, leaves: Leaves, kinds: npt.NDArray[np.str_]) -> None:
    variances = leaves.features.variances
    kept = leaves.features.rows.shape[1]
    twins = "" if leaves.twin is None else " Each segment is there a second time, mirrored."
    report.section(
        "Clusters",
        f"Divisive 2-means of the segments' features.{twins} The paper: "
        f"{paper.LEAVES} local models of {paper.SEGMENTS} segments; fewer than "
        f"{paper.FEATURE_COMPONENTS} components hold 95 % of the variance of the features.",
    )
    report.table(
        "clusters_summary",
        "The clustering, beside the paper's.",
        ("", "here", "paper"),
        (
            ("local models (leaves)", leaves.count, paper.LEAVES),
            (
                f"components for {100 * VARIANCE:.0f} % of the features' variance",
                kept,
                f"under {paper.FEATURE_COMPONENTS}",
            ),
        ),
    )
    figure, (axes,) = new_figure()
    covered = 100 * np.cumsum(variances) / variances.sum()
    shown = slice(0, 2 * max(kept, paper.FEATURE_COMPONENTS))
    axes.plot(np.arange(1, len(covered) + 1)[shown], covered[shown], color=OURS)
    axes.axhline(95, color="0.5", ls="--")
    axes.axvline(paper.FEATURE_COMPONENTS, color=PAPER, ls=":", label="paper: fewer for 95 %")
    axes.set(xlabel="principal components", ylabel="variance of the features [%]")
    axes.legend()
    report.figure("features", "Variance of the segment features explained.", figure)
    if leaves.count > 1:
        figure, (axes,) = new_figure(height=4.5)
        _draw_tree(axes, leaves.hierarchy)
        report.figure(
            "cluster_tree",
            "The cluster tree. Height: the largest distance of a segment from its cluster's mean; "
            "dashed: the tolerance, below which a cluster is a leaf.",
            figure,
        )
    _leaves(report, corpus, leaves, kinds)


def _draw_tree(axes: Axes, hierarchy: DivisiveKMeans) -> None:
    """A dendrogram: scikit-learn's children as scipy has them, heights never below a child's."""
    count = hierarchy.n_leaves_
    height, size = np.array(hierarchy.radius_, float), np.ones(2 * count - 1)
    for row, (left, right) in enumerate(hierarchy.children_):
        node = count + row
        height[node] = max(height[node], height[left], height[right])
        size[node] = size[left] + size[right]
    linkage = np.column_stack([hierarchy.children_, height[count:], size[count:]]).astype(float)
    dendrogram(
        linkage,
        ax=axes,
        no_labels=count > 40,
        color_threshold=0,
        above_threshold_color=OURS,
    )
    axes.axhline(hierarchy.limit_, color=PAPER, ls="--")
    axes.set(ylabel="radius (spread of the features)", xlabel=f"{count} leaves")
    axes.grid(visible=False)


def _leaves(report: Report, corpus: Corpus, leaves: Leaves, kinds: npt.NDArray[np.str_]) -> None:
    rows: list[tuple[object, ...]] = []
    for leaf in range(leaves.count):
        own = leaves.segments[leaves.leaf == leaf]
        twins = leaves.segments[[]] if leaves.twin is None else leaves.segments[leaves.twin == leaf]
        captures = corpus.capture[np.concatenate([own, twins])]
        rows.append(
            (
                leaf,
                len(own),
                len(twins),
                int(corpus.frames[own].sum() + corpus.frames[twins].sum()),
                len({corpus.captures[row].subject for row in captures}),
                ", ".join(sorted(set(kinds[captures]))),
            )
        )
    frames = np.array([row[3] for row in rows], float)
    people = np.array([row[4] for row in rows], float)
    order = np.argsort(-frames)
    figure, (upper, lower) = new_figure(2, 1, height=5.0, share_x=True)
    upper.bar(np.arange(len(rows)), frames[order], color=OURS)
    upper.set(yscale="log", ylabel="frames")
    lower.bar(np.arange(len(rows)), people[order], color=NEAREST)
    lower.set(ylabel="performers", xlabel="leaves, the largest first")
    report.figure("leaf_sizes", "Frames and performers in each leaf.", figure)
    report.table(
        "leaves",
        "Every leaf. Performers whom nobody can name count as one.",
        ("leaf", "segments", "mirrored segments", "frames", "performers", "kinds of motion"),
        rows,
    )


def _forest(report: Report, info: ModelInfo) -> None:
    wrong = info.training["forest_error"]
    if wrong is None:
        report.section("Forest", "There is only one segment: nothing can be held out.")
        return
    report.section(
        "Forest",
        "How often the random forest names the wrong leaf. The paper does not say which poses its "
        "figure is of. Poses held out at random have neighbours in training, "
        f"{_step_ms(info):.0f} ms away or a little more; whole segments held out are new motion. "
        "A leaf whose only segment is held out cannot be named, "
        "so the error is given without those, too. What counts in the end is the error of the "
        "estimate: neighbouring leaves have similar maps.",
    )
    report.table(
        "forest_error",
        "Classification error of the forest (%).",
        ("held out", "here", "paper"),
        (
            ("poses", 100 * wrong["frames"], 100 * paper.FOREST_ERROR),
            ("segments", 100 * wrong["segments"], None),
            (
                "segments whose leaf has others",
                None if wrong["segments_known"] is None else 100 * wrong["segments_known"],
                None,
            ),
        ),
    )


def _step_ms(info: ModelInfo) -> float:
    """Between the poses of a capture that the forest is grown on."""
    return 1000 * float(info.training["recipe"]["pose_step"])


def _networks(report: Report, corpus: Corpus, info: ModelInfo) -> None:
    recipe = info.training["recipe"]
    networks = [recipe[name] for name in ("pose", "velocity", "recall")]
    examples = recipe["examples"]
    report.section(
        "Networks",
        "Three networks, each on top of a linear map. From the tracked markers the first estimates "
        f"where all {len(info.labels)} markers are, and how far off each may be; the second, how "
        "they move; the third says where tracked markers are that are missing, from the others and "
        "from the last frame that had them. The examples that they learn from are made anew in "
        "every step: poses of the captures and their mirror images, of bodies somewhat larger or "
        "smaller, measured with noise.",
    )
    report.table(
        "networks",
        "What they are and how they are trained.",
        ("", "pose", "velocity", "missing markers"),
        (
            (
                "units of the hidden layers",
                *(", ".join(map(str, network["hidden"])) for network in networks),
            ),
            *(
                (text, *(factor * network[key] for network in networks))
                for text, key, factor in (
                    ("units left out in training (%)", "dropout", 100),
                    ("steps of training", "steps", 1),
                    ("examples in each", "batch", 1),
                    ("highest learning rate", "rate", 1),
                )
            ),
        ),
    )
    report.table(
        "examples",
        "What they learn from.",
        ("", ""),
        (
            ("tracked markers", ", ".join(info.tracked)),
            ("poses kept of the captures", len(corpus.poses)),
            ("noise of a coordinate, standard deviation (mm)", 1000 * examples["noise"]),
            ("size of the body, standard deviation (%)", 100 * examples["scale"]),
        ),
    )


def _folds(report: Report, info: ModelInfo) -> None:
    folds: dict[str, Any] | None = info.accuracy["folds"]
    if not folds:
        return
    if folds["people"]:
        report.section(
            "Performers left out",
            "Real captures, estimated by models trained without any of the performers in the row. "
            "The paper has no such figure: 14 of the 18 people of its test set were in its "
            "training.",
        )
    else:
        report.section(
            "Files left out",
            "Fewer than two performers are known, so files were left out in turn; the model may "
            "know the same person from another file.",
        )
    names = ("rms_mm", "rms_all_mm", "jerk_mm", "roughness")
    report.table(
        "folds",
        "Errors on what was left out, over the markers that nobody wears.",
        ("left out", "RMS (mm)", "RMS of all 41 (mm)", "velocity error (mm/frame)", "roughness"),
        [
            *((who, *(scores[n] for n in names)) for who, scores in folds["left_out"].items()),
            ("mean over captures", *(folds["mean"][name] for name in names)),
        ],
    )
