"""The forces on the joints that a motion of a tree asks for, linear in the inertial parameters.

Newton-Euler for all samples at once, in NumPy: for each body the wrench about its joint is a 6 x 10 matrix times its
inertial parameters, which is handed down to the base and projected on every axis on the way. Source: Atkeson, An,
Hollerbach (1986), Int. J. Robotics Research 5(3), sec. 2; Featherstone (2008), Rigid Body Dynamics Algorithms, ch. 5.
"""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.model.tree import Tree


def regressor(tree: Tree, q: Floats, v: Floats, a: Floats) -> Floats:
    """Y with `forces = Y @ tree.inertial.ravel()`: positions, velocities, accelerations (N, n) -> (N, n, 10 n)."""
    turns, places = _frames(tree, q)
    count, n = q.shape
    spin, pull, lift = _motion(tree, turns, places, v, a)
    out = np.zeros((count, n, n, 10))
    for i in range(n):
        force, moment = _wrench(spin[i], pull[i], lift[i])
        j = i
        while j >= 0:
            out[:, j, i] = np.einsum("k,nkp->np", tree.axis[j], force if tree.slides[j] else moment)
            force, moment = turns[j] @ force, turns[j] @ moment
            moment += np.cross(places[j][:, None], force.transpose(0, 2, 1)).transpose(0, 2, 1)
            j = int(tree.parent[j])
    return out.reshape(count, n, 10 * n)


def forces(tree: Tree, q: Floats, v: Floats, a: Floats) -> Floats:
    """Inverse dynamics: the generalised forces of the motion, (N, n) each -> (N, n)."""
    return regressor(tree, q, v, a) @ tree.inertial.ravel()


def _frames(tree: Tree, q: Floats) -> tuple[list[Floats], list[Floats]]:
    """Rotation (N, 3, 3) of each body's frame into its parent's and place (N, 3) of its origin there."""
    turns, places = [], []
    for j in range(tree.size):
        e = tree.axis[j]
        if tree.slides[j]:
            turns.append(np.broadcast_to(tree.turn[j], (len(q), 3, 3)))
            places.append(tree.place[j] + q[:, j, None] * (tree.turn[j] @ e))
            continue
        skew = np.array([[0.0, -e[2], e[1]], [e[2], 0.0, -e[0]], [-e[1], e[0], 0.0]])
        s, c = np.sin(q[:, j])[:, None, None], np.cos(q[:, j])[:, None, None]
        turns.append(tree.turn[j] @ (np.eye(3) + s * skew + (1.0 - c) * (skew @ skew)))  # Rodrigues
        places.append(np.broadcast_to(tree.place[j], (len(q), 3)))
    return turns, places


def _motion(
    tree: Tree, turns: list[Floats], places: list[Floats], v: Floats, a: Floats
) -> tuple[list[Floats], list[Floats], list[Floats]]:
    """Of each body, in its frame: angular velocity and acceleration, acceleration of its origin less gravity."""
    still = np.zeros((len(v), 3))
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
            up = up + push + 2.0 * np.cross(w, rate)
        else:
            dw = dw + push + np.cross(w, rate)
            w = w + rate
        spin.append(w)
        pull.append(dw)
        lift.append(up)
    return spin, pull, lift


def _wrench(w: Floats, dw: Floats, up: Floats) -> tuple[Floats, Floats]:
    """Force and moment about its origin that a body's motion takes, (N, 3, 10) times its inertial parameters each."""
    force, moment = np.zeros((len(w), 3, 10)), np.zeros((len(w), 3, 10))
    ww = _skew(w)
    force[:, :, 0] = up
    force[:, :, 1:4] = _skew(dw) + ww @ ww
    moment[:, :, 1:4] = -_skew(up)
    moment[:, :, 4:] = _spread(dw) + ww @ _spread(w)
    return force, moment


def _skew(x: Floats) -> Floats:
    out = np.zeros((len(x), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -x[:, 2], x[:, 1], -x[:, 0]
    return out - out.transpose(0, 2, 1)


def _spread(x: Floats) -> Floats:
    """I x as a matrix (N, 3, 6) times xx, xy, xz, yy, yz, zz of I."""
    out = np.zeros((len(x), 3, 6))
    for k, (i, j) in enumerate(zip(*np.triu_indices(3), strict=True)):
        out[:, i, k] += x[:, j]
        if i != j:
            out[:, j, k] += x[:, i]
    return out
