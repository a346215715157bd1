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
from drivers.errors import MarkerbridgeError

START = 60.0  # s that Open3D gets to be imported and to open a window, on a slow machine
PATIENCE = 5.0  # s that it gets to end, an animation being written
NICE = 10  # where software draws it takes all cores: the bridge goes first
READY = ""
INSTALL = "pip install 'markerbridge[view]'"
INSTALL_LIBRARIES = "apt-get install libegl1 libgl1 libusb-1.0-0"


def start(target: Callable[..., None], *arguments: Any) -> tuple[BaseProcess, Connection]:
    """Starts `target(connection, *arguments)` in a process and waits until it sends READY.

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
        if not ours.poll(START):
            raise ViewError(f"not ready after {START:g} s")
        hear(process, ours)
    except ViewError as error:
        stop(process, ours)
        line = (str(error).splitlines() or ["?"])[0]
        raise ViewError(f"no view: {line}; if a library is missing: {INSTALL_LIBRARIES}") from error
    return process, ours


def hear(process: BaseProcess, connection: Connection) -> Any:
    """What the process sends next; what went wrong there is raised, and its end is a ViewError."""
    try:
        said = connection.recv()
    except (EOFError, OSError):
        process.join(PATIENCE)
        raise ViewError(f"its process ended with {process.exitcode}") from None
    if isinstance(said, MarkerbridgeError):
        raise said
    return said


def stop(process: BaseProcess, connection: Connection, patience: float = PATIENCE) -> None:
    """Ends the process: its connection's end tells it to; after `patience` seconds it is killed."""
    connection.close()  # again and again does no harm
    process.join(patience)
    if process.is_alive():
        process.kill()
        process.join()


def require_open3d() -> None:
    """Raises ViewError, saying what to install, where Open3D or Pillow is missing."""
    for module, name in (("open3d", "Open3D"), ("PIL", "Pillow")):
        if find_spec(module) is None:
            raise ViewError(f"no view: {name} is not installed: {INSTALL}")


def has_display() -> bool:
    """Whether a window would be seen. Open3D itself draws where nobody can see it.

    On Wayland it takes Xwayland, which sets DISPLAY: Open3D's plain windows are X11's.
    """
    if sys.platform != "linux":
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


def require_display() -> None:
    """Raises ViewError where no window would be seen."""
    if not has_display():
        wayland = os.environ.get("WAYLAND_DISPLAY") and not os.environ.get("DISPLAY")
        why = (
            "on Wayland it needs Xwayland: apt-get install xwayland"
            if wayland
            else "DISPLAY is not set, or nobody answers"
        )
        raise ViewError(f"no view: no display here ({why})")


def _run(target: Callable[..., None], connection: Connection, *arguments: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the bridge, which then ends it
    os.nice(NICE)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what graphics libraries say there helps nobody
    try:
        target(connection, *arguments)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # the bridge has ended
    except Exception as error:
        known = isinstance(error, MarkerbridgeError)
        connection.send(error if known else ViewError(f"{type(error).__name__}: {error}"))
        sys.exit(1)
