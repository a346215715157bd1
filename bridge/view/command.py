"""`markerbridge view`: a recording to look at, in a window or as a picture."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, track

from bridge import terminal
from bridge.model import DEFAULT, Model, ModelInfo
from bridge.sinks.sink import ViewError
from bridge.view import camera
from bridge.view.controls import Look
from bridge.view.live import replay
from bridge.view.player import SPEEDS, Moment, Player
from bridge.view.process import hear, require_display, require_open3d, start, stop
from bridge.view.recorded import read_recording, recording_url
from bridge.view.scene import Worn
from bridge.view.snapshot import Film, check_picture, film
from drivers.errors import UsageError
from drivers.options import checked, positive

ANIMATIONS = (".gif", ".webp", ".png")
SECONDS, FPS = 4.0, 20.0
MOST_FPS = 50.0  # a GIF of more is shown slower than it is meant
SMALLEST, LARGEST = 64, 4096  # pixels a side


def main(argv: list[str]) -> int:
    """Runs the command; 0 when the window was closed, or the picture is written."""
    options = _parser().parse_args(argv)
    console = Console(stderr=True)
    terminal.log_to(console)
    path = _check(options)
    url = recording_url(options.recording)
    model = Model(options.model) if options.model else None
    info = (model or Model(DEFAULT)).info

    def progress(moments: Iterable[Moment]) -> Iterable[Moment]:
        hidden = not console.is_terminal
        return track(moments, "reading", console=console, transient=True, disable=hidden)

    take, worn = read_recording(url, info, model, progress)
    player = Player(take)
    if options.at > player.length:
        raise UsageError(f"--at {options.at:g}s: {url.text} ends at {player.length:.2f} s")
    look = Look(view=options.view, bones=options.bones, over=options.over)
    player.speed = options.speed
    if path is None:
        player.seek(options.at)
        _show(info, worn, player, look)
    else:
        look.help = False
        _film(_order(options, path, player), info, worn, player, look, console)
    return 0


def _check(options: argparse.Namespace) -> Path | None:
    """Where a picture goes; None for a window. Raises what is wrong before anything is read."""
    if options.png and options.animation:
        raise UsageError("--png and --animation: one of them at a time")
    for name in ("seconds", "fps"):
        if getattr(options, name) is not None and not options.animation:
            raise UsageError(f"--{name} is for --animation")
    path: Path | None = options.png or options.animation
    if path is None:
        if options.size:
            raise UsageError("--size is for --png and --animation")
        require_open3d()
        try:
            require_display()
        except ViewError as error:
            raise ViewError(f"{error}; --png F.png and --animation F.gif need none") from error
        return None
    check_picture(path, (".png",) if options.png else ANIMATIONS)
    return path


def _order(options: argparse.Namespace, path: Path, player: Player) -> Film:
    size = options.size or camera.SIZE
    if options.png:
        return Film(path, options.at, size=size)
    fps = options.fps or FPS
    seconds = min(options.seconds or SECONDS, (player.length - options.at) / player.speed)
    return Film(path, options.at, max(2, math.ceil(seconds * fps)), fps, size)


def _show(info: ModelInfo, worn: Worn, player: Player, look: Look) -> None:
    process, connection = start(replay, info, worn, player, look)
    try:
        hear(process, connection)  # nothing, until it ends
    except KeyboardInterrupt:
        pass
    except ViewError:
        if process.exitcode != 0:
            raise
    finally:
        stop(process, connection)


def _film(
    order: Film, info: ModelInfo, worn: Worn, player: Player, look: Look, console: Console
) -> None:
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("drawing", total=order.pictures)
        film(
            order, info, worn, player, look,
            lambda number: bar.update(task, completed=number),
        )  # fmt: skip
    what = "a picture" if order.pictures == 1 else f"{order.pictures} pictures"
    size = f"{order.size[0]}x{order.size[1]}"
    console.print(
        f"{order.path}: {what} of {size} pixels, {order.path.stat().st_size / 1000:.0f} kB",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )


def _seconds(text: str) -> float:
    """`2.5s` or `2.5` as 2.5. Raises ValueError."""
    try:
        value = float(text.strip().removesuffix("s"))
    except ValueError:
        value = -1.0
    if not 0 <= value < math.inf:
        raise ValueError(f"'{text}' is no time: write for example 2.5s")
    return value


def _length(text: str) -> float:
    value = _seconds(text)
    if not value:
        raise ValueError(f"'{text}' is no length of time: write for example 4s")
    return value


def _fps(text: str) -> float:
    value = positive(text)
    if not 1 <= value <= MOST_FPS:
        raise ValueError(f"'{text}': from 1 to {MOST_FPS:g} pictures a second")
    return value


def _size(text: str) -> tuple[int, int]:
    """`640x360`. Raises ValueError."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"'{text}' is no size: write for example 640x360")
    if not all(SMALLEST <= int(side) <= LARGEST for side in (width, height)):
        raise ValueError(f"'{text}': from {SMALLEST} to {LARGEST} pixels a side")
    return int(width), int(height)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge view",
        description="Shows a recorded session (`run --to log:FILE`) or a capture (C3D): plays, "
        "pauses, steps; the keys are told in the window. With --png or --animation it writes a "
        "picture instead, and needs no display.",
    )
    add = parser.add_argument
    add("recording", metavar="FILE", help="a log or a C3D file; or log:FILE or c3d:FILE?options")
    add(
        "--model",
        help="estimate the body anew from the tracked markers (`default` is the model that "
        "ships); all markers of a capture are then the truth beside it",
    )
    add("--at", type=checked(_seconds), default=0.0, metavar="T", help="begin there, as 2.5s")
    add(
        "--view", choices=tuple(camera.VIEWPOINTS), default=camera.DEFAULT,
        help=f"where it is seen from (default: {camera.DEFAULT})",
    )  # fmt: skip
    add(
        "--speed", type=float, choices=SPEEDS, default=1.0,
        help="how fast it plays (default: 1)",
    )  # fmt: skip
    add("--bones", action="store_true", help="the humanoid in place of sticks between markers")
    add("--over", action="store_true", help="the true body in the estimate's place, not beside it")
    add("--png", type=Path, metavar="F.png", help="write a picture")
    add(
        "--animation", type=Path, metavar="F",
        help="write an animation: F.gif, F.webp or F.png (APNG)",
    )  # fmt: skip
    add(
        "--seconds", type=checked(_length), metavar="S",
        help=f"how long the animation is (default: {SECONDS:g}, or to the end)",
    )  # fmt: skip
    add(
        "--fps", type=checked(_fps), metavar="N",
        help=f"its pictures a second (default: {FPS:g}, at most {MOST_FPS:g})",
    )  # fmt: skip
    add(
        "--size", type=checked(_size), metavar="WxH",
        help=f"of the picture, in pixels (default: {camera.SIZE[0]}x{camera.SIZE[1]})",
    )  # fmt: skip
    return parser
