"""Files over HTTP: patient with a bad line, and going on where a cut download ended."""

from __future__ import annotations

import tempfile
from email.utils import formatdate
from importlib.metadata import version
from pathlib import Path

import requests
import urllib3

from drivers.clock import Clock
from drivers.errors import MarkerbridgeError

WAITS = (1.0, 4.0, 16.0)  # s before each further try
TIMEOUT = 60.0  # s without a byte
LARGEST = 1 << 30  # bytes of one file: more is nothing that was asked for
LARGEST_PAGE = 1 << 24
_CHUNK = 1 << 16  # bytes
_AGENT = f"markerbridge/{version('markerbridge')}"


class DownloadError(MarkerbridgeError):
    """Something cannot be had; the message names its address and says why."""


class _Passing(Exception):
    """What may be over at the next try."""


def download(url: str, path: Path, clock: Clock, largest: int = LARGEST) -> None:
    """Loads what is at `url` into `path`, after the bytes of it that are there already.

    A lost line, a cut body and an error of the server (5xx) are tried again, after `WAITS`. What
    has come by then stays in `path`, also after an error, for the next call to go on from. Raises
    DownloadError; OSError where `path` cannot be written.
    """
    for wait in (*WAITS, None):
        try:
            _attempt(url, path, largest)
        except _Passing as error:
            if wait is None:
                raise DownloadError(f"{url}: {error} ({len(WAITS) + 1} tries)") from error
            clock.sleep_until(clock.now() + wait)
        else:
            return


def read_page(url: str, clock: Clock) -> str:
    """The text of a page. Raises DownloadError."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "page")
        download(url, path, clock, LARGEST_PAGE)
        return path.read_text(encoding="utf-8", errors="replace")


def _attempt(url: str, path: Path, largest: int) -> None:
    """One request: for all of it, or for the rest where the server still has the same file."""
    there = path.stat().st_size if path.exists() else 0
    headers = {"User-Agent": _AGENT, "Accept-Encoding": "identity"}
    if there:
        since = formatdate(path.stat().st_mtime, usegmt=True)
        headers |= {"Range": f"bytes={there}-", "If-Unmodified-Since": since}
    try:
        with requests.get(url, headers=headers, timeout=TIMEOUT, stream=True) as answer:
            status = answer.status_code
            rest = answer.headers.get("Content-Range", "").startswith(f"bytes {there}-")
            if there and (status in (412, 416) or (status == 206 and not rest)):
                path.unlink()  # it is not the beginning of what the server has now
                return _attempt(url, path, largest)
            if status >= 500:
                raise _Passing(f"the server answers {status} {answer.reason}")
            if status >= 400:
                raise DownloadError(f"{url}: the server answers {status} {answer.reason}")
            with path.open("ab" if status == 206 else "wb") as file:
                while data := answer.raw.read1(_CHUNK):  # each byte that comes is kept
                    file.write(data)
                    if file.tell() > largest:
                        raise DownloadError(f"{url}: more than {largest:,} bytes, and no end")
    except requests.exceptions.SSLError as error:
        raise DownloadError(f"{url}: no safe connection ({error})") from error
    except (requests.Timeout, urllib3.exceptions.TimeoutError) as error:
        raise _Passing(f"no answer within {TIMEOUT:.0f} s") from error
    except requests.ConnectionError as error:
        raise _Passing("no connection") from error
    except urllib3.exceptions.HTTPError as error:
        raise _Passing("the connection was cut") from error
    except requests.RequestException as error:
        raise DownloadError(f"{url}: {error}") from error
