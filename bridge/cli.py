"""The `markerbridge` command: names the subcommands and loads the one that is called."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from typing import cast

from drivers.errors import MarkerbridgeError

COMMANDS = {
    "demo": (
        "bridge.demo:main",
        "see it work: the embedded performer, a simulated tracker, a body",
    ),
    "run": ("bridge.run_command:main", "a live session: markers in, the whole body out"),
    "simulate": (
        "bridge.cli:simulate",
        "play a capture as a tracker would, on a serial line or OSC",
    ),
    "train": ("training.train_command:main", "captures to a model file"),
    "evaluate": ("training.evaluate_command:main", "how good a model is on captures"),
    "calibrate": (
        "training.calibrate_command:main",
        "a model for one person, from some seconds of all their markers",
    ),
    "select-markers": (
        "training.select_command:main",
        "which markers to track: a study of how stable the choice is",
    ),
    "view": ("bridge.view.command:main", "look at a recording, or make a picture of it"),
    "convert": ("bridge.convert_command:main", "a recorded session as C3D, TRC or CSV"),
    "fetch": ("training.fetch_command:main", "captures from the CMU database, with a manifest"),
    "doctor": (
        "bridge.doctor.command:main",
        "listen to a source: what is wrong, and what to write to mend it",
    ),
    "devices": ("bridge.devices_command:main", "serial ports, and what is being sent on them"),
}
EXTRAS = {
    "train": (
        "jinja2",
        "joblib",
        "matplotlib",
        "onnx",
        "pooch",
        "requests",
        "scipy",
        "sklearn",
        "threadpoolctl",
        "urllib3",
    ),
    "cluster": ("distributed",),
}


def main(argv: list[str] | None = None) -> int:
    """Runs a subcommand. 0: done; 1: failed while running; 2: wrong usage."""
    try:
        return _run(argv)
    finally:
        try:
            if sys.stderr:
                sys.stderr.flush()
        except OSError:
            # Python would try once more at its end, and end with a status of its own.
            sys.stderr = None


def _run(argv: list[str] | None) -> int:
    arguments = sys.argv[1:] if argv is None else argv
    parser = argparse.ArgumentParser(
        prog="markerbridge",
        description="A handful of motion-capture markers in, a whole moving body out, live.",
        epilog="\n".join(f"  {name:<16}{text}" for name, (_, text) in COMMANDS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=version("markerbridge"))
    parser.add_argument("command", choices=COMMANDS, metavar="COMMAND", help="one of those below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="COMMAND --help tells them")
    if not arguments:
        parser.print_help(sys.stderr)
        return 2
    chosen = parser.parse_args(arguments)
    try:
        return _load(COMMANDS[chosen.command][0])(chosen.arguments)
    except MarkerbridgeError as error:
        print(f"markerbridge {chosen.command}: error: {error}", file=sys.stderr)
        return error.exit_status
    except ModuleNotFoundError as error:
        extra = next((name for name, modules in EXTRAS.items() if error.name in modules), None)
        if extra is None:
            raise
        print(
            f"markerbridge {chosen.command}: error: {error.name} is not installed: "
            f"pip install 'markerbridge[{extra}]'",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        print(f"markerbridge {chosen.command}: stopped", file=sys.stderr)
        return 130


def _load(name: str) -> Callable[..., int]:
    module, _, function = name.partition(":")
    return cast(Callable[..., int], getattr(import_module(module), function))


def simulate(argv: list[str]) -> int:
    """`markerbridge simulate`: simulators do not know models, so it is told their markers."""
    from bridge.model import Model

    run = _load("simulators.command:main")
    return run(argv, lambda name: Model(name).info.tracked)


if __name__ == "__main__":
    sys.exit(main())
