"""The machine that the benchmarks run on: what it is, and how fast it is just now."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
R = TypeVar("R")

LIBRARIES = ("numpy", "onnxruntime", "numba", "scikit-learn", "scipy")
LOOPS = 100_000
SIDE = 64
BEST_OF = 15


def machine() -> dict[str, Any]:
    """What it is, and the versions of what counts."""
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **{name: version(name) for name in LIBRARIES},
    }


def calibration() -> dict[str, float]:
    """Times, µs, of two loops that never change, the best of several: `python`, 100,000 rounds of
    adding squares; `matmul`, a product of float32 matrices of 64 x 64.
    """
    one = np.random.default_rng(0).normal(size=(SIDE, SIDE)).astype(np.float32)
    out = np.empty_like(one)
    return {"python": _best(_squares, 1), "matmul": _best(lambda: np.matmul(one, one, out), 200)}


def alone(function: Callable[P, R], *arguments: P.args, **options: P.kwargs) -> R:
    """Calls it in a process of its own, so that memory is what this alone takes."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments, **options).result()


def memory(pid: int | str = "self", what: str = "VmRSS") -> float:
    """MB that a process has in memory; VmHWM: has had at most."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(what)) / 1024


def cpu_seconds(pid: int) -> float:
    """Seconds of CPU that a process has taken, all its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _squares() -> int:
    total = 0
    for number in range(LOOPS):
        total += number * number
    return total


def _best(call: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(BEST_OF):
        began = time.perf_counter()
        for _ in range(repeats):
            call()
        times.append((time.perf_counter() - began) / repeats)
    return min(times) * 1e6


def _cpu() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
