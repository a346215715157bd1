import numpy as np
import pytest

from drivers.marker_set import MARKERS
from training.local_models import NormalEquations, affine, least_squares, ridge
from training.mirroring import mirrored
from training.moments import (
    COORDINATES,
    ONE,
    PACKED,
    columns_of,
    matrix,
    mean_and_covariance,
    mean_and_covariances,
    mirrored_moments,
    moments_of,
)


@pytest.fixture
def poses():
    return np.random.default_rng(0).normal(size=(200, 41, 3)).astype(np.float32)


def test_they_are_the_sums_of_products(poses):
    rows = affine(poses.reshape(-1, COORDINATES).astype(float))
    moments = moments_of(poses)
    assert moments.shape == (PACKED,)
    np.testing.assert_allclose(matrix(moments), rows.T @ rows, rtol=1e-12, atol=1e-9)
    assert matrix(moments)[ONE, ONE] == 200


def test_they_add_up(poses):
    both = moments_of(poses[:70]) + moments_of(poses[70:])
    np.testing.assert_allclose(both, moments_of(poses), atol=1e-9)


def test_the_mirror_images_moments_need_no_frames(poses):
    np.testing.assert_allclose(
        mirrored_moments(moments_of(poses)), moments_of(mirrored(poses)), atol=1e-9
    )
    stacked = np.array([moments_of(poses[:9]), moments_of(poses[9:])])
    np.testing.assert_allclose(
        mirrored_moments(stacked)[1], moments_of(mirrored(poses[9:])), atol=1e-9
    )


def test_mean_and_covariance_are_numpys(poses):
    rows = poses.reshape(-1, COORDINATES).astype(float)
    mean, upper = mean_and_covariances(np.array([moments_of(poses), moments_of(poses[:1])]))
    np.testing.assert_allclose(mean[0], rows.mean(axis=0), atol=1e-12)
    expected = np.cov(rows, rowvar=False)
    np.testing.assert_allclose(upper[0], expected[np.triu_indices(COORDINATES)], atol=1e-12)
    np.testing.assert_allclose(upper[1], 0.0, atol=1e-12)  # a single frame
    columns = columns_of(("RTOE", "C7"))
    mean_of_two, covariance = mean_and_covariance(matrix(moments_of(poses)), columns)
    np.testing.assert_allclose(mean_of_two, rows.mean(axis=0)[columns])
    np.testing.assert_allclose(covariance, expected[np.ix_(columns, columns)], atol=1e-12)


def test_maps_from_moments_are_least_squares_over_the_frames(poses):
    labels = ("LFHD", "RTOE"), ("RELB", "LKNE")
    x, z = (poses[:, [MARKERS.index(label) for label in some]] for some in labels)
    x, z = (part.reshape(len(part), -1).astype(float) for part in (x, z))
    whole = matrix(moments_of(poses))
    inputs, outputs = map(columns_of, labels)
    plain = least_squares(NormalEquations.between(whole, inputs, outputs))
    np.testing.assert_allclose(plain, np.linalg.lstsq(x, z)[0].T, atol=1e-9)
    with_constant = NormalEquations.between(whole, np.append(inputs, ONE), outputs)
    assert with_constant.weight == 200
    np.testing.assert_allclose(
        ridge(with_constant, 0.0), np.linalg.lstsq(affine(x), z)[0].T, atol=1e-9
    )
