"""Functions that numba compiles to machine code, for what runs with every frame.

They are compiled when their module is imported, for the types that they name, and kept beside it
(`__pycache__`) or in the user's cache, so that this takes seconds once and milliseconds after that.
Rules for them are in docs/decisions/0028.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar, cast


@contextmanager
def _without(module: str) -> Iterator[None]:
    """As if a module were not installed, unless it has been imported."""
    if module in sys.modules:
        yield
        return
    sys.modules[module] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[module]


# Numba takes it for products of matrices, which are not compiled here; it would cost a fifth of a
# second at each start, and 17 MB.
with _without("scipy.linalg"):
    import numba.np.arraymath  # noqa: F401
    from numba import njit
    from numba.core import event
    from numba.core.caching import FunctionCache

P = ParamSpec("P")
R = TypeVar("R")

COMPILING = "numba:compile"  # what numba calls it when nothing that was kept can be taken

log = logging.getLogger(__name__)
_said: set[str] = set()


def _say_once(message: str, *details: object) -> None:
    """What is true of one function is true of all. Nobody need have set up logging yet: then
    Python writes warnings, as they are, to standard error.
    """
    if message not in _said:
        _said.add(message)
        log.warning(message, *details)


class _Telling(event.Listener):
    """Says that there is something to compile: else the first start is a silent wait."""

    def on_start(self, event: object) -> None:
        _say_once("compiling for this machine, once: this takes about half a minute")

    def on_end(self, event: object) -> None:
        pass


def compiled(signature: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compiles a function for arguments of these types alone; others raise TypeError.

    signature: as numba has it, for example `f8(f4[:,::1], f8)`: a C-contiguous (N, M) array of
    float32 and a float64, from which it makes a float64. Division by zero gives inf or NaN, as
    numpy's does; indices are not checked.
    """

    def kept(function: Callable[P, R]) -> object:
        with event.install_listener(COMPILING, _Telling()):
            return njit(signature, cache=True, error_model="numpy")(function)

    def compile_it(function: Callable[P, R]) -> Callable[P, R]:
        try:
            try:
                made = kept(function)
            except Exception:  # what was kept is spoilt, after a power cut for example
                cast(Any, FunctionCache)(function).flush()
                made = kept(function)
        except Exception as error:  # nowhere to keep it, or a full disk
            _say_once(
                "compiling anew at each start, which takes half a minute, for what is compiled "
                "can be neither kept nor read (%s): NUMBA_CACHE_DIR names another folder for it",
                error,
            )
            made = njit(signature, error_model="numpy")(function)
        return cast(Callable[P, R], made)

    return compile_it


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A function for compiled ones: compiled into each that calls it, for what it is given there,
    and by itself only where Python calls it. So it needs no signature and costs no start-up time.
    """
    return cast(Callable[P, R], njit(error_model="numpy")(function))
