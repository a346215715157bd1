"""The model file: an ONNX graph and its description (docs/model-file.md).

Graph of a mixture of local models, per frame: inputs `x` (1, D) float32, the first D coordinates
of the feature markers in the body frame, and `history` (h, K), the leaf weights of the h frames
before (zero rows where there were none, in any order); outputs `z` (1, 3U), the unworn markers in
the body frame, and `p` (1, K), the leaf weights of this frame, to be kept for the next ones.

Graph of networks: inputs `x` (n, 3T), the tracked markers in the body frame, and `present` (n, T),
a one for each that is there. Where all are, `v` (n, 3T) are their velocities against its origin's,
in its axes; output `y` (n, 7M): all markers in the body frame, the logarithms of the standard
deviations of their errors per coordinate, and their velocities. Where some are missing, `x` is zero
there, and `memory` (n, 9T + 1) is the last frame with the marker in question: the tracked markers
in the body frame then, the same places of the world in the body frame of now, the velocities in the
world then, in the axes of now, and the seconds since; `y` (n, 4T): the tracked markers and the
logarithms of their standard deviations. All lengths are metres, velocities m/s.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np

from bridge import onnx_file
from bridge.body_frame import CONSTRUCTIONS, PAPER_FRAME
from bridge.humanoid.proportions import COUNT
from bridge.networks import CompiledNetworks, Weights
from drivers.errors import MarkerbridgeError
from drivers.frame import Floats

# Else it tells its maker what it is used for (its Privacy.md); it looks once, when it is loaded.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
import onnxruntime

FORMAT = 2
MAX_HISTORY = 240  # frames of 1/120 s
METADATA_KEY = "markerbridge"
DEFAULT = "default"
SAME = 1e-4  # m and m/s, and of a part: as far as two ways to compute the same may differ


class ModelError(MarkerbridgeError):
    """A file that is no model of ours, or of another version; the message names it."""


@dataclass(frozen=True, slots=True)
class ModelInfo:
    """What a model file says of itself.

    Feature markers are the principal ones, then the references but for a lone origin; `mean`
    (F, 3) and `covariance` (3F, 3F) describe them in the body frame, metres. `sigma` (U,): standard
    deviation of the estimate's error per coordinate, metres, per unworn marker, measured on folds;
    a network's graph tells it frame by frame. `sensitivity` (3U, 3F): how far an error in the
    features moves the estimate (the global linear map). `history`: frames of
    1/120 s; a network's is 0. `proportions`: how a performer is built, for whom it was calibrated
    (`bridge.humanoid.proportions`); the entry may be missing.
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
    proportions: list[float] | None = None

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
        entries = asdict(self)
        if self.proportions is None:
            del entries["proportions"]
        return json.dumps(entries, separators=(",", ":"), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> ModelInfo:
        """Raises ValueError where the text is no description of this version."""
        data = json.loads(text)
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            found = data.get("format") if isinstance(data, dict) else None
            raise ValueError(f"model format {found}, this program reads {FORMAT}")
        data.setdefault("proportions", None)
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
            "sensitivity": (3 * len(info.unworn), 3 * len(info.features)),
        }
        if info.proportions is not None:
            shapes["proportions"] = (COUNT,)
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
            self._weights: Weights | None = None
            self._try()
            if not self.leaves:
                self._weights = self._compilable(path)
        except Exception as error:
            raise ModelError(f"{path}: not usable as a model: {_line(error)}") from error
        self.path = path

    def _compilable(self, path: Path) -> Weights | None:
        """What compiled networks run with; None where the graph is of another form than ours, or
        says anything else than they do.
        """
        try:
            found, info = onnx_file.constants(path), self.info
            weights = Weights.of(found, len(info.tracked), len(info.labels))
        except (KeyError, ValueError, OSError):
            return None
        mine, theirs = CompiledNetworks(weights), BoundNetworks(self._session, self.info, 1)
        random, tracked = np.random.default_rng(0), len(self.info.tracked)
        for spread in (0.0, 0.3, 3.0):
            shape = 5, 1, tracked, 3
            x, v, then, left, pace = (spread * random.standard_normal(shape)).astype(np.float32)
            present = np.arange(tracked) % 3 > 0
            x[0, ~present] = 0.0
            age = np.array([0.1 + spread])
            memory = np.concatenate([then.ravel(), left.ravel(), pace.ravel(), age])
            with np.errstate(over="ignore"):  # of a graph that says anything
                pairs = [
                    *zip(mine.estimate(x, v)[0], theirs.estimate(x, v)[0], strict=True),
                    *zip(
                        mine.recall(x[0], present, then, left, pace, age),
                        self.recall(
                            x.reshape(1, -1),
                            present[None].astype(np.float32),
                            memory[None].astype(np.float32),
                        ),
                        strict=True,
                    ),
                ]
            if not all(np.allclose(*pair, rtol=SAME, atol=SAME) for pair in pairs):
                return None
        return weights

    def run(self, x: Floats, history: Floats) -> tuple[Floats, Floats]:
        """z and p of one frame, by a mixture; shapes as at the top of this module."""
        z, p = self._session.run(("z", "p"), {"x": x, "history": history})
        return z, p

    def estimate(self, tracked: Floats, velocity: Floats) -> tuple[Floats, Floats, Floats]:
        """By networks, of one frame: all markers (M, 3), their sigma (M,) and velocities (M, 3),
        from the tracked ones (T, 3) and their velocities (T, 3).
        """
        return self.networks(1).estimate(tracked[None], velocity[None])[0]

    def networks(self, count: int) -> BoundNetworks | CompiledNetworks:
        """The networks, to be run on so many whole frames at a time, over and over."""
        if count == 1 and self._weights is not None:
            return CompiledNetworks(self._weights)
        return BoundNetworks(self._session, self.info, count)

    def mixture(self, history: Floats) -> BoundMixture:
        """The mixture, to be run frame after frame; the caller keeps the history (h, K)."""
        return BoundMixture(self._session, self.width, history)

    def recall(self, tracked: Floats, present: Floats, memory: Floats) -> tuple[Floats, Floats]:
        """By networks, of n frames that lack markers: the tracked ones (n, T, 3) and their sigma
        (n, T); shapes as at the top of this module.
        """
        y = self._networks(tracked, np.zeros_like(tracked), present, memory)
        width = tracked.shape[1]
        return y[:, :width].reshape(len(y), -1, 3), np.exp(y[:, width:])

    def _networks(self, x: Floats, v: Floats, present: Floats, memory: Floats) -> Floats:
        feeds = {"x": x, "v": v, "present": present, "memory": memory}
        found: Floats = self._session.run(("y",), feeds)[0]
        return found

    def _try(self) -> None:
        """Raises where the graph does not give what its description says."""
        markers, tracked = len(self.info.labels), len(self.info.tracked)
        if self.leaves:
            x = np.zeros((1, self.width), np.float32)
            outputs = self.run(x, np.zeros((1, self.leaves), np.float32))
            expected = (1, 3 * len(self.info.unworn)), (1, self.leaves)
        else:
            still = np.zeros((1, 3 * tracked), np.float32)
            nothing = np.ones((1, 9 * tracked + 1), np.float32)
            whole, none = (np.full((1, tracked), here, np.float32) for here in (1.0, 0.0))
            outputs = (
                self._networks(still, still, whole, nothing),
                self._networks(still, still, none, nothing),
            )
            expected = (1, 7 * markers), (1, 4 * tracked)
        given = tuple(output.shape for output in outputs)
        if given != expected:
            raise ValueError(f"the graph gives shapes {given}, not {expected}")


class BoundNetworks:
    """Networks that are run on n whole frames at a time. All that they read and write is made once.

    Not for several threads at a time. Call `estimate`.
    """

    def __init__(self, session: onnxruntime.InferenceSession, info: ModelInfo, count: int) -> None:
        tracked, markers = len(info.tracked), len(info.labels)
        self._x: Floats = np.zeros((count, tracked, 3), np.float32)
        self._v = np.zeros_like(self._x)
        y: Floats = np.zeros((count, 7 * markers), np.float32)
        self._logarithms = y[:, 3 * markers : 4 * markers]
        self._sigma = np.zeros_like(self._logarithms)
        poses = y[:, : 3 * markers].reshape(count, markers, 3)
        velocities = y[:, 4 * markers :].reshape(count, markers, 3)
        self._found = list(zip(poses, self._sigma, velocities, strict=True))
        inputs = {
            "x": self._x.reshape(count, -1),
            "v": self._v.reshape(count, -1),
            # What a frame that lacks nothing has for what is asked of others.
            "present": np.ones((count, tracked), np.float32),
            "memory": np.ones((count, 9 * tracked + 1), np.float32),
        }
        self._run = _bound(session, inputs, {"y": y})

    def estimate(self, tracked: Floats, velocity: Floats) -> list[tuple[Floats, Floats, Floats]]:
        """Of each frame: all markers (M, 3), their sigma (M,) and velocities (M, 3), from the
        tracked ones (n, T, 3) and their velocities (n, T, 3); the next call overwrites them.
        """
        self._x[:], self._v[:] = tracked, velocity
        self._run()
        np.exp(self._logarithms, out=self._sigma)
        return self._found


class BoundMixture:
    """A mixture, frame by frame. All that it reads and writes is made once: x, to be filled, and
    the history of leaf weights; z and p, which the next `run` overwrites. Shapes as at the top of
    this module.
    """

    def __init__(self, session: onnxruntime.InferenceSession, width: int, history: Floats) -> None:
        outputs = {entry.name: int(entry.shape[1]) for entry in session.get_outputs()}
        self.x: Floats = np.zeros((1, width), np.float32)
        self.history = history
        self.z: Floats = np.zeros((1, outputs["z"]), np.float32)
        self.p: Floats = np.zeros((1, outputs["p"]), np.float32)
        inputs = {"x": self.x, "history": history}
        self.run = _bound(session, inputs, {"z": self.z, "p": self.p})


def _bound(
    session: onnxruntime.InferenceSession, inputs: dict[str, Floats], outputs: dict[str, Floats]
) -> Callable[[], None]:
    """Runs the graph on these arrays, over and over."""
    binding = session.io_binding()
    for name, array in inputs.items():
        binding.bind_input(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
    for name, array in outputs.items():
        binding.bind_output(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)

    def run(_kept: object = (inputs, outputs)) -> None:  # the binding knows where they are, no more
        session.run_with_iobinding(binding)

    return run


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
