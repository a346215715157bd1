"""The state of a session as JSON, for whoever asks: `curl -s localhost:9300`.

As much of HTTP as this needs. Nobody who asks can hold anything up: one thread answers, a few
clients at a time and not too many a second, and each has two seconds in all.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

from drivers.errors import MarkerbridgeError

AT_ONCE = 8  # clients; others wait in the system's queue
PATIENCE = 2.0  # s that a client gets, from its connection to the last byte of the answer
PAUSE = 0.01  # s between two clients: nobody keeps the session from its work by asking
LONGEST = 8192  # bytes of a request

Endpoint = tuple[str, int]

log = logging.getLogger(__name__)


class StatusError(MarkerbridgeError):
    """The status cannot be served there; the message says why and what to do."""


def parse_endpoint(text: str) -> Endpoint:
    """`HOST:PORT`, or a port of this machine alone. Raises ValueError."""
    try:
        parts = urlsplit(f"//{text}" if ":" in text else f"//:{text}")
        if parts.port is not None and parts.netloc and not (parts.path or parts.query):
            return parts.hostname or "127.0.0.1", parts.port
    except ValueError:
        pass
    raise ValueError(f"'{text}' is no address: write HOST:PORT or PORT, for example 9300")


class StatusServer:
    """Answers GET / with what `status` returns, on a thread of its own, until it is closed."""

    def __init__(self, endpoint: Endpoint, status: Callable[[], Mapping[str, Any]]) -> None:
        """Raises StatusError where it cannot listen. Port 0 lets the system choose `port`."""
        self._status = status
        self._host, port = endpoint
        try:
            family, *_, address = socket.getaddrinfo(
                self._host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            self._socket = socket.create_server(address, family=family)
        except OSError as error:
            raise StatusError(
                f"cannot serve the status at {self._host}:{port}: {error.strerror}; "
                "choose another address with --status"
            ) from error
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="status", daemon=True)
        self._thread.start()
        self._ready.wait()

    @property
    def url(self) -> str:
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self.port}/"

    def close(self) -> None:
        """Ends it, with whoever is being answered; a second call does nothing."""
        if self._thread.is_alive():
            with contextlib.suppress(RuntimeError):  # it has just ended
                self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        accepting = asyncio.create_task(self._accept())
        self._ready.set()
        await self._end.wait()
        accepting.cancel()

    async def _accept(self) -> None:
        room = asyncio.Semaphore(AT_ONCE)
        answers: set[asyncio.Task[None]] = set()

        def ended(answer: asyncio.Task[None]) -> None:
            answers.discard(answer)
            room.release()

        while True:
            await room.acquire()
            client = await self._next_client()
            answer = asyncio.create_task(self._answer(client))
            answers.add(answer)
            answer.add_done_callback(ended)
            await asyncio.sleep(PAUSE)

    async def _next_client(self) -> socket.socket:
        while True:
            try:
                return (await asyncio.get_running_loop().sock_accept(self._socket))[0]
            except OSError:  # it has gone again, or there are too many open files
                await asyncio.sleep(PATIENCE)

    async def _answer(self, client: socket.socket) -> None:
        reader, writer = await asyncio.open_connection(sock=client, limit=LONGEST)
        try:
            async with asyncio.timeout(PATIENCE):
                writer.write(self._reply(await reader.readuntil(b"\r\n\r\n")))
                writer.close()
                await writer.wait_closed()
        except (OSError, EOFError, asyncio.LimitOverrunError):
            pass  # too slow, too long, or gone: theirs to mend
        finally:
            writer.transport.abort()

    def _reply(self, request: bytes) -> bytes:
        method, _, rest = request.partition(b"\r\n")[0].partition(b" ")
        target, _, version = rest.partition(b" ")
        if not version.startswith(b"HTTP/1."):
            state, body = HTTPStatus.BAD_REQUEST, ""
        elif method not in (b"GET", b"HEAD"):
            state, body = HTTPStatus.METHOD_NOT_ALLOWED, ""
        elif target.partition(b"?")[0] != b"/":
            state, body = HTTPStatus.NOT_FOUND, ""
        else:
            state, body = self._asked()
        head = (
            f"HTTP/1.1 {state.value} {state.phrase}\r\n"
            "Content-Type: application/json\r\n"
            f"Content-Length: {len(body.encode())}\r\n"
            "Allow: GET, HEAD\r\n"
            "Cache-Control: no-store\r\n"
            "Connection: close\r\n\r\n"
        )
        return (head + ("" if method == b"HEAD" else body)).encode()

    def _asked(self) -> tuple[HTTPStatus, str]:
        try:
            return HTTPStatus.OK, json.dumps(self._status(), indent=2) + "\n"
        except Exception:  # the session goes on; so does whoever asks
            log.exception("the status cannot be told")
            return HTTPStatus.INTERNAL_SERVER_ERROR, ""
