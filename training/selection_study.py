"""How stable the choice of principal markers is: many runs of it, each from its own seed (paper
3.1.2), kept in a file so that a study that was stopped goes on.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed

from drivers.errors import MarkerbridgeError
from drivers.files import whole_file
from training.marker_selection import SPARE_CLUSTERS, VARIANCE, Selection, select_markers
from training.progress import Advance

Array = npt.NDArray[np.float64]
Markers = tuple[str, ...]
T = TypeVar("T", str, int, Markers)

START_WORK = 10.0  # units of progress that one start of K-means takes, as `pipeline.FIT_WORK`
BATCH = 20  # runs that are kept and told of at once


@dataclass(frozen=True, slots=True)
class SelectionStudy:
    """labels: the candidates. restarts: of K-means in each run. chosen: what training takes, from
    far more restarts. runs: what each run selected, most important first.
    """

    labels: Markers
    restarts: int
    chosen: Selection
    runs: Sequence[Markers]

    @property
    def shares(self) -> dict[str, float]:
        """The share of the runs that select a marker, for all that any run does, highest first."""
        return self._shares(label for run in self.runs for label in run)

    @property
    def sets(self) -> dict[Markers, float]:
        """The share of the runs that select just these markers, highest first."""
        return self._shares(tuple(sorted(run, key=self.labels.index)) for run in self.runs)

    @property
    def sizes(self) -> dict[int, float]:
        """The share of the runs that select so many markers, by their number."""
        return dict(sorted(self._shares(len(run) for run in self.runs).items()))

    @property
    def shared(self) -> float:
        """How many of the markers that training takes a run selects, on average."""
        return sum(self.shares.get(label, 0.0) for label in self.chosen.markers)

    def to_json(self) -> dict[str, Any]:
        """The figures as a reader of JSON wants them."""
        return {
            "runs": len(self.runs),
            "restarts": self.restarts,
            "components": self.chosen.components,
            "clusters": self.chosen.clusters,
            "chosen": self.chosen.markers,
            "shares": self.shares,
            "sizes": {str(size): share for size, share in self.sizes.items()},
            "sets": [{"markers": found, "share": share} for found, share in self.sets.items()],
        }

    def _shares(self, found: Iterator[T]) -> dict[T, float]:
        counts = sorted(Counter(found).items(), key=lambda entry: (-entry[1], entry[0]))
        return {one: count / len(self.runs) for one, count in counts}


def repeat_selection(
    covariance: Array,
    labels: Sequence[str],
    runs: int,
    restarts: int,
    seed: int,
    advance: Advance,
    record: Path | None = None,
) -> list[Markers]:
    """What each of the runs selects, by the workers in force.

    covariance: (3M, 3M) of the candidates `labels`, m². restarts: of K-means in a run, START_WORK
    units of progress each. record: a file where runs are kept as they are done, and from which
    those kept before are taken. Raises MarkerbridgeError where it is of another study or cannot be
    written.
    """
    work = restarts * START_WORK
    done = {} if record is None else _begin(record, _digest(covariance, labels, restarts, seed))
    missing = [run for run in range(runs) if run not in done]
    if len(missing) < runs:
        advance(f"{runs - len(missing)} runs were done before", work * (runs - len(missing)))
    found = zip(
        missing,
        Parallel(return_as="generator")(
            delayed(_select)(covariance, labels, restarts, seed, run) for run in missing
        ),
        strict=True,
    )
    while batch := list(islice(found, BATCH)):
        if record is not None:
            _keep(record, batch)
        done.update(batch)
        advance(f"{batch[-1][0] + 1} of {runs} runs", work * len(batch))
    return [done[run] for run in range(runs)]


def _select(
    covariance: Array, labels: Sequence[str], restarts: int, seed: int, run: int
) -> Markers:
    own = int(np.random.SeedSequence([seed, run]).generate_state(1)[0])
    return select_markers(covariance, labels, own, restarts=restarts).markers


def _digest(covariance: Array, labels: Sequence[str], restarts: int, seed: int) -> str:
    """What a run's outcome hangs on."""
    # To 1e-9 m², or another machine's rounding would make it other data; + 0.0 for -0.0.
    data = (covariance.round(9) + 0.0).tobytes()
    options = json.dumps([list(labels), restarts, seed, VARIANCE, SPARE_CLUSTERS])
    return hashlib.sha256(options.encode() + data).hexdigest()


def _begin(record: Path, digest: str) -> dict[int, Markers]:
    """The runs in a record; without one it is started. A last line cut short is taken out."""
    head = f"# markerbridge select-markers {digest}\nrun,markers\n"
    try:
        text = record.read_text("utf-8", errors="replace") if record.exists() else ""
        if head.startswith(text):
            whole = head
        elif text.startswith(head):
            whole = text[: text.rfind("\n") + 1]
        else:
            raise MarkerbridgeError(
                f"{record} holds runs on other data or with other options: choose another folder, "
                "or remove that file"
            )
        if whole != text:
            with whole_file(record) as part:
                part.write_text(whole, encoding="utf-8")
    except OSError as error:
        raise MarkerbridgeError(f"cannot keep runs in {record}: {error.strerror}") from error
    lines = (line.partition(",") for line in whole.removeprefix(head).splitlines())
    try:
        return {int(run): tuple(markers.split()) for run, _, markers in lines}
    except ValueError as error:
        raise MarkerbridgeError(f"{record} is damaged ({error}): remove it") from error


def _keep(record: Path, batch: Sequence[tuple[int, Markers]]) -> None:
    try:
        with record.open("a", encoding="utf-8") as file:
            file.writelines(f"{run},{' '.join(markers)}\n" for run, markers in batch)
    except OSError as error:
        raise MarkerbridgeError(f"cannot keep runs in {record}: {error.strerror}") from error
