"""Captures of the CMU database in a folder: had from its site, whole, and the same every time.

The site publishes no checksums, so the folder keeps its own: the SHA-256 that each file had when it
first came. A file that differs later is fetched again, and one that comes back another is refused.
"""

from __future__ import annotations

from pathlib import Path

import pooch

from drivers.c3d_file import Clip, read_c3d
from drivers.clock import Clock
from drivers.errors import MarkerbridgeError
from drivers.files import whole_file
from drivers.frame import SourceError
from training.cmu import Trial, index_url, read_index
from training.download import download, read_page

CHECKSUMS = "checksums.txt"  # a registry as pooch reads it: a name and its sum in every line

pooch.get_logger().setLevel("WARNING")  # the command tells what it does itself


class FetchError(MarkerbridgeError):
    """A capture, or the list of them, is not what it must be; the message names it."""


def trials_of(site: str, subject: str, clock: Clock) -> list[Trial]:
    """What the site's index lists of a subject. Raises FetchError, DownloadError."""
    url = index_url(site, subject)
    trials = read_index(read_page(url, clock), subject)
    if not trials:
        raise FetchError(f"the index at {url} names no trial of subject {subject}")
    return trials


class CaptureFolder:
    """A folder of captures, `02/02_01.c3d`, and the checksums that they must have.

    given: a registry from elsewhere that every file must match, in place of the folder's own.
    Raises FetchError for a registry that cannot be read.
    """

    def __init__(self, folder: Path, site: str, given: Path | None, clock: Clock) -> None:
        self._folder = folder
        self._site = site
        self._clock = clock
        self._seen = _registry(folder / CHECKSUMS)
        self._known = self._seen if given is None else _registry(given)
        self._given = given

    def fetch(self, trial: Trial) -> Clip:
        """Loads a trial's capture unless it is there and right; in either case opens it.

        Raises FetchError or DownloadError for one that cannot be had as it must be (it is then not
        there, except for one that was there before), OSError where the folder cannot be written.
        """
        name = trial.file
        path = self._folder / name
        known = self._known.get(name)
        if known is None and self._given is not None:
            raise FetchError(f"{name}: {self._given} has no checksum of it")
        if known is None and path.is_file() and not _is_capture(path):
            path.unlink()
        site = pooch.create(self._folder, f"{self._site}/subjects/", registry={name: known})
        try:
            site.fetch(name, downloader=self._download)
            clip = read_c3d(path, labels=None)
        except (ValueError, SourceError) as error:  # ValueError: pooch found another checksum
            raise FetchError(str(error)) from error
        self._keep(name, pooch.file_hash(str(path)))
        return clip

    def _download(self, url: str, target: str, _: pooch.Pooch) -> None:
        """What pooch calls: the part that has come stays beside the target, for another time."""
        part = Path(target).with_name(url.rpartition("/")[2] + ".part")
        download(url, part, self._clock)
        try:
            read_c3d(part, labels=None)
        except SourceError as error:
            part.unlink()
            raise FetchError(f"{url} is no whole capture: {error}") from error
        part.replace(target)

    def _keep(self, name: str, checksum: str) -> None:
        if self._seen.get(name) == checksum:
            return
        self._seen[name] = checksum
        with whole_file(self._folder / CHECKSUMS) as part:
            lines = (f"{name} {self._seen[name]}\n" for name in sorted(self._seen))
            part.write_text("".join(lines), encoding="utf-8")


def _is_capture(path: Path) -> bool:
    try:
        read_c3d(path, labels=None)
    except SourceError:
        return False
    return True


def _registry(path: Path) -> dict[str, str]:
    """The checksums by file that a registry holds; none where it is not there."""
    found = pooch.create(path.parent, "", registry={})
    if path.is_file():
        try:
            found.load_registry(path)
        except (OSError, ValueError) as error:
            raise FetchError(f"{path}: not a list of names and checksums ({error})") from error
    registry: dict[str, str] = found.registry
    return registry
