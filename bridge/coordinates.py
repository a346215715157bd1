"""From our world (metres, right-handed, Z up) to the engines'."""

from __future__ import annotations

from drivers.frame import Floats


def to_unity(xyz: Floats) -> Floats:
    """Unity's world: metres, left-handed, Y up.

    x stays, our z is its y, our y its z: exchanging two axes is the mirror that turns a
    right-handed frame into a left-handed one, so a left hand stays a left hand.
    """
    return xyz[..., [0, 2, 1]]
