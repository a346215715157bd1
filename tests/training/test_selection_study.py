import pytest
from joblib import parallel_config

from drivers.errors import MarkerbridgeError
from training.corpus import read_corpus
from training.dataset import training_captures
from training.marker_selection import Selection
from training.pipeline import CANDIDATES, candidate_covariance
from training.recipe import RECIPES
from training.selection_study import BATCH, START_WORK, SelectionStudy, repeat_selection
from training.workers import workers

RUNS = BATCH + 12


@pytest.fixture(scope="module")
def covariance(small_dir):
    captures = training_captures(small_dir)
    corpus = read_corpus(small_dir, captures, RECIPES["local"], lambda *_: None, pytest.fail)
    return candidate_covariance(corpus)


def study(covariance, runs=RUNS, seed=0, record=None, advance=lambda *_: None, restarts=2):
    with parallel_config(backend="sequential"):
        return repeat_selection(covariance, CANDIDATES, runs, restarts, seed, advance, record)


@pytest.fixture(scope="module")
def whole(covariance, tmp_path_factory):
    """A study that nothing stopped, and its record."""
    record = tmp_path_factory.mktemp("whole") / "runs.csv"
    return study(covariance, record=record), record.read_bytes()


def test_shares_are_counts_of_the_runs():
    runs = [("C", "A"), ("A", "C"), ("B",), ("C",), ("C", "A")]
    found = SelectionStudy(("A", "B", "C", "D"), 10, Selection(("A", "B"), 4, 5), runs)
    assert list(found.shares.items()) == [("C", 0.8), ("A", 0.6), ("B", 0.2)]
    assert list(found.sets.items()) == [(("A", "C"), 0.6), (("B",), 0.2), (("C",), 0.2)]
    assert list(found.sizes.items()) == [(1, 0.4), (2, 0.6)]
    assert found.shared == pytest.approx(4 / 5)  # one of the two in four of five runs


def test_real_runs_choose_few_candidates_and_not_always_the_same(whole):
    runs, _ = whole
    assert len(runs) == RUNS
    assert all(set(run) <= set(CANDIDATES) and 2 <= len(run) <= 12 for run in runs)
    assert 1 < len({frozenset(run) for run in runs}) <= RUNS


def test_the_same_runs_wherever_and_however_many(covariance, whole):
    runs, _ = whole
    with workers(None, processes=True):
        assert repeat_selection(covariance, CANDIDATES, RUNS, 2, 0, lambda *_: None) == runs
    with parallel_config(backend="threading", n_jobs=3):
        assert repeat_selection(covariance, CANDIDATES, 5, 2, 0, lambda *_: None) == runs[:5]
    assert study(covariance, seed=1) != runs


def test_a_study_that_was_stopped_goes_on(covariance, whole, tmp_path):
    runs, content = whole
    record = tmp_path / "runs.csv"

    class Stopped(Exception):
        pass

    def stop(what, units):
        raise Stopped

    with pytest.raises(Stopped):
        study(covariance, record=record, advance=stop)
    kept = record.read_bytes()
    assert content.startswith(kept)
    assert kept.count(b"\n") == 2 + BATCH
    record.write_bytes(kept[:-3])  # as if killed while it wrote: the last run is lost
    told = []
    assert study(covariance, record=record, advance=lambda *said: told.append(said)) == runs
    assert record.read_bytes() == content
    assert told == [
        (f"{BATCH - 1} runs were done before", (BATCH - 1) * 2 * START_WORK),
        (f"{RUNS} of {RUNS} runs", 13 * 2 * START_WORK),
    ]


def test_runs_that_are_kept_are_not_done_again(covariance, whole, tmp_path):
    runs, content = whole
    record = tmp_path / "runs.csv"
    lines = content.decode().splitlines(keepends=True)
    lines[2 + 4] = "4,LFHD RTOE\n"  # what no run would choose tells that it was read
    record.write_text("".join(lines))
    again = study(covariance, runs=RUNS + 3, record=record)
    assert again[4] == ("LFHD", "RTOE")
    assert again[:4] + again[5:RUNS] == runs[:4] + runs[5:]
    assert again[RUNS:] == study(covariance, runs=RUNS + 3)[RUNS:]
    assert study(covariance, runs=3, record=record) == runs[:3]  # fewer than are kept


@pytest.mark.parametrize("length", [0, 10, 93, 100])
def test_a_record_cut_in_its_head_starts_anew(covariance, whole, tmp_path, length):
    _, content = whole
    record = tmp_path / "runs.csv"
    record.write_bytes(content[:length])
    study(covariance, record=record)
    assert record.read_bytes() == content


def test_a_record_of_something_else_is_left_alone(covariance, whole, tmp_path):
    _, content = whole
    record = tmp_path / "runs.csv"
    other = covariance.copy()
    other[3, 3] *= 1.001
    for matrix, changed in ((other, {}), (covariance, {"seed": 1}), (covariance, {"restarts": 3})):
        record.write_bytes(content)
        with pytest.raises(MarkerbridgeError, match="other data or with other options: choose"):
            study(matrix, record=record, **changed)
        assert record.read_bytes() == content
    for foreign in (b"run,markers\n1,LFHD\n", b"\xff\xfe\n", b"x"):
        record.write_bytes(foreign)
        with pytest.raises(MarkerbridgeError, match=r"runs\.csv holds runs on other data"):
            study(covariance, record=record)
        assert record.read_bytes() == foreign
    record.write_bytes(content + b"x,LFHD\n")
    with pytest.raises(MarkerbridgeError, match=r"runs\.csv is damaged"):
        study(covariance, record=record)


def test_another_machines_rounding_is_the_same_data(covariance, whole, tmp_path):
    runs, content = whole
    record = tmp_path / "runs.csv"
    record.write_bytes(content)
    assert study(covariance * (1 + 1e-15), record=record) == runs


def test_a_record_that_cannot_be_written(covariance, tmp_path):
    for record in (tmp_path / "no" / "runs.csv", tmp_path):
        with pytest.raises(MarkerbridgeError, match="cannot keep runs in"):
            study(covariance, record=record)
