"""What is done again and again beside a running session."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def repeating(call: Callable[[], None], every: float, name: str) -> Iterator[None]:
    """Calls `call` every so many seconds, on a thread of that name, until the block ends; never
    where `every` is 0.
    """
    stop = threading.Event()

    def work() -> None:
        while not stop.wait(every or None):
            call()

    thread = threading.Thread(target=work, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
