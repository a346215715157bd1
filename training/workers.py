"""Where parallel work is done: on the cores of this machine, or on a Dask cluster.

Inside `workers`, joblib's `Parallel` (and with it scikit-learn's forests) uses what was chosen.
A task must give the same answer wherever it runs: it is seeded, and its linear algebra has one
thread (`single_threaded`), since sums depend on how they are split.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from importlib.metadata import version
from typing import Any, ParamSpec, TypeVar

from joblib import parallel_config
from threadpoolctl import threadpool_limits

from drivers.errors import MarkerbridgeError
from drivers.options import checked

P = ParamSpec("P")
T = TypeVar("T")

CONNECT = 10  # s to wait for the scheduler


def cluster_address(text: str) -> str:
    """`tcp://HOST:PORT` of a Dask scheduler, as an option. Raises ValueError."""
    if not re.fullmatch(r"(tcp|tls)://[^\s:/]+:\d+", text):
        raise ValueError(f"'{text}' is no address of a Dask scheduler: write tcp://HOST:PORT")
    return text


def add_cluster_option(parser: argparse.ArgumentParser, work: str) -> None:
    """Adds --cluster; work: what is done there."""
    parser.add_argument(
        "--cluster",
        type=checked(cluster_address),
        metavar="tcp://HOST:PORT",
        help=f"a Dask scheduler whose workers do {work}; they need this program and DATA at the "
        "same path",
    )


def check_cluster(cluster: str | None) -> None:
    """Tells of a cluster that cannot be reached before the work, as `workers` does."""
    with workers(cluster):
        pass


@contextmanager
def workers(cluster: str | None, *shared: object, processes: bool = False) -> Iterator[None]:
    """All cores of this machine, or the workers of the Dask scheduler at `cluster`.

    shared: large arguments that many tasks take; each worker is sent them once. processes: on this
    machine, for work that threads would do one after the other. Raises MarkerbridgeError where the
    scheduler does not answer, has no workers, or one of them lacks this program.
    """
    if cluster is None:
        with parallel_config(backend="loky" if processes else "threading", n_jobs=-1):
            yield
        return
    from distributed import Client

    try:
        client = Client(cluster, timeout=CONNECT, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise MarkerbridgeError(
            f"--cluster {cluster}: no Dask scheduler answers there ({error})"
        ) from error
    with client:
        _check(client, cluster)
        with parallel_config(backend="dask", n_jobs=-1, client=client, scatter=list(shared)):
            yield


def _check(client: Any, cluster: str) -> None:
    """That there are workers, and that they have this program: else work would never come back."""

    def installed() -> str:  # nested, so that it is sent as it is and not by its name
        from importlib.metadata import version

        import training.pipeline  # noqa: F401

        return version("markerbridge")

    try:
        found = client.run(installed)
    except ImportError as error:
        raise MarkerbridgeError(
            f"--cluster {cluster}: a worker there lacks this program: "
            f"pip install 'markerbridge[train,cluster]' ({error})"
        ) from error
    if not found:
        raise MarkerbridgeError(
            f"--cluster {cluster}: the scheduler has no workers: start some with "
            f"`dask worker {cluster}`"
        )
    others = set(found.values()) - {version("markerbridge")}
    if others:
        raise MarkerbridgeError(
            f"--cluster {cluster}: workers have markerbridge {', '.join(sorted(others))}, here it "
            f"is {version('markerbridge')}"
        )


def single_threaded(work: Callable[P, T]) -> Callable[P, T]:
    """`work` with one thread for linear algebra, and no workers of its own."""

    @wraps(work)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        with threadpool_limits(1), parallel_config(backend="sequential"):
            return work(*args, **kwargs)

    return limited
