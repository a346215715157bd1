"""Pictures of the view as files: a PNG, or an animation by the ending of its name."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from bridge.sinks.sink import SinkError
from bridge.view.colours import COLOURS
from drivers.files import whole_file

Pixels = npt.NDArray[np.uint8]  # (height, width, 3)

_SHADES = (0.3, 0.45, 0.6, 0.8, 1.0)  # of each colour that might come to be seen


def smaller(picture: npt.NDArray[np.float32], times: int) -> Pixels:
    """(H, W, 3) in 0 to 1, so many times smaller, each pixel the mean of what it is made of."""
    height, width = picture.shape[0] // times, picture.shape[1] // times
    pieces = picture[: height * times, : width * times].reshape(height, times, width, times, 3)
    return np.asarray(255 * pieces.mean(axis=(1, 3))).round().astype(np.uint8)


def save_picture(path: Path, pixels: Pixels) -> None:
    """Writes a PNG, whole or not at all. Raises SinkError where it cannot be written."""
    try:
        with whole_file(path) as part:
            Image.fromarray(pixels).save(part, "PNG", optimize=True)
    except OSError as error:
        raise SinkError(f"cannot write {path}: {error.strerror or error}") from error


class Animation:
    """Pictures of one size, one after the other, in 256 colours."""

    def __init__(self) -> None:
        self._pictures: list[Image.Image] = []
        self._times: list[float] = []
        self._palette: Image.Image | None = None

    def add(self, pixels: Pixels, t: float) -> None:
        """A picture, and when it is shown, in seconds. One of another size is left out."""
        picture = Image.fromarray(pixels)
        if self._palette is None:
            self._palette = _palette(picture)
        elif picture.size != self._pictures[0].size:
            return
        self._pictures.append(picture.quantize(palette=self._palette, dither=Image.Dither.NONE))
        self._times.append(t)

    def save(self, path: Path) -> None:
        """Writes it, whole or not at all, to be shown again and again. Raises SinkError where it
        cannot be written, or there is nothing to write.
        """
        if not self._pictures:
            raise SinkError(f"cannot write {path}: there is no picture")
        # GIF counts in hundredths; rounded so that the whole is as long as it was.
        ticks = [round(100 * t) for t in self._times]
        lengths = [10 * max(1, after - before) for before, after in pairwise(ticks)]
        lengths.append(lengths[-1] if lengths else 1000)
        kind = {".png": "PNG", ".gif": "GIF", ".webp": "WEBP"}[path.suffix.lower()]
        try:
            with whole_file(path) as part:
                self._pictures[0].save(
                    part, kind, save_all=True, append_images=self._pictures[1:],
                    duration=lengths, loop=0, optimize=False,
                )  # fmt: skip
        except OSError as error:
            raise SinkError(f"cannot write {path}: {error.strerror or error}") from error


def _palette(first: Image.Image) -> Image.Image:
    """The colours of the first picture, and those that may come to be seen later."""
    later = [
        tuple(round(255 * shade * part) for part in colour)
        for colour in COLOURS
        for shade in _SHADES
    ]
    found = first.quantize(256 - len(later), Image.Quantize.MEDIANCUT).getpalette() or []
    found = found[: 3 * (256 - len(later))]
    palette = Image.new("P", (1, 1))
    palette.putpalette(found + [part for colour in later for part in colour])
    return palette
