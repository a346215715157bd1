"""Training on a real Dask scheduler with two workers gives what this machine gives."""

import json
import os
import subprocess
import sys
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
from distributed import Client
from joblib import Parallel, delayed

from bridge.cli import main
from drivers.errors import MarkerbridgeError
from tests.training.conftest import PAPER_SIX
from training.workers import cluster_address, workers

SCHEDULER = ("--host", "tcp://127.0.0.1", "--port", "0", "--no-dashboard")
WORKER = ("--nthreads", "1", "--no-nanny", "--no-dashboard")


@contextmanager
def started(folder, worker_commands):
    """A scheduler and workers, each a process of its own: the address, a function that starts one
    more process there, and a client.
    """
    where = folder / "scheduler.json"
    with ExitStack() as stack:

        def start(command):
            process = stack.enter_context(
                subprocess.Popen(
                    [*command, "--scheduler-file", str(where)],
                    cwd=folder,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )
            stack.callback(process.terminate)

        start([sys.executable, "-m", "distributed.cli.dask_scheduler", *SCHEDULER])
        for command in worker_commands:
            start(command)
        with Client(scheduler_file=str(where), timeout=60, set_as_default=False) as client:
            if worker_commands:
                client.wait_for_workers(len(worker_commands), timeout=60)
            yield client.scheduler.address, start, client


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Address of a scheduler with two workers."""
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", *WORKER]
    with started(tmp_path_factory.mktemp("dask"), [worker] * 2) as (address, _, _):
        yield address


def test_work_is_done_by_both_workers(cluster):
    def where(number):  # nested, so that it is sent as it is: workers do not have the tests
        np.linalg.eigvalsh(np.random.default_rng(number).normal(size=(300, 300)))
        return os.getpid()

    with workers(cluster):
        processes = set(Parallel()(delayed(where)(number) for number in range(60)))
    assert os.getpid() not in processes
    assert len(processes) == 2


def test_a_model_trained_on_the_cluster_is_the_same_to_the_byte(cluster, small_dir, tmp_path):
    files = []
    for name, options in (("here", []), ("there", ["--cluster", cluster])):
        out = tmp_path / f"{name}.onnx"
        argv = ["train", str(small_dir), "--out", str(out), "--principal", PAPER_SIX]
        assert main([*argv, *options]) == 0
        files.append(out.read_bytes())
    assert files[0] == files[1]


def test_a_study_of_the_choice_is_the_same(cluster, small_dir, tmp_path):
    found = []
    for name, options in (("here", []), ("there", ["--cluster", cluster])):
        out = tmp_path / f"{name}.json"
        argv = ["select-markers", str(small_dir), "--runs", "30", "--compare", PAPER_SIX]
        assert main([*argv, "--json", str(out), *options]) == 0
        found.append(json.loads(out.read_text()))
    assert found[0] == found[1]
    assert len(found[0]["compared"]) == 2


WITHOUT = """
import sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "training":
            raise ModuleNotFoundError("No module named 'training'", name=name)

sys.meta_path.insert(0, Finder())
from distributed.cli.dask_worker import main
main()
"""


def test_workers_that_lack_the_program_are_an_error_not_a_wait(tmp_path):
    with started(tmp_path, []) as (address, start, client):
        with pytest.raises(MarkerbridgeError, match="the scheduler has no workers"):
            workers(address).__enter__()
        start([sys.executable, "-c", WITHOUT, *WORKER])
        client.wait_for_workers(1, timeout=60)
        with pytest.raises(MarkerbridgeError, match="a worker there lacks this program"):
            workers(address).__enter__()


def test_a_scheduler_that_is_not_there_is_a_clear_error(monkeypatch):
    monkeypatch.setattr("training.workers.CONNECT", 1)
    with pytest.raises(MarkerbridgeError, match="no Dask scheduler answers"):
        workers("tcp://127.0.0.1:9").__enter__()


@pytest.mark.parametrize("address", ["nonsense", "", "http://127.0.0.1:8786", "tcp://host"])
def test_an_address_that_cannot_be_meant(address):
    with pytest.raises(ValueError, match="write tcp://HOST:PORT"):
        cluster_address(address)
    assert cluster_address("tcp://10.0.0.1:8786") == "tcp://10.0.0.1:8786"
