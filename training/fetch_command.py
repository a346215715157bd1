"""`markerbridge fetch`: captures from the CMU database, with a manifest, into a folder."""

from __future__ import annotations

import argparse
from pathlib import Path

from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import MarkerbridgeError, UsageError
from drivers.marker_set import MARKERS
from drivers.options import checked
from training.cmu import SITE, Trial
from training.dataset import MANIFEST, Warn
from training.download import DownloadError
from training.fetch import CaptureFolder, FetchError, trials_of
from training.manifest import read_rows, write_rows
from training.progress import progress
from training.telling import Notices


def main(argv: list[str], clock: Clock = SYSTEM_CLOCK) -> int:
    """Runs the command. Raises MarkerbridgeError; UsageError for what cannot be meant."""
    options = _parser().parse_args(argv)
    notices = Notices()
    folder = options.to
    if options.checksums is not None and not options.checksums.is_file():
        raise UsageError(f"--checksums {options.checksums}: no such file")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise MarkerbridgeError(f"cannot make the folder {folder}: {error.strerror}") from error
    rows = read_rows(folder)
    captures = CaptureFolder(folder, options.site, options.checksums, clock)

    trials, unlisted = _list_trials(options.site, options.subjects, clock, notices.warn)
    fetched: list[Trial] = []
    try:
        try:
            with progress(notices.console, len(trials)) as advance:
                for trial in trials:
                    if _fetch(captures, trial, notices.warn):
                        fetched.append(trial)
                    advance(trial.file, 1)
        finally:  # after Ctrl-C too
            if fetched:
                write_rows(folder, rows, map(_row, fetched))
    except KeyboardInterrupt:
        notices.say("the same command goes on from here")
        raise
    except OSError as error:
        raise MarkerbridgeError(f"cannot write in {folder}: {error.strerror}") from error
    if fetched:
        notices.say(f"{folder}: {len(fetched)} captures, described in {MANIFEST}")
    if unlisted or len(fetched) < len(trials):
        raise MarkerbridgeError(
            "not all could be had, see above: the same command again goes on from here"
        )
    return 0


def _list_trials(
    site: str, subjects: list[str], clock: Clock, warn: Warn
) -> tuple[list[Trial], list[str]]:
    """The trials of all subjects, and the subjects whose trials are not to be found out."""
    trials, unlisted = [], []
    for subject in subjects:
        try:
            trials += trials_of(site, subject, clock)
        except (FetchError, DownloadError) as error:
            warn(f"missing: subject {subject}: {error}")
            unlisted.append(subject)
    return trials, unlisted


def _fetch(captures: CaptureFolder, trial: Trial, warn: Warn) -> bool:
    """Whether the trial's capture is there now; `warn` is told why not, and what it lacks."""
    try:
        found = captures.fetch(trial).layout.labels
    except (FetchError, DownloadError) as error:
        warn(f"missing: {error}")
        return False
    lacking = [label for label in MARKERS if label not in found]
    if lacking:
        warn(f"{trial.file} is kept, but cannot be used: it lacks {', '.join(lacking)}")
    return True


def _row(trial: Trial) -> dict[str, str]:
    return {
        "file": trial.file,
        "kind": "real",
        "dataset": "CMU",
        "subject": trial.subject,
        "motion": trial.motion,
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge fetch",
        description="Downloads captures of chosen subjects of the CMU Graphics Lab Motion Capture "
        "Database and describes them in a manifest.csv. What is there and right is not downloaded "
        "again, so the same command again goes on where it ended.",
    )
    add = parser.add_argument
    add("database", choices=("cmu",), help="where from")
    add(
        "--subjects",
        required=True,
        type=checked(_subjects),
        metavar="02,07",
        help="the numbers of the subjects",
    )
    add("--to", required=True, type=Path, metavar="DIR", help="the folder; made if need be")
    add(
        "--from",
        dest="site",
        default=SITE,
        type=checked(_site),
        metavar="URL",
        help="a mirror that is laid out as the database's own site (the default) is",
    )
    add(
        "--checksums",
        type=Path,
        metavar="FILE",
        help="a checksums.txt from elsewhere that every file must match",
    )
    return parser


def _subjects(text: str) -> list[str]:
    """`2,07` as 02 and 07, each once. Raises ValueError."""
    if text == "all":
        raise ValueError(
            f"the database asks not to be crawled: {SITE}/faqs.php has all captures in archives"
        )
    words = [word.strip() for word in text.split(",")]
    wrong = [word for word in words if not (word.isdecimal() and 0 < int(word) < 1000)]
    if wrong:
        raise ValueError(f"'{wrong[0]}' is no subject's number: write for example 02,07")
    return list(dict.fromkeys(f"{int(word):02d}" for word in words))


def _site(text: str) -> str:
    if not text.startswith(("http://", "https://")):
        raise ValueError(f"'{text}' is no address: write for example {SITE}")
    return text.rstrip("/")
