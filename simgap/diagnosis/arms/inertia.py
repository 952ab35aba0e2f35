"""Inertial parameters: the combinations that a tree's motion shows at all, and those that bodies can have.

Some columns of the regressor are combinations of others whatever the motion: only sums of such parameters act. They are
found on the regressor at random motions, each column against those before it (numerical QR: Gautier (1991), J. Robotic
Systems 8(4)), and named, such as `upper.mx + 0.61 fore.m`.

Base parameters that fit best need not belong to any bodies. A body's pseudo-inertia [[S, h], [h', m]], S = tr(I)/2 - I,
is positive semidefinite, and that is all that a density asks for; so the nearest parameters of possible bodies are a
semidefinite program. Sources: Sousa, Cortesao (2014), Int. J. Robotics Research 33(6); Wensing, Kim, Slotine (2018),
IEEE Robotics and Automation Letters 3(1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.model.tree import UNITS, Tree, regressor

_OWN = 1e-8  # columns of the regressor at random motions with a smaller share of their own are combinations of others
_DECLARED = 1e-3  # weight, in squared standard errors, of the declared numbers where the motion shows none
_DRAWS = 200


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The combinations.

    Attributes:
        kept: (b,) columns of the regressor that stand for the combinations: `Y pi = Y[:, kept] K pi`.
        combine: K, (b, 10 n).
        names, units: of each combination; links: the link that it is listed at.
    """

    kept: Ints
    combine: Floats
    names: tuple[str, ...]
    units: tuple[str, ...]
    links: tuple[str, ...]


def base_parameters(tree: Tree) -> BaseParameters:
    """The base parameters of a tree, from the base to the tip."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-np.pi, np.pi, (_DRAWS, tree.size))
    v, a = rng.normal(size=(2, _DRAWS, tree.size))
    columns = regressor(tree, q, v, a).reshape(_DRAWS * tree.size, -1)
    kept = independent(columns)
    combine = np.asarray(np.linalg.lstsq(columns[:, kept], columns, rcond=None)[0], dtype=np.float64)
    combine[np.abs(combine) < 1e-9] = 0.0
    names = tuple(_named(row, tree.names, int(k)) for row, k in zip(combine, kept, strict=True))
    return BaseParameters(
        kept, combine, names, tuple(UNITS[k % 10] for k in kept), tuple(tree.links[k // 10] for k in kept)
    )


def independent(columns: Floats) -> Ints:
    """Columns, from the left, that are no combination of those before them."""
    size = np.linalg.norm(columns, axis=0)
    acts = np.flatnonzero(size >= _OWN * max(1.0, float(np.abs(columns).max())))
    own = np.abs(np.diag(np.linalg.qr(columns[:, acts] / size[acts], mode="r")))  # a combination leaves rounding
    return acts[own > np.sqrt(_OWN)]


def _named(row: Floats, names: tuple[str, ...], first: int) -> str:
    """The combination in words, its leading parameter first."""
    text = names[first]
    for k in np.flatnonzero(row):
        if k == first:
            continue
        size = "" if abs(abs(row[k]) - 1.0) < 1e-9 else f"{abs(row[k]):.4g} "
        text += f" {'+' if row[k] > 0 else '-'} {size}{names[k]}"
    return text


_LEAST = 1e-7  # kg m^2 and kg: what the smallest eigenvalue of a pseudo-inertia is kept above


@dataclass(frozen=True, eq=False)
class Consistent:
    """Parameters of possible bodies.

    Attributes:
        inertial: (n, 10).
        distance: from the base parameters that fit best, in standard errors (root of the Mahalanobis square over b).
    """

    inertial: Floats
    distance: float


def consistent(tree: Tree, base: BaseParameters, found: Floats, information: Floats) -> Consistent | None:
    """The nearest parameters of possible bodies; None if the solver does not settle.

    Args:
        found: (b,) base parameters that fit best.
        information: (b, b) inverse of their covariance.
    """
    import cvxpy as cp

    n = tree.size
    declared = tree.inertial
    mass, length = float(declared[:, 0].max()), float(np.linalg.norm(tree.place, axis=1).max())
    typical = mass * np.repeat([1.0, length, length**2], (1, 3, 6))
    scale = np.maximum(np.abs(declared), 0.05 * np.maximum(typical, 1e-9))
    root = np.linalg.cholesky(information + 1e-9 * np.diag(np.diag(information))).T
    p = cp.Variable((n, 10))
    misfit = root @ (base.combine @ cp.reshape(p, (10 * n,), order="C") - found)
    away = cp.multiply(p - declared, 1.0 / scale)
    limits = [_pseudo(p, k) >> _LEAST * np.eye(4) for k in range(n)]
    problem = cp.Problem(cp.Minimize(cp.sum_squares(misfit) + _DECLARED * cp.sum_squares(away)), limits)
    try:
        problem.solve(solver=cp.CLARABEL)
    except cp.SolverError:
        return None
    if p.value is None or problem.status not in ("optimal", "optimal_inaccurate"):
        return None
    return Consistent(np.array(p.value), float(np.linalg.norm(misfit.value) / np.sqrt(len(found))))


def _pseudo(p: Any, k: int) -> Any:
    """The pseudo-inertia of body k as an expression."""
    import cvxpy as cp

    m, hx, hy, hz, xx, xy, xz, yy, yz, zz = (p[k, i] for i in range(10))
    half = 0.5 * (xx + yy + zz)
    return cp.bmat([[half - xx, -xy, -xz, hx], [-xy, half - yy, -yz, hy], [-xz, -yz, half - zz, hz], [hx, hy, hz, m]])
