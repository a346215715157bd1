from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from bridge import compiled as module
from bridge.compiled import compiled

PROGRAM = """
from bridge.compiled import compiled

@compiled("f8(f8)")
def more(value):
    return value + 1

print(more(1.0))
"""


def total(values, factor):
    found = 0.0
    for value in values:
        found += factor * value
    return found


def test_it_is_what_python_does_and_takes_no_other_types() -> None:
    made = compiled("f8(f4[::1], f8)")(total)
    values = np.array([1.5, 2.5], np.float32)
    assert made(values, 2.0) == total(values, 2.0) == made.py_func(values, 2.0)
    for wrong in (values.astype(float), np.zeros((2, 2), np.float32), np.zeros(4, np.float32)[::2]):
        with pytest.raises(TypeError):
            made(wrong, 2.0)


@pytest.mark.parametrize("error", [RuntimeError("no locator"), OSError(28, "No space left")])
def test_where_nothing_can_be_kept_it_is_compiled_all_the_same(error, monkeypatch, caplog) -> None:
    def refusing(*arguments, cache: bool = False, **options):
        if cache:
            raise error
        return numba.njit(*arguments, **options)

    monkeypatch.setattr(module, "njit", refusing)
    monkeypatch.setattr(module, "_said", set())
    for _ in range(2):
        assert compiled("f8(f4[::1], f8)")(total)(np.ones(3, np.float32), 2.0) == 6.0
    (text,) = caplog.messages
    assert text.startswith("compiling anew at each start")
    assert str(error) in text
    assert "NUMBA_CACHE_DIR" in text


def test_a_first_start_is_told_and_a_spoilt_cache_is_no_harm(tmp_path: Path) -> None:
    program, kept = tmp_path / "program.py", tmp_path / "kept"
    program.write_text(PROGRAM)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(kept)}
    told = []
    for spoilt in (False, False, True):
        files = [path for path in kept.rglob("*.nb?") if path.is_file()]
        assert bool(files) == bool(told)
        for path in files if spoilt else []:
            path.write_bytes(path.read_bytes()[:40])
        done = subprocess.run(
            [sys.executable, "-P", program], env=environment, capture_output=True, text=True
        )
        assert (done.returncode, done.stdout) == (0, "2.0\n"), done.stderr
        told.append(done.stderr)
    first, second, third = told
    assert first == "compiling for this machine, once: this takes about half a minute\n"
    assert second == ""
    assert third == first  # it is mended
