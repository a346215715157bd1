"""Arms and legs: two bones of constant length each, and the plane that they bend in.

Four limbs at once, in the order left arm, right arm, left leg, right leg; metres, world. The middle
joint is the elbow or the knee.
"""

from __future__ import annotations

import numpy as np

from bridge.humanoid.rotations import Array, carried, cross, dot, unit

# In the rest pose: where a limb points, where its middle joint goes when it bends, and on which
# side of that plane the middle joint's marker is, as the sign of their cross product.
ALONG = np.array([[-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, -1]], float)
BENDS = np.array([[0, -1, 0], [0, -1, 0], [0, 1, 0], [0, 1, 0]], float)
_OUTSIDE = np.array([[1], [-1], [-1], [1]], float)
_REST_AXES = np.stack([ALONG, BENDS, cross(ALONG, BENDS)], axis=1)  # rows

# m: from the middle joint to its marker.
_HALF_WIDTH = np.array([[0.042], [0.042], [0.056], [0.056]])
_STRAIGHT = 0.04  # m: a joint nearer its limb's line tells less of the plane than the trunk does
# Cosine of how far the plane may turn from what is natural: a knee never points backwards, while
# an upper arm turns about itself by more than a right angle.
_FARTHEST = np.array([[-0.5], [-0.5], [0.1], [0.1]])
REACH = 0.9995  # of its length: no limb is wholly straight, so there is always a plane


def bending(trunks: Array, roots: Array, markers: Array, ends: Array) -> tuple[Array, Array]:
    """By the markers on the outside of elbows and knees: which way these joints go off the line
    from root to end, unit vectors (4, 3) across it, and where they are (4, 3).

    trunks: (4, 3, 3), the rotations of what the limbs hang on.
    """
    toward = unit(ends - roots)
    off = markers - roots
    off = off - dot(off, toward) * toward
    far = np.sqrt(dot(off, off))
    side = off / np.maximum(far, 1e-9)
    # The marker is half a width from the joint at right angles to the plane, so the joint as far
    # off the line as is left of the marker's distance (the chord function of Davis et al. 1991).
    width = np.minimum(_HALF_WIDTH, far)
    cosine = width / np.maximum(far, 1e-9)
    told = np.sqrt(1.0 - cosine**2) * side - _OUTSIDE * cosine * cross(toward, side)
    # As if the limb had come here from the rest pose by the shortest turn.
    natural = carried(_turned(trunks, BENDS), _turned(trunks, ALONG), toward)
    bends = unit(far * told + _STRAIGHT * natural)
    bends = unit(bends + np.maximum(_FARTHEST - dot(bends, natural), 0.0) * natural)
    return bends, markers - _HALF_WIDTH * _OUTSIDE * cross(toward, bends)


def placed(
    roots: Array, ends: Array, bends: Array, lengths: Array
) -> tuple[Array, Array, Array, Array]:
    """Middle joints and ends (4, 3) of limbs whose bones are so long (4, 2), and the rotations
    (4, 3, 3) of their upper and lower bones.

    An end that cannot be reached is approached as far as the limb goes.
    """
    upper, lower = lengths[:, :1], lengths[:, 1:]
    way = ends - roots
    distance = np.sqrt(dot(way, way))
    toward = way / np.maximum(distance, 1e-9)
    across = unit(bends - dot(bends, toward) * toward)
    distance = np.clip(distance, np.abs(upper - lower) + 1e-3, REACH * (upper + lower))
    along = (upper**2 - lower**2 + distance**2) / (2 * distance)
    off = np.sqrt(np.maximum(upper**2 - along**2, 0.0))
    middles = roots + along * toward + off * across
    ends = roots + distance * toward
    hinge = cross(toward, across)
    return (
        middles,
        ends,
        oriented((middles - roots) / upper, hinge),
        oriented((ends - middles) / lower, hinge),
    )


def oriented(along: Array, hinge: Array) -> Array:
    """The rotations (n, 3, 3) of bones of the first n limbs that point along (n, 3) and bend about
    hinge (n, 3), at right angles; both unit vectors.
    """
    columns = np.array([along, cross(hinge, along), hinge])
    found: Array = columns.transpose(1, 2, 0) @ _REST_AXES[: len(along)]
    return found


def _turned(rotations: Array, vectors: Array) -> Array:
    found: Array = (rotations @ vectors[..., None])[..., 0]
    return found
