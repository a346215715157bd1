from __future__ import annotations

import pickle

import numpy as np
import pytest

from bridge.statistics import Durations, Hop, Mean
from bridge.truth import rms_mm


def test_quantiles_are_right_to_a_few_percent_in_constant_memory() -> None:
    sample = np.random.default_rng(0).lognormal(-7, 1, 50_000)
    durations = Durations()
    for seconds in sample:
        durations.add(float(seconds))
    shares = (0.1, 0.5, 0.99, 0.999)
    assert durations.quantiles(*shares) == pytest.approx(np.quantile(sample, shares), rel=0.03)
    assert durations.maximum == sample.max()
    assert durations.quantiles(1.0)[0] == pytest.approx(sample.max(), rel=0.03)


def test_the_ends_of_the_scale_are_counted_too() -> None:
    durations = Durations()
    assert durations.quantiles(0.5)[0] is None
    durations.add(0.0)
    assert durations.quantiles(0.5)[0] == 0.0
    durations.add(1e6)
    assert durations.quantiles(1.0)[0] is not None
    assert durations.maximum == 1e6


def test_a_hop_remembers_the_last_second_and_no_more_than_it_can() -> None:
    hop = Hop()
    for number in range(100_000):  # a thousand a second, older and older
        now = number / 1000
        hop.passed(now - number / 1e6, now)
    ages = hop.ages(100.0)
    assert ages.count == 100_000
    assert ages.worst == ages.max == pytest.approx(0.099999)
    assert ages.now == pytest.approx(0.0995, abs=1e-4)
    assert ages.p50 == pytest.approx(0.05, rel=0.024)
    hop.passed(200.0, 199.0)  # ahead of its time
    assert hop.ages(199.0).count == 100_000
    assert len(pickle.dumps(hop)) < 40_000


def test_a_mean_leaves_out_what_is_no_number() -> None:
    mean = Mean()
    assert mean.mean is None
    for value in (1.0, float("nan"), 3.0):
        mean.add(value)
    assert (mean.mean, mean.last, mean.count) == (2.0, 3.0, 2)


def test_rms_counts_the_markers_whose_truth_is_there() -> None:
    truth = np.array([[0, 0, 0], [1, 1, 1], [np.nan] * 3], np.float32)
    pose = truth + np.array([[0.003, 0, 0], [0, 0.004, 0], [5, 5, 5]], np.float32)
    assert rms_mm(pose, truth) == pytest.approx(np.sqrt((9 + 16) / 2), rel=1e-4)
    assert np.isnan(rms_mm(pose, np.full_like(truth, np.nan)))
