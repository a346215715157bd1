"""Honest sigma: how far off a network's own is on people left out, marker by marker."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

EDGES = np.linspace(0.0, 10.0, 401)  # of error over sigma; what is beyond is counted in the last
WITHIN = 0.6827, 0.9545  # share of a Gaussian's errors within one and two sigma
FEWEST = 300  # coordinate errors that tell anything


def counted(error: npt.NDArray[np.floating], sigma: npt.NDArray[np.floating]) -> Counts:
    """(M, B): per marker its coordinate errors (N, M, 3) over sigma (N, M), in the bins of EDGES.

    NaN is left out. A sigma of zero, as a mixture has before it is scored, is always too small.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.minimum(np.abs(error) / sigma[..., None], EDGES[-1])
    rows = ratio.transpose(1, 0, 2).reshape(error.shape[1], -1)
    return np.array([np.histogram(row[~np.isnan(row)], EDGES)[0] for row in rows], np.int64)


def sigma_factors(counts: Sequence[Counts]) -> Array:
    """(M,): what sigma is to be multiplied by, so that errors are within one and two of it as often
    as they should be; between the two where both cannot be had. 1 where too little is known.
    """
    total = np.sum(counts, axis=0)
    factors = np.ones(len(total))
    for marker, row in enumerate(total):
        if row.sum() >= FEWEST:
            share = np.append(0.0, row.cumsum() / row.sum())
            reached = [np.interp(within, share, EDGES) for within in WITHIN]
            factors[marker] = np.sqrt(reached[0] * reached[1] / 2.0)
    return factors
