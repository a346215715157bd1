"""The black box: `log:session.mcap` (docs/wires.md), replayed by the source of the same name."""

from __future__ import annotations

import hashlib
import itertools
import json
import logging
from importlib.metadata import version
from pathlib import Path

from bridge.pose import Pose
from bridge.sinks.sink import Input, Sink, SinkContext, SinkError
from drivers.files import numbered, of_performer
from drivers.frame import Layout
from drivers.session_log import Entry, LoggedPose, LogWriter
from drivers.url import Url

log = logging.getLogger(__name__)


class LogSink(Sink):
    """Records all that comes in and all poses, each at once; nothing is dropped.

    A log that is there is kept: the next goes to `session-2.mcap` and so on.
    """

    waiting = None
    records = True

    def __init__(self, url: Url, context: SinkContext) -> None:
        """Raises SinkError where the file cannot be written."""
        self.name = url.text
        path = of_performer(Path(url.file_path()), context.performer)
        url.finish()
        if path.exists() and not path.is_file():
            raise SinkError(f"cannot write {path}: it is a folder, or no ordinary file")
        try:
            self._log = _new_log(path)
        except OSError as error:
            raise SinkError(f"cannot write {path}: {error.strerror}") from error
        if self._log.path != path:
            log.warning("%s is there already: recording to %s", path, self._log.path)
        self._context = context
        self._layout = Layout(context.info.labels, context.rate)
        self._knows = False

    def __call__(self, pose: Pose) -> None:
        if self._layout.rate != self._context.rate:
            self._layout = Layout(self._context.info.labels, self._context.rate)
        self._add(
            LoggedPose(pose.index, pose.t, self._layout, pose.xyz, pose.provenance, pose.sigma)
        )

    def record(self, came: Input) -> None:
        self._add(came)

    def close(self) -> None:
        """Raises SinkError where the disk has no room for the end of the file."""
        try:
            self._log.close()
        except OSError as error:
            raise SinkError(
                f"cannot end {self._log.path}: {error.strerror}; what is in it can be read"
            ) from error

    def _add(self, entry: Entry) -> None:
        if not self._knows:
            self._log.facts |= self._facts()
            self._knows = True
        self._log.add(entry)

    def _facts(self) -> dict[str, str]:
        """What is known of the session when it begins."""
        model = self._context.model
        content = model.read_bytes() if model and model.is_file() else b""
        return {
            "model": model.name if model else "",
            "model_sha256": hashlib.sha256(content).hexdigest() if content else "",
            "tracked": json.dumps(self._context.info.tracked),
        }


def _new_log(path: Path) -> LogWriter:
    """A log of this name, or the next that is free."""
    for number in itertools.count(1):
        try:
            return LogWriter(numbered(path, number), f"markerbridge {version('markerbridge')}")
        except FileExistsError:
            continue
    raise AssertionError  # there is always a next number
