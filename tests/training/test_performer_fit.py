"""The tool that fits the embedded performer."""

from __future__ import annotations

import json
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from drivers.c3d_file import read_c3d
from drivers.marker_set import MARKERS
from training.performer import PHASES, fit, gait_cycles, main, mean_cycle, walking_captures


def test_the_tool_gives_the_shipped_numbers_again(
    data_dir: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(sys, "argv", ["x", str(data_dir), "--out", str(tmp_path / "walk.json")])
    main()
    again = json.loads((tmp_path / "walk.json").read_text())
    shipped = json.loads((files("simulators") / "data" / "walk.json").read_text())
    assert again["cycle_s"] == pytest.approx(shipped["cycle_s"], abs=1e-3)
    assert again["stride"] == pytest.approx(shipped["stride"], abs=1)
    for label in MARKERS:
        mean = np.array(again["markers"][label][:3])
        np.testing.assert_allclose(mean, shipped["markers"][label][:3], atol=0.5)
    assert "gait cycles" in capsys.readouterr().out


def test_only_training_walks_are_used(data_dir: Path) -> None:
    used = walking_captures(data_dir)
    names = {path.name for paths in used.values() for path in paths}
    assert {"02_01.c3d", "07_01.c3d"} <= names
    assert not names & {"02_02.c3d", "07_12.c3d", "walk_494.c3d", "16_57.c3d"}


def test_a_cycle_is_one_stride_long_and_closes(data_dir: Path) -> None:
    clip = read_c3d(data_dir / "real/07_01.c3d")
    cycles = list(gait_cycles(clip.xyz.astype(float), clip.layout.rate))
    assert cycles
    for cycle in cycles:
        assert cycle.xyz.shape == (PHASES, 41, 3)
        seam = np.linalg.norm(cycle.xyz[0] - cycle.xyz[-1], axis=1)
        inside = np.linalg.norm(np.diff(cycle.xyz, axis=0), axis=2)
        assert np.median(seam) < 3 * np.median(inside) + 0.03
        assert 1.1 < cycle.stride < 1.7


def test_the_model_explains_the_mean_cycle(data_dir: Path) -> None:
    captures = {"real": walking_captures(data_dir)["real"]}
    _, explained = fit(mean_cycle(captures)[0])
    assert explained > 0.99
