"""Our own pose stream to an MQTT broker, for any number of readers: `mqtt://HOST/TOPIC`.

TOPIC/pose    the pose message of `osc://`
TOPIC/layout  its layout message, retained: whoever subscribes later has it at once
TOPIC/state   `live` while there is a pose, else `lost`, retained; also when this program dies

Options: `user`, `password_file`, `tls`, and those of all sinks of markers (docs/wires.md).
"""

from __future__ import annotations

import ssl
from collections.abc import Iterable
from pathlib import Path

from bridge.pose import Pose
from bridge.sinks.engine import Profile, Sender
from bridge.sinks.markers import MarkerSink
from bridge.sinks.pose_message import PoseMessages
from bridge.sinks.sink import SinkContext, SinkError
from drivers.coordinates import OURS
from drivers.url import Url, UrlError

TOPIC = "markerbridge"
PORT, TLS_PORT = 1883, 8883
POSE, LAYOUT, STATE = "pose", "layout", "state"
LIVE, LOST = b"live", b"lost"
LONGEST = 65_000  # bytes of a topic; MQTT counts to 65,535, and ours have a last part


class MqttSink(MarkerSink):
    """All markers of each pose with provenance and sigma, one message a frame."""

    profile = Profile(PORT, 0.0, OURS)
    prompt = False  # how long another's code takes nobody knows
    one_body = False

    def __init__(self, url: Url, context: SinkContext) -> None:
        """Raises UrlError, AddressError where the host is unknown, SinkError without paho-mqtt.

        A broker that is not there is no error: it may come.
        """
        self._topic = _topic(url, context.performer)
        self._user = url.take("user", None, str)
        self._password = url.take("password_file", None, _read_password)
        self._tls = url.take("tls", None, _read_tls)
        if self._password is not None and self._user is None:
            raise UrlError(f"'{url.text}': a password wants user=NAME", "user", "is missing")
        super().__init__(url, context)
        self._context = context
        self._messages = PoseMessages(self._layout, self._convention.frame.unit)
        self._rate: float | None = None

    def _sender(self, url: Url) -> Sender:
        try:
            from bridge.sinks.publisher import Account, Publisher
        except ModuleNotFoundError:
            raise SinkError(
                f"no {url.scheme}: paho-mqtt is not installed: pip install 'markerbridge[mqtt]'"
            ) from None
        self._publisher = Publisher(
            *url.address(TLS_PORT if self._tls else PORT),
            Account(self._user, self._password, self._tls),
            stream=f"{self._topic}/{POSE}",
            will=(f"{self._topic}/{STATE}", LOST),
        )
        return self._publisher

    def _datagrams(self, pose: Pose) -> Iterable[bytes]:
        if self._rate != self._context.rate:
            self._rate = self._context.rate
            self._publisher.retain(f"{self._topic}/{LAYOUT}", self._messages.layout(self._rate))
        is_lost = pose.provenance.tobytes() == self._lost
        self._publisher.retain(f"{self._topic}/{STATE}", LOST if is_lost else LIVE)
        return (self._messages.pose(pose, self._seconds(pose), self._xyz(pose)),)


def _topic(url: Url, performer: str) -> str:
    """The topic below which all is: the address's path, and the performer's name."""
    if "@" in url.text.partition("?")[0]:
        raise UrlError(
            f"'{url.scheme}://…@{url.host}': write user=NAME&password_file=FILE as options instead"
        )
    topic = "/".join(part for part in (url.take_path() or TOPIC, performer) if part)
    if topic.startswith("$") or not topic.isprintable() or set("+#") & set(topic):
        raise UrlError(f"'{url.text}': '{topic}' is no topic: + and # and a $ in front mean others")
    if len(topic.encode()) > LONGEST:
        raise UrlError(f"'{url.text}': a topic has at most {LONGEST} bytes")
    return topic


def _read_password(path: str) -> str:
    """What stands in a file: an address is seen by all who list processes. Raises ValueError."""
    try:
        return Path(path).read_text().rstrip("\r\n")
    except (OSError, UnicodeError) as error:
        raise ValueError(getattr(error, "strerror", None) or "it is no text") from None


def _read_tls(text: str) -> ssl.SSLContext | None:
    """`no`, `yes`, or a file of the authorities to trust (PEM). Raises ValueError."""
    if text == "no":
        return None
    try:
        return ssl.create_default_context(cafile=None if text == "yes" else text)
    except OSError as error:
        problem = getattr(error, "strerror", None) or error
        raise ValueError(f"write yes, no, or a file of certificates (PEM): {problem}") from None
