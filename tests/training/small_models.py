"""Small models of either kind, trained for a moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bridge.model import Model
from training.corpus import read_corpus
from training.dataset import Capture, training_captures
from training.export import to_onnx
from training.forest import ForestOptions
from training.network import NetworkOptions
from training.pipeline import AnyRecipe, fit_model
from training.recipe import RECIPES, NetworkRecipe
from training.workers import workers

FOREST = ForestOptions(trees=3, leaf=10)
SIX = ("LWRB", "RWRB", "RBWT", "LANK", "RSHN", "RANK")


def networks_recipe(options: NetworkOptions) -> NetworkRecipe:
    """All three networks by the same options."""
    return NetworkRecipe(pose=options, velocity=options, recall=options)


def small_mixture(path: Path, folder: Path, stranger: str) -> Model:
    """Writes a mixture of local models, from the training captures of a folder but for those of
    one performer.
    """
    captures = [one for one in training_captures(folder) if one.subject != stranger]
    return _written(path, folder, captures, replace(RECIPES["local"], forest=FOREST))


def small_networks(path: Path, folder: Path, names: Sequence[str]) -> Model:
    """Writes small networks, from real captures of a folder."""
    files = [f"real/{name}.c3d" for name in names]
    captures = [one for one in training_captures(folder) if one.name in files]
    assert len(captures) == len(names)
    recipe = networks_recipe(NetworkOptions(hidden=(24, 24), steps=60, batch=128))
    return _written(path, folder, captures, recipe)


def _written(path: Path, folder: Path, captures: Sequence[Capture], recipe: AnyRecipe) -> Model:
    with workers(None):
        corpus = read_corpus(folder, captures, recipe, lambda *_: None, pytest.fail)
        fitted = fit_model(corpus, np.arange(len(corpus.frames)), SIX, recipe, 0)
    path.write_bytes(to_onnx(fitted.graph, fitted.info))
    return Model(path)
