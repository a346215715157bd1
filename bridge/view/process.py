"""The view's own process: a slow or broken display must not hold up the bridge."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable
from importlib.util import find_spec
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from bridge.sinks.sink import ViewError

START = 60.0  # s that Open3D gets to be imported and to open a window, on a slow machine
READY = ""
INSTALL = "pip install 'markerbridge[view]'"
INSTALL_LIBRARIES = "apt-get install libegl1 libgl1 libusb-1.0-0"


def start(target: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection]:
    """Starts `target(connection, *arguments)` in a process and waits until it is ready.

    Raises ViewError, in one line that says what to install, where it cannot be.
    """
    require_open3d()
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(
        target=_run, args=(target, theirs, *arguments), name="markerbridge view", daemon=True
    )
    process.start()
    theirs.close()
    try:
        trouble = ours.recv() if ours.poll(START) else f"not ready after {START:g} s"
    except EOFError:
        process.join()
        trouble = f"its process ended with {process.exitcode}"
    if trouble != READY:
        stop(process, ours)
        line = (str(trouble).splitlines() or ["?"])[0]
        raise ViewError(f"no view: {line}; if a library is missing: {INSTALL_LIBRARIES}")
    return process, ours


def stop(process: BaseProcess, connection: Connection) -> None:
    """Ends the process: its connection's end tells it to; if need be it is killed."""
    connection.close()  # again and again does no harm
    process.join(5.0)
    if process.is_alive():
        process.kill()
        process.join()


def require_open3d() -> None:
    """Raises ViewError, saying what to install, where Open3D is missing."""
    if find_spec("open3d") is None:
        raise ViewError(f"no view: Open3D is not installed: {INSTALL}")


def has_display() -> bool:
    """Whether a window would be seen. Open3D itself draws where nobody can see it."""
    if sys.platform != "linux" or os.environ.get("WAYLAND_DISPLAY"):
        return True
    if not os.environ.get("DISPLAY"):
        return False
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return True  # the view's own process says which library is missing
    x11.XOpenDisplay.restype = ctypes.c_void_p
    display = x11.XOpenDisplay(None)
    if display:
        x11.XCloseDisplay(ctypes.c_void_p(display))
    return bool(display)


def _run(target: Callable[..., None], connection: Connection, *arguments: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the bridge, which then ends it
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what graphics libraries say there helps nobody
    try:
        target(connection, *arguments)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # the bridge has ended
    except Exception as error:
        connection.send(f"{type(error).__name__}: {error}")
