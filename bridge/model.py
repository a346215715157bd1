"""The model file: an ONNX graph and its description (docs/model-file.md).

Graph of a mixture of local models, per frame: inputs `x` (1, D) float32, the first D coordinates
of the feature markers in the body frame, and `history` (h, K), the leaf weights of the h frames
before (zero rows where there were none, in any order); outputs `z` (1, 3U), the unworn markers in
the body frame, and `p` (1, K), the leaf weights of this frame, to be kept for the next ones.

Graph of a network: inputs `x` (n, 3F), the feature markers in the body frame, zeros where missing,
and `present` (n, T), a one for each tracked marker that is there; outputs `z` (n, 3M), all markers
in the body frame, and `sigma` (n, M), the standard deviation of the error per coordinate. All
lengths are metres.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from bridge.body_frame import CONSTRUCTIONS, PAPER_FRAME
from drivers.errors import MarkerbridgeError
from drivers.frame import Floats

FORMAT = 1
MAX_HISTORY = 240  # frames of 1/120 s
METADATA_KEY = "markerbridge"
DEFAULT = "default"


class ModelError(MarkerbridgeError):
    """A file that is no model of ours, or of another version; the message names it."""


@dataclass(frozen=True, slots=True)
class ModelInfo:
    """What a model file says of itself.

    Feature markers are the principal ones, then the references but for a lone origin; `mean`
    (F, 3) and `covariance` (3F, 3F) describe them in the body frame, metres. `sigma` (U,): standard
    deviation of the estimate's error per coordinate, metres, per unworn marker, measured on folds;
    a network's graph tells it frame by frame. `sensitivity` (3U, 3F): how far an error in the
    features moves the estimate (the global linear map); a network's is empty. `history`: frames of
    1/120 s; a network's is 0.
    """

    estimator: str
    labels: tuple[str, ...]
    principal: tuple[str, ...]
    references: tuple[str, ...]
    history: int
    mean: list[list[float]]
    covariance: list[list[float]]
    sigma: list[float]
    sensitivity: list[list[float]]
    training: dict[str, Any] = field(default_factory=dict)
    accuracy: dict[str, Any] = field(default_factory=dict)
    body_frame: str = PAPER_FRAME.name
    format: int = FORMAT

    @property
    def tracked(self) -> tuple[str, ...]:
        """What the performer wears: principal and reference markers."""
        return self.principal + self.references

    @property
    def features(self) -> tuple[str, ...]:
        """The tracked markers but a lone origin, in the order the graph wants them."""
        return CONSTRUCTIONS[self.body_frame].features(self.tracked)

    @property
    def unworn(self) -> tuple[str, ...]:
        """The markers that are estimated, in the order the graph gives them."""
        return tuple(label for label in self.labels if label not in self.tracked)

    def to_json(self) -> str:
        return json.dumps(asdict(self), separators=(",", ":"), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> ModelInfo:
        """Raises ValueError where the text is no description of this version."""
        data = json.loads(text)
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            found = data.get("format") if isinstance(data, dict) else None
            raise ValueError(f"model format {found}, this program reads {FORMAT}")
        names = {entry.name for entry in fields(cls)}
        if set(data) != names:
            raise ValueError(f"unexpected or missing entries: {sorted(set(data) ^ names)}")
        for name in ("labels", "principal", "references"):
            data[name] = tuple(data[name])
        info = cls(**data)
        if info.body_frame not in CONSTRUCTIONS:
            raise ValueError(f"unknown body frame {info.body_frame}")
        shapes = {
            "mean": (len(info.features), 3),
            "covariance": (3 * len(info.features),) * 2,
            "sigma": (len(info.unworn),),
        }
        if info.sensitivity:
            shapes["sensitivity"] = (3 * len(info.unworn), 3 * len(info.features))
        for name, shape in shapes.items():
            if np.shape(getattr(info, name)) != shape:
                raise ValueError(f"{name} is not of shape {shape}")
        if type(info.history) is not int or not 0 <= info.history <= MAX_HISTORY:
            raise ValueError(f"history is not a number of frames from 0 to {MAX_HISTORY}")
        return info


class Model:
    """A loaded model file, ready to run.

    width: D of the graph's x. leaves: K of a mixture, 0 of a network.
    """

    def __init__(self, path: str | Path) -> None:
        """Raises ModelError; `default` names the model that ships with the package."""
        if str(path) == DEFAULT:
            with as_file(files("bridge") / "models" / "default.onnx") as file:
                self._load(file)
        else:
            self._load(Path(path))

    def _load(self, path: Path) -> None:
        if not path.is_file():
            raise ModelError(f"{path}: no such model file (`default` is the one that ships)")
        options = onnxruntime.SessionOptions()
        # One thread: the pool of the default spins a whole core between frames.
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
            text = self._session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        except Exception as error:  # onnxruntime raises a class of its own per cause
            raise ModelError(f"{path}: not a whole ONNX file: {_line(error)}") from error
        if text is None:
            raise ModelError(f"{path}: an ONNX file, but not one that `markerbridge train` wrote")
        try:
            self.info = ModelInfo.from_json(text)
            inputs = {entry.name: entry.shape for entry in self._session.get_inputs()}
            self.width = int(inputs["x"][1])
            self.leaves = int(inputs["history"][1]) if "history" in inputs else 0
            self._try()
        except Exception as error:
            raise ModelError(f"{path}: not usable as a model: {_line(error)}") from error
        self.path = path

    def run(self, x: Floats, history: Floats) -> tuple[Floats, Floats]:
        """z and p of one frame, by a mixture; shapes as at the top of this module."""
        z, p = self._session.run(("z", "p"), {"x": x, "history": history})
        return z, p

    def regress(self, x: Floats, present: Floats) -> tuple[Floats, Floats]:
        """z and sigma of n frames, by a network; shapes as at the top of this module."""
        z, sigma = self._session.run(("z", "sigma"), {"x": x, "present": present})
        return z, sigma

    def _try(self) -> None:
        """Raises where the graph does not give what its description says."""
        x = np.zeros((1, self.width), np.float32)
        if self.leaves:
            if not self.info.sensitivity:
                raise ValueError("sensitivity is not of shape (3U, 3F)")
            z, other = self.run(x, np.zeros((1, self.leaves), np.float32))
            expected = (1, 3 * len(self.info.unworn)), (1, self.leaves)
        else:
            z, other = self.regress(x, np.ones((1, len(self.info.tracked)), np.float32))
            expected = (1, 3 * len(self.info.labels)), (1, len(self.info.labels))
        if (z.shape, other.shape) != expected:
            raise ValueError(f"the graph gives shapes {z.shape} and {other.shape}")


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
