from dataclasses import replace

import numpy as np
import pytest

from bridge.model import Model
from drivers.marker_set import MARKERS
from training.nearest_neighbour import NearestNeighbour


@pytest.fixture(scope="module")
def info():
    return replace(Model("default").info)


@pytest.fixture(scope="module")
def poses():
    return np.random.default_rng(7).normal(size=(400, len(MARKERS), 3)).astype(np.float32)


def naive(poses, info, features):
    columns = [MARKERS.index(label) for label in info.features]
    unworn = [MARKERS.index(label) for label in info.unworn]
    found = []
    for frame in features:
        there = ~np.isnan(frame[:, 0])
        if there.any():
            distance = [((pose[columns][there] - frame[there]) ** 2).sum() for pose in poses]
            nearest = poses[int(np.argmin(distance))][unworn]
        found.append(nearest)
    return np.array(found)


def test_it_finds_what_a_plain_loop_finds(info, poses):
    random = np.random.default_rng(8)
    features = random.normal(size=(300, len(info.features), 3)).astype(np.float32)
    features[100:][random.random((200, len(info.features))) < 0.4] = np.nan
    found = NearestNeighbour(poses, info).find(features)
    np.testing.assert_array_equal(found, naive(poses, info, features))


def test_a_training_pose_finds_itself(info, poses):
    columns = [MARKERS.index(label) for label in info.features]
    unworn = [MARKERS.index(label) for label in info.unworn]
    found = NearestNeighbour(poses, info).find(poses[:, columns])
    np.testing.assert_array_equal(found, poses[:, unworn])


def test_a_frame_without_markers_keeps_the_last_pose(info, poses):
    columns = [MARKERS.index(label) for label in info.features]
    features = poses[:3, columns].copy()
    features[1] = np.nan
    found = NearestNeighbour(poses, info).find(features)
    np.testing.assert_array_equal(found[1], found[0])
    assert (found[2] != found[1]).any()
