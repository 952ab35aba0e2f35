"""A tree of rigid bodies on hinges and slides, as numbers: what numeric dynamics are computed from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats, Ints

PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""The standard inertial parameters of a link: mass, first moment, inertia about the origin of its frame, its joint.

Equations of motion are linear in them (Atkeson, An, Hollerbach (1986), Int. J. Robotics Research 5(3))."""
UNITS = ("kg", *["kg*m"] * 3, *["kg*m^2"] * 6)


@dataclass(frozen=True, eq=False)
class Tree:
    """Bodies and joints, each joint after the one that carries it; the frame of a body is that of its joint.

    Attributes:
        joints, links: name of each joint and of the body that it moves, n each; what is welded to a body is part of it.
        parent: (n,) the joint whose body the joint hangs on; -1 for the base.
        turn, place: (n, 3, 3), (n, 3) the joint's frame at position 0 in that of its parent: rotation, and origin in m.
        axis: (n, 3) of unit length, in the joint's frame; slides: (n,) whether it is a prismatic joint.
        inertial: (n, 10) `PARAMETERS` of each body.
        damping: (n,) viscous damping that the file declares.
        gravity: (3,) m/s^2 in the frame of the base.
    """

    joints: tuple[str, ...]
    links: tuple[str, ...]
    parent: Ints
    turn: Floats
    place: Floats
    axis: Floats
    slides: Bools
    inertial: Floats
    damping: Floats
    gravity: Floats

    @property
    def size(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def names(self) -> tuple[str, ...]:
        """`link.parameter` of every inertial parameter, in the order of `inertial`, 10 n."""
        return tuple(f"{link}.{p}" for link in self.links for p in PARAMETERS)


def moved(inertial: Floats, turn: Floats, place: Floats) -> Floats:
    """Inertial parameters (10,) of a body in another frame, in which the body's frame has this rotation and origin."""
    m, first, inertia = inertial[0], inertial[1:4], symmetric(inertial[4:])
    about = turn @ first
    h = about + m * place
    # Steiner about both origins: the first moment couples the shift
    cross, shift, old = _cross(place), _cross(place), _cross(about)
    grown = turn @ inertia @ turn.T - cross @ old - old @ shift - m * cross @ cross
    return np.concatenate([[m], h, grown[np.triu_indices(3)]])


def symmetric(six: Floats) -> Floats:
    """(..., 6) xx, xy, xz, yy, yz, zz -> (..., 3, 3)."""
    return np.asarray(six)[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*np.shape(six)[:-1], 3, 3)


def _cross(p: Floats) -> Floats:
    return np.array([[0.0, -p[2], p[1]], [p[2], 0.0, -p[0]], [-p[1], p[0], 0.0]])
