"""Drive gains, from a payload of known mass.

Gains and masses that are all larger by one factor move an arm alike; a known mass sets the scale, and what several
joints feel ties their gains together. Source: Gautier, Briot (2014), J. Dynamic Systems, Measurement, and Control
136(5). There currents are regressors and their noise biases the gains; here they are what is predicted:

    u_j = g_j (d_j + X_s theta_s) + X_f theta_f,    g_j = declared gain over the true one,

d the torque of the declared bodies and of the known mass, X_s columns that joints share (inertial parameters, the rest
of the payload), X_f those of the joint alone (friction, in units of the declared gain). Gauss-Newton from g = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.arms.fit import forward, solve, standard_errors
from simgap.diagnosis.arms.problem import INERTIAL, PAYLOAD, TERMS, Key, Part
from simgap.diagnosis.thresholds import BIC_GAIN, MOST, SURE

GAIN = "input_gain"
SAID = (
    "The gains are relative to the declared masses: if all of these were off by one factor, other gains would fit; a "
    "payload of known mass decides (measured.payloads, mass)."
)


def lone_gains(
    keys: Sequence[Key], inputs: Sequence[str], fit: Part, judge: Part, weights: Floats, together: Floats, most: int,
    bic: float,
) -> Floats | None:  # fmt: skip
    """(n,) g of each drive, declared over true, 1 where it is as declared; None if no gain explains *choose* better.

    Args:
        bic: of what was chosen without gains.
    """
    n, size = len(inputs), len(keys)
    wider = [*keys, *(Key(GAIN, name, "ratio") for name in inputs)]
    fitted, judged = (replace(p, x=np.concatenate([p.x, _for_gains(p.torque - p.y)], axis=2)) for p in (fit, judge))
    first = sum(key.effect == INERTIAL for key in keys)
    given = tuple(k for k, key in enumerate(keys) if key.effect == PAYLOAD)
    own = [(*range(first + j * len(TERMS), first + (j + 1) * len(TERMS)), size + j) for j in range(n)]
    gram, right = fitted.grams(weights)
    chosen = forward(wider, gram, right, judged, together, given, own, most)
    g = 1.0 + solve(gram, right, chosen.active)[size:]
    off = int(np.sum(g != 1.0))
    if chosen.bic >= bic - BIC_GAIN or not 0 < off <= MOST * n or not np.all(g > 0.0):
        return None
    return np.asarray(g)


def _for_gains(bodies: Floats) -> Floats:
    """A column for each drive, (R, n, n): the torque that bodies ask for there, (R, n)."""
    return np.asarray(bodies[:, :, None] * np.eye(bodies.shape[1]))


_ROUNDS = 30
_SETTLED = 1e-6


@dataclass(frozen=True, eq=False)
class Gains:
    """(n,) g and its standard errors; (p,) standard errors of the columns beside it."""

    g: Floats
    errors: Floats
    of_columns: Floats


def scaled(part: Part, g: Floats, shared: Sequence[int]) -> Part:
    """The same rows with these gains: what is left of them, and the columns that joints share, as the currents say."""
    x = part.x.copy()
    x[:, :, shared] *= g[None, :, None]
    return replace(part, x=x, y=part.torque - g * (part.torque - part.y))


def gains(
    part: Part, active: Sequence[int], shared: Sequence[int], theta: Floats, weights: Floats, correlated: Floats,
    among: Sequence[int],
) -> Gains | None:  # fmt: skip
    """Gains beside the active columns; those whose 95 % interval holds 1 are as declared. None if it does not settle.

    Args:
        shared: active columns that several joints feel.
        theta: (p,) where to begin, gains 1.
        among: joints whose gains may differ.
    """
    open_ = list(among)
    while open_:
        found = _settled(part, active, shared, theta, weights, correlated, open_)
        if found is None:
            return None
        doubtful = {j: abs(found.g[j] - 1.0) / max(found.errors[j], 1e-300) for j in open_}
        least = min(doubtful, key=lambda j: doubtful[j])
        if doubtful[least] > SURE:
            return found
        open_.remove(least)
    return None


def open_gains(part: Part, shared: Sequence[int], weights: Floats, correlated: Floats) -> Floats:
    """(n,) gains beside every column at once, to begin from; ones if they do not settle."""
    size, n = part.x.shape[2], part.y.shape[1]
    found = _settled(part, range(size), shared, np.zeros(size), weights, correlated, range(n))
    return np.ones(n) if found is None else found.g


def _settled(
    part: Part, active: Sequence[int], shared: Sequence[int], theta: Floats, weights: Floats, correlated: Floats,
    open_: Sequence[int],
) -> Gains | None:  # fmt: skip
    """Gauss-Newton over the open gains and the active columns."""
    n, size = part.y.shape[1], len(theta)
    free = [*open_, *(n + k for k in active)]
    g, at = np.ones(n), theta.copy()
    for _ in range(_ROUNDS):
        rows = scaled(part, g, shared)  # what is left of them, with a column for each gain in front of the others
        columns = _for_gains(part.torque - part.y + part.x[:, :, shared] @ at[shared])
        rows = replace(rows, x=np.concatenate([columns, rows.x], axis=2), y=rows.y - rows.x @ at)
        gram, right = rows.grams(weights)
        step = solve(gram, right, free)
        g, at = g + step[:n], at + step[n:]
        if not np.all(g > 0.0):
            return None
        if np.abs(step[:n]).max() < _SETTLED:
            left = replace(rows, y=rows.y - rows.x @ step)
            errors = standard_errors(left, np.zeros(n + size), free, weights, correlated)
            return Gains(g, errors[:n], errors[n:])
    return None
