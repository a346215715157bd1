"""What is told to an MQTT broker, which may go away and come back.

Only this module imports paho-mqtt.
"""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import threading
import uuid
from dataclasses import dataclass
from ssl import SSLContext
from typing import Any

from paho.mqtt.client import Client, MQTTMessageInfo
from paho.mqtt.enums import CallbackAPIVersion

from bridge.sinks.sink import SinkError
from drivers.udp_sender import addresses

KEEPALIVE = 5  # s: a broker that has not answered for twice as long is lost
CONNECTING = 3.0  # s for one attempt
GRACE = 0.5  # s that the first attempt gets before the session goes on without
QUICKEST, SLOWEST = 0.1, 2.0  # s between attempts
POLL = 0.5  # s between looks at whether all is well
ENDING = 1.0  # s for the broker to confirm the last words
ROOM = 131_072  # bytes for what the network does not take yet: poses of a second or two

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Account:
    """How to come in. tls: None for a connection that anybody can read."""

    user: str | None = None
    password: str | None = None
    tls: SSLContext | None = None


class Publisher:
    """Keeps a connection, by a thread of its own: `send` and `retain` never wait for it.

    What is sent goes to the topic `stream` once (QoS 0), on the thread that calls; where it cannot
    go it is refused, so nothing is ever late. What is retained (QoS 1) is told again whenever the
    connection is made. will: the topic and payload that are retained until there is another, and
    that the broker tells for us as soon as we are gone.
    """

    limit = 268_435_455  # bytes that MQTT counts to

    def __init__(
        self, host: str, port: int, account: Account, stream: str, will: tuple[str, bytes]
    ) -> None:
        """Raises AddressError where the host is unknown."""
        addresses(host, port, socket.SOCK_STREAM)
        self._host, self._port = host, port
        self._account = account
        self._stream = stream
        self._will = will
        # One name for all connections: with a new one the broker parts with the one before, should
        # it not know yet that it is gone. Else its will would come after what is true by then.
        self._id = f"mb{uuid.uuid4().hex[:21]}"  # 23 letters: every broker takes so many
        self._lock = threading.RLock()
        self._client: Client | None = None  # while there is a connection
        self._problem = "there was no answer yet"
        self._retained = dict([will])
        self._tried = threading.Event()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"mqtt {stream}", daemon=True)
        self._thread.start()
        self._tried.wait(GRACE)

    def send(self, datagram: bytes | bytearray) -> None:
        """Raises SinkError where no broker is there, or the network takes no more."""
        with self._lock:
            if self._client and self._client.want_write():
                self._client.loop_write()
            if not self._client:
                raise SinkError(f"no connection to the broker: {self._problem}")
            if self._client.want_write():
                raise SinkError("the broker, or the network to it, is too slow")
            if self._client.publish(self._stream, datagram).rc:
                raise SinkError(f"no connection to the broker: {self._problem}")

    def retain(self, topic: str, payload: bytes) -> None:
        """What whoever subscribes later is told at once; sent where it is new."""
        with self._lock:
            if self._retained.get(topic) == payload:
                return
            self._retained[topic] = payload
            if self._client:
                self._tell(self._client, topic)

    def close(self) -> None:
        """Tells the will, and ends; a second call does nothing."""
        if self._closing.is_set():
            return
        topic, payload = self._will
        with self._lock:
            self._retained[topic] = payload
            last = self._tell(self._client, topic) if self._client else None
        if last:
            # The connection may be lost meanwhile: then the broker says it.
            with contextlib.suppress(RuntimeError, ValueError):
                last.wait_for_publish(ENDING)
        self._closing.set()
        with self._lock:
            if self._client:
                self._client.disconnect()  # the broker hangs up, which wakes our thread
        self._thread.join(ENDING)

    def _tell(self, client: Client, topic: str) -> MQTTMessageInfo:
        return client.publish(topic, self._retained[topic], qos=1, retain=True)

    def _work(self) -> None:
        wait = QUICKEST
        while not self._closing.is_set():
            connected = self._serve()
            self._tried.set()
            wait = QUICKEST if connected else min(2 * wait, SLOWEST)
            self._closing.wait(wait)

    def _serve(self) -> bool:
        """One connection, until it ends; whether there was one.

        A client of its own for each: paho's sends again what an earlier connection left open, after
        what is true now.
        """
        client = self._new_client()
        connected = False
        try:
            client.connect(self._host, self._port, KEEPALIVE)
            while (line := client.socket()) and not self._closing.is_set():
                # An outlet's thread may find out first that the line is lost, and close it.
                with contextlib.suppress(OSError, ValueError):
                    select.select([line], [line] if client.want_write() else [], [], POLL)
                with self._lock:
                    client.loop_read()
                    if client.want_write():
                        client.loop_write()
                    client.loop_misc()
                    connected = connected or self._client is not None
        except Exception as error:  # of the network, or of paho over what is no MQTT
            self._problem = getattr(error, "strerror", None) or str(error) or type(error).__name__
        with self._lock:
            self._client = None
            client.disconnect()
        return connected

    def _new_client(self) -> Client:
        client = Client(CallbackAPIVersion.VERSION2, self._id)
        client.connect_timeout = CONNECTING
        client.username_pw_set(self._account.user, self._account.password)
        if self._account.tls:
            client.tls_set_context(self._account.tls)
        client.will_set(*self._will, qos=1, retain=True)
        client.on_socket_open = _hurry
        client.on_connect = self._answered
        client.on_disconnect = self._parted
        return client

    def _answered(self, client: Client, _data: Any, _flags: Any, answer: Any, _more: Any) -> None:
        """The broker has let us in, or not; within `loop_read`, so under the lock."""
        if answer.is_failure:
            self._problem = f"it says {answer}"
            return
        self._client = client
        for topic in self._retained:
            self._tell(client, topic)
        log.info("mqtt://%s:%d: connected, %s", self._host, self._port, self._stream)
        self._tried.set()

    def _parted(self, client: Client, *_reason: Any) -> None:
        """The connection has ended; within whatever found that out, so under the lock."""
        if self._client is client:
            self._client = None
            self._problem = "it was lost"
            if not self._closing.is_set():
                log.info("mqtt://%s:%d: the connection was lost", self._host, self._port)


def _hurry(_client: Client, _data: Any, line: Any) -> None:
    """A pose leaves at once, and few wait."""
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, ROOM)
