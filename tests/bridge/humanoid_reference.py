"""The humanoid in plain numpy: the same geometry as the compiled one, written another way.

Many vectors (..., 3) at once, rotations as matrices (..., 3, 3) that turn columns; sides and limbs
in the order left, right, left arm, right arm, left leg, right leg.
"""

from __future__ import annotations

import numpy as np

from bridge.humanoid.proportions import Measuring, Proportions
from bridge.humanoid.rotations import cross, dot, unit
from bridge.humanoid.skeleton import BONES, PARENTS, ROW
from bridge.pose import Pose

Array = np.ndarray

UP = np.array([0.0, 0.0, 1.0])
OUT = np.array([[-1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
ALONG = np.array([[-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, -1]], float)
BENDS = np.array([[0, -1, 0], [0, -1, 0], [0, 1, 0], [0, 1, 0]], float)
MARKER_SIDE = np.array([[1], [-1], [-1], [1]], float)
HALF_WIDTH = np.array([[0.042], [0.042], [0.056], [0.056]])
FARTHEST = np.array([[-0.5], [-0.5], [0.1], [0.1]])
NECK = np.array([0.0, 0.2, 1.0]) / np.hypot(0.2, 1.0)
TRUNK_OF_LIMBS = np.array([1, 1, 0, 0])  # of pelvis, chest, head


def rows(*names: str) -> Array:
    """Of bones."""
    return np.array([ROW[name] for name in names])


CLAVICLES = rows("LeftShoulder", "RightShoulder")
UPPER = rows("LeftUpperArm", "RightUpperArm", "LeftUpperLeg", "RightUpperLeg")
LOWER = rows("LeftLowerArm", "RightLowerArm", "LeftLowerLeg", "RightLowerLeg")
ENDS = rows("LeftHand", "RightHand", "LeftFoot", "RightFoot")


class Reference:
    """Joints (B, 3), rotations and local (B, 4) of each pose in turn, and the proportions."""

    def __init__(self, labels: tuple[str, ...]) -> None:
        self.measuring = Measuring()
        self._labels = labels
        self._last: tuple[float, Array] | None = None

    def solve(self, pose: Pose) -> tuple[Array, Array, Array]:
        """Of a pose that is complete and not lost."""
        build = self.measuring.mean
        m = {label: pose.xyz[i].astype(float) for i, label in enumerate(self._labels)}
        seen = landmarks(m)
        outside = OUT[:, :1] * unit(cross(seen["feet"], UP))
        if self._last is not None:
            before, last = self._last
            outside = last + (1.0 - np.exp(-max(pose.t - before, 0.0) / 0.1)) * (outside - last)
        self._last = pose.t, outside
        axes = seen["axes"] @ lowered(build.level)
        skull = seen["head"] + axes[2] @ [0.0, -0.01, -0.09]
        ends = np.concatenate([seen["wrists"], seen["ankles"]])
        roots = np.concatenate([seen["shoulders"], seen["hips"]])
        bends, middles = bending(axes[TRUNK_OF_LIMBS], roots, seen["middles"], ends)
        ends[2:] -= 0.045 * outside
        if self.measuring.due():
            self.measuring.add(shown(seen, axes, skull, roots, middles, ends))
        joints, turns = placed(seen, axes, skull, ends, bends, build)
        local = turns.copy()
        local[1:] = np.swapaxes(turns[PARENTS[1:]], 1, 2) @ turns[1:]
        return joints, quaternions(turns), quaternions(local)


def landmarks(m: dict[str, Array]) -> dict[str, Array]:
    """Joints and directions by the markers."""

    def sides(function) -> Array:
        return np.array([function(*side) for side in "LR"])

    front, back = (m["LFWT"] + m["RFWT"]) / 2, (m["LBWT"] + m["RBWT"]) / 2
    up = m["C7"] + m["CLAV"] - m["T10"] - m["STRN"]
    chest_forward = m["CLAV"] + m["STRN"] - m["C7"] - m["T10"]
    shoulders = m["RSHO"] - m["LSHO"]
    right = np.array(
        [
            m["RFWT"] + m["RBWT"] - m["LFWT"] - m["LBWT"],
            unit(cross(chest_forward, up)) + 0.5 * unit(shoulders),
            m["RFHD"] + m["RBHD"] - m["LFHD"] - m["LBHD"],
        ]
    )
    head_forward = m["LFHD"] + m["RFHD"] - m["LBHD"] - m["RBHD"]
    x = unit(right)
    normal = unit(cross(x, np.array([front - back, up, head_forward])))
    third = cross(normal, x)
    axes = np.array([x, third, normal])
    axes[1:, 1] = -normal[1], third[1]
    axes = axes.transpose(1, 2, 0)
    width, depth = np.linalg.norm(m["RFWT"] - m["LFWT"]), np.linalg.norm(front - back)
    hip = np.array([0.33, -0.24, -0.30]) * [width, depth, width] + [0.0073, -0.0099, -0.0109]
    clavicles = np.array([[-0.025, -0.025, 0], [0.025, -0.025, 0]])
    wrists = sides(lambda s: (m[s + "WRA"] + m[s + "WRB"]) / 2)
    drop = 0.17 * np.linalg.norm(shoulders) * axes[1, :, 2]
    return {
        "axes": axes,
        "hips": front + (OUT * hip) @ axes[0].T,
        "waist": 0.4 * front + 0.6 * back,
        "chest": (2 * m["T10"] + m["STRN"]) / 3,
        "neck": (2 * m["C7"] + m["CLAV"]) / 3,
        "head": (m["LFHD"] + m["RFHD"] + m["LBHD"] + m["RBHD"]) / 4,
        "clavicles": m["CLAV"] + clavicles @ axes[1].T,
        "shoulders": sides(lambda s: m[s + "SHO"]) - drop,
        "middles": np.array([m["LELB"], m["RELB"], m["LKNE"], m["RKNE"]]),
        "wrists": wrists,
        "thumbs": sides(lambda s: m[s + "WRA"] - m[s + "WRB"]),
        "hands": sides(lambda s: m[s + "FIN"]) - wrists,
        "ankles": sides(lambda s: m[s + "ANK"]),
        "feet": sides(lambda s: m[s + "TOE"] - m[s + "HEE"]),
        "across": sides(lambda s: m[s + "MT5"] - m[s + "TOE"]),
    }


def shown(
    seen: dict[str, Array], axes: Array, skull: Array, roots: Array, middles: Array, ends: Array
) -> Array:
    """`Proportions.values` as a pose shows them."""
    pelvis, chest, _ = axes
    hips = seen["hips"]
    bones = np.linalg.norm([middles - roots, ends - middles], axis=2)  # upper, lower
    sagittal = np.array([0.0, 1.0, 1.0])
    level = seen["axes"][:, 2, 1] * [1.0, np.nan, 1.0]
    if min(seen["axes"][0, 2, 2], seen["axes"][1, 2, 2]) < 0.92:
        level[:] = np.nan
    return np.concatenate(
        [
            bones.reshape(2, 2, 2).mean(axis=2).T.ravel(),
            [np.linalg.norm(hips[1] - hips[0]) / 2, 0, 0],
            ((seen["waist"] - hips.mean(axis=0)) @ pelvis) * sagittal,
            [np.linalg.norm(seen["chest"] - seen["waist"])],
            ((seen["neck"] - seen["chest"]) @ chest) * sagittal,
            [np.linalg.norm(skull - seen["neck"])],
            (OUT * ((seen["clavicles"] - seen["chest"]) @ chest)).mean(axis=0),
            (OUT * ((seen["shoulders"] - seen["clavicles"]) @ chest)).mean(axis=0),
            level,
        ]
    )


def bending(trunks: Array, roots: Array, markers: Array, ends: Array) -> tuple[Array, Array]:
    """Which way elbows and knees go off their limbs' lines (4, 3), and where they are (4, 3)."""
    toward = unit(ends - roots)
    off = markers - roots
    off = off - dot(off, toward) * toward
    far = np.linalg.norm(off, axis=1, keepdims=True)
    side = off / np.maximum(far, 1e-9)
    cosine = np.minimum(HALF_WIDTH, far) / np.maximum(far, 1e-9)
    told = np.sqrt(1.0 - cosine**2) * side - MARKER_SIDE * cosine * cross(toward, side)
    along, natural = ((trunks @ which[:, :, None])[..., 0] for which in (ALONG, BENDS))
    natural = carried(natural, along, toward)
    bends = unit(far * told + 0.04 * natural)
    bends = unit(bends + np.maximum(FARTHEST - dot(bends, natural), 0.0) * natural)
    return bends, markers - HALF_WIDTH * MARKER_SIDE * cross(toward, bends)


def placed(
    seen: dict[str, Array], axes: Array, skull: Array, ends: Array, bends: Array, build: Proportions
) -> tuple[Array, Array]:
    """Joints (B, 3) and rotations (B, 3, 3) of bones of constant length."""
    joints, turns = np.empty((len(BONES), 3)), np.empty((len(BONES), 3, 3))
    pelvis, chest, head = axes
    lengths = np.repeat(build.limbs, 2, axis=0)
    legs = (OUT * build.hip) @ pelvis.T
    hips = seen["hips"].mean(axis=0)
    for _ in range(2):
        way = ends[2:] - hips - legs
        distance = np.linalg.norm(way, axis=1)
        over = np.maximum(distance - 0.9995 * lengths[2].sum(), 0.0)
        hips = hips + (over / np.maximum(distance, 1e-9)) @ way / max(1, np.count_nonzero(over))
    joints[0], turns[0] = hips, pelvis
    joints[1] = hips + pelvis @ build.waist
    spine = unit(seen["chest"] - joints[1])
    joints[2], turns[2] = joints[1] + build.spine * spine, chest
    joints[3] = joints[2] + chest @ build.neck
    neck = unit(skull - joints[3])
    joints[4], turns[4] = joints[3] + build.skull * neck, head
    turns[1] = upright(spine, pelvis[:, 0] + chest[:, 0])
    turns[3] = upright(neck, chest[:, 0] + head[:, 0]) @ lowered(-NECK[1:2])[0]
    joints[CLAVICLES] = joints[2] + (OUT * build.collar) @ chest.T
    long = np.linalg.norm(build.clavicle)
    toward = unit(seen["shoulders"] - joints[CLAVICLES])
    usual = (OUT * build.clavicle) @ chest.T / long
    turns[CLAVICLES] = np.swapaxes(carried(chest.T, usual[:, None], toward[:, None]), 1, 2)
    joints[UPPER] = np.concatenate([joints[CLAVICLES] + long * toward, hips + legs])

    upper, lower = lengths[:, :1], lengths[:, 1:]
    way = ends - joints[UPPER]
    distance = np.linalg.norm(way, axis=1, keepdims=True)
    toward = way / np.maximum(distance, 1e-9)
    across = unit(bends - dot(bends, toward) * toward)
    distance = np.clip(distance, np.abs(upper - lower) + 1e-3, 0.9995 * (upper + lower))
    along = (upper**2 - lower**2 + distance**2) / (2 * distance)
    off = np.sqrt(np.maximum(upper**2 - along**2, 0.0))
    joints[LOWER] = joints[UPPER] + along * toward + off * across
    joints[ENDS] = joints[UPPER] + distance * toward
    hinge = cross(toward, across)
    turns[UPPER] = oriented((joints[LOWER] - joints[UPPER]) / upper, hinge)
    turns[LOWER] = oriented((joints[ENDS] - joints[LOWER]) / lower, hinge)

    forearms, hands = unit((joints[ENDS] - joints[LOWER])[:2]), unit(seen["hands"])
    turns[LOWER[:2]] = oriented(forearms, unit(cross(seen["thumbs"], forearms)))
    turns[ENDS[:2]] = oriented(hands, unit(cross(seen["thumbs"], hands)))
    forward = unit(seen["feet"])
    right = seen["across"] * OUT[:, :1]
    right = unit(right - dot(right, forward) * forward) + turns[LOWER[2:], :, 0]
    right = unit(right - dot(right, forward) * forward)
    feet = np.array([right, forward, cross(right, forward)]).transpose(1, 2, 0)
    turns[ENDS[2:]] = feet @ lowered(np.array([-0.06]))[0]
    return joints, turns


def oriented(along: Array, hinge: Array) -> Array:
    """Bones of the first n limbs that point along (n, 3) and bend about the hinge (n, 3)."""
    rest = np.stack([ALONG, BENDS, np.cross(ALONG, BENDS)], axis=1)
    return np.array([along, cross(hinge, along), hinge]).transpose(1, 2, 0) @ rest[: len(along)]


def upright(up: Array, right: Array) -> Array:
    """The rotation whose z is `up` and whose x is near `right`."""
    x = unit(right - dot(right, up) * up)
    return np.array([x, cross(up, x), up]).T


def lowered(rises: Array) -> Array:
    """(n, 3, 3): turns about x that bring what rises forward by these sines to the level."""
    turns = np.zeros((len(rises), 3, 3))
    turns[:, 0, 0] = 1.0
    turns[:, 1, 1] = turns[:, 2, 2] = np.sqrt(1.0 - rises**2)
    turns[:, 1, 2], turns[:, 2, 1] = rises, -rises
    return turns


def carried(vectors: Array, start: Array, end: Array) -> Array:
    """Vectors (..., 3) turned by the shortest turn from one unit vector to another."""
    both = start + end
    along = np.maximum(1.0 + dot(start, end), 1e-9)
    return vectors - dot(vectors, both) / along * both + 2 * dot(vectors, start) * end


def quaternions(turns: Array) -> Array:
    """Unit quaternions (..., 4) x, y, z, w of rotation matrices, w not negative.

    The matrix of all products of the components is linear in them (Bar-Itzhack 2000); of its
    columns, each the quaternion times a component, the longest.
    """
    m = np.moveaxis(turns, (-2, -1), (0, 1))
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = m
    products = np.array(
        [
            [1 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz],
        ]
    )
    products = np.moveaxis(products, (0, 1), (-2, -1))
    largest = np.linalg.norm(products, axis=-1).argmax(axis=-1)
    found = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return unit(np.where(found[..., 3:] < 0, -found, found))
