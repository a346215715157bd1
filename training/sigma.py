"""Honest sigma: how far off a network's own is on people left out, marker by marker."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

EDGES = np.linspace(0.0, 10.0, 401)  # of error over sigma; what is beyond is counted in the last
WITHIN = 0.6827  # share of a Gaussian's errors within one sigma
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
    """(M,): what sigma is to be multiplied by, so that errors are within it as often as they should
    be. 1 where too little is known.

    counts: of each capture, see `counted`.
    """
    factors = np.ones(len(counts[0]))
    for marker in range(len(factors)):
        rows = [capture[marker] for capture in counts if capture[marker].any()]
        if sum(row.sum() for row in rows) >= FEWEST:
            # Captures count alike, as in all scores: one long hard one would outweigh the rest.
            mean = np.mean([row.cumsum() / row.sum() for row in rows], axis=0)
            factors[marker] = np.interp(WITHIN, np.append(0.0, mean), EDGES)
    return factors
