"""A tree of rigid bodies on hinges and slides, as numbers, and its inverse dynamics, linear in the inertial parameters.

Newton-Euler for all samples at once, in NumPy, on numbers or on expressions: for each body the wrench about its joint
is a 6 x 10 matrix times its inertial parameters, which is handed down to the base and projected on every axis on the
way. Source: Atkeson, An, Hollerbach (1986), Int. J. Robotics Research 5(3), sec. 2; Featherstone (2008), Rigid Body
Dynamics Algorithms, ch. 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats, Ints

PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""The standard inertial parameters of a link: mass, first moment, inertia about the origin of its frame, its joint.

Equations of motion are linear in them (Atkeson, An, Hollerbach (1986), Int. J. Robotics Research 5(3))."""
UNITS = ("kg", *["kg*m"] * 3, *["kg*m^2"] * 6)
Turning = tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]
"""Sine and cosine of arrays."""


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
    shift, old = _skew(place), _skew(about)
    grown = turn @ inertia @ turn.T - shift @ old - old @ shift - m * shift @ shift
    return np.concatenate([[m], h, grown[np.triu_indices(3)]])


def symmetric(six: Floats) -> Floats:
    """(..., 6) xx, xy, xz, yy, yz, zz -> (..., 3, 3)."""
    return np.asarray(six)[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*np.shape(six)[:-1], 3, 3)


def regressor(tree: Tree, q: Floats, v: Floats, a: Floats, turning: Turning = (np.sin, np.cos)) -> Floats:
    """Y with `forces = Y @ tree.inertial.ravel()`: positions, velocities, accelerations (N, n) -> (N, n, 10 n).

    Args:
        turning: sine and cosine of an array; other than NumPy's where entries are expressions.
    """
    turns, places = _frames(tree, q, turning)
    count, n = q.shape
    spin, pull, lift = _motion(tree, turns, places, v, a)
    out = np.zeros((count, n, n, 10), dtype=q.dtype)
    for i in range(n):
        force, moment = _wrench(spin[i], pull[i], lift[i])
        j = i
        while j >= 0:
            out[:, j, i] = np.einsum("k,nkp->np", tree.axis[j], force if tree.slides[j] else moment)
            force, moment = turns[j] @ force, turns[j] @ moment
            moment += np.cross(places[j][:, None], force.transpose(0, 2, 1)).transpose(0, 2, 1)
            j = int(tree.parent[j])
    return out.reshape(count, n, 10 * n)


def forces(tree: Tree, q: Floats, v: Floats, a: Floats, turning: Turning = (np.sin, np.cos)) -> Floats:
    """Inverse dynamics: the generalised forces of the motion, (N, n) each -> (N, n)."""
    return regressor(tree, q, v, a, turning) @ tree.inertial.ravel()


def _frames(tree: Tree, q: Floats, turning: Turning) -> tuple[list[Floats], list[Floats]]:
    """Rotation (N, 3, 3) of each body's frame into its parent's and place (N, 3) of its origin there."""
    turns, places = [], []
    for j in range(tree.size):
        e = tree.axis[j]
        if tree.slides[j]:
            turns.append(np.broadcast_to(tree.turn[j], (len(q), 3, 3)))
            places.append(tree.place[j] + q[:, j, None] * (tree.turn[j] @ e))
            continue
        s, c = (function(q[:, j])[:, None, None] for function in turning)
        skew = _skew(e)
        turns.append(tree.turn[j] @ (np.eye(3, dtype=np.int64) + s * skew + (1 - c) * (skew @ skew)))  # Rodrigues
        places.append(np.broadcast_to(tree.place[j], (len(q), 3)))
    return turns, places


def _motion(
    tree: Tree, turns: list[Floats], places: list[Floats], v: Floats, a: Floats
) -> tuple[list[Floats], list[Floats], list[Floats]]:
    """For each body, in its frame: angular velocity and acceleration, acceleration of its origin less gravity."""
    still = np.zeros((len(v), 3), dtype=v.dtype)
    spin: list[Floats] = []
    pull: list[Floats] = []
    lift: list[Floats] = []
    for j in range(tree.size):
        p = int(tree.parent[j])
        w, dw, up = (spin[p], pull[p], lift[p]) if p >= 0 else (still, still, still - tree.gravity)
        r, back = places[j], turns[j].transpose(0, 2, 1)
        up = up + np.cross(dw, r) + np.cross(w, np.cross(w, r))
        w, dw, up = ((back @ x[:, :, None])[:, :, 0] for x in (w, dw, up))
        rate, push = v[:, j, None] * tree.axis[j], a[:, j, None] * tree.axis[j]
        if tree.slides[j]:
            up = up + push + 2 * np.cross(w, rate)
        else:
            dw = dw + push + np.cross(w, rate)
            w = w + rate
        spin.append(w)
        pull.append(dw)
        lift.append(up)
    return spin, pull, lift


def _wrench(w: Floats, dw: Floats, up: Floats) -> tuple[Floats, Floats]:
    """Force and moment about its origin that a body's motion takes, (N, 3, 10) times its inertial parameters each."""
    force, moment = (np.zeros((len(w), 3, 10), dtype=w.dtype) for _ in range(2))
    ww = _skew(w)
    force[:, :, 0] = up
    force[:, :, 1:4] = _skew(dw) + ww @ ww
    moment[:, :, 1:4] = -_skew(up)
    moment[:, :, 4:] = _spread(dw) + ww @ _spread(w)
    return force, moment


def _skew(x: Floats) -> Floats:
    """Matrices (..., 3, 3) of the cross products with vectors (..., 3)."""
    out = np.zeros((*x.shape, 3), dtype=x.dtype)
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -x[..., 2], x[..., 1], -x[..., 0]
    return out - np.swapaxes(out, -1, -2)


def _spread(x: Floats) -> Floats:
    """I x as a matrix (N, 3, 6) times xx, xy, xz, yy, yz, zz of I."""
    out = np.zeros((len(x), 3, 6), dtype=x.dtype)
    for k, (i, j) in enumerate(zip(*np.triu_indices(3), strict=True)):
        out[:, i, k] += x[:, j]
        if i != j:
            out[:, j, k] += x[:, i]
    return out
