"""How sampling time, cells and box have to be to each other, from the linear model around a posture.

A controller on cells knows a state to half a cell: with x = c + e, |e_j| <= r_j around the cell's centre c, and a
linear feedback u = -K c, the state moves to (A - B K) c + A e. What all cells on the way add is at most

    sum_k |(A - B K)^k| |A| r = M r

in each coordinate, so that a box of half-widths R is kept where R >= M r: with n_j = (M r)_j / r_j cells along axis j
(the set is that of Kolmanovsky, Gilbert (1998), Mathematical Problems in Engineering 4, sec. 4, bounded by a box). The
product of these is the size of the controller; it is a convex function of log r, and is minimised over r and K (a
linear-quadratic regulator, over its weights). It says nothing of how large the box may be: everything scales together,
up to what the inputs allow.

A game does better than a linear feedback and its winning domain is no box, so that this is an estimate and no bound. Of
a pole on a cart (40 x 60 x 40 x 60 cells win at a third of 1 / the pole's rate, 30 x 40 x 30 x 40 do not) it says 1.5
million cells there, and a sixth of that at twice the sampling time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.late import scipy

TURNS = (0.45, 0.6, 0.8)
"""Sampling times looked at: shares of 1 / the fastest rate of the linear model. Judgement: at most an eighth turn, and
not so short that X takes speeds at which it is crossed in a few steps."""
ENOUGH = 2.0
"""Times the fewest cells of all sampling times: the shortest sampling time within that is taken. Judgement."""
EVALUATIONS = 120
"""Of the search over r and K, for each of their unknowns."""
EVEN = 0.01
"""Weight of boxes that are alike along all axes: parts of a plant that do not touch each other may have any sizes."""
_LARGEST, _ROUNDS, _SETTLED = 0.999, 400, 1e-4
_FAILED = 1e3


@dataclass(frozen=True, eq=False)
class Proportions:
    """What one sampling time needs.

    Attributes:
        tau: s. cells: (n,) along each axis. box: (n,) half-widths, up to one factor for all of them.
        gain: (m, n) of the feedback.
    """

    tau: float
    cells: Floats
    box: Floats
    gain: Floats

    @property
    def size(self) -> float:
        """Cells in all."""
        return float(np.prod(self.cells))


def proportions(a: Floats, b: Floats, rate: float, taus: Sequence[float] | None = None) -> Proportions | None:
    """The proportions that need few cells at a short sampling time.

    Args:
        a, b: dx/dt = a x + b u, (n, n) and (n, m), in units in which states and inputs are of like size.
        rate: what `TURNS` are shares of, 1/s.
        taus: sampling times to look at, s; those of `TURNS` if not given.

    Returns:
        None where no feedback holds the plant.
    """
    tried = [_at(a, b, tau) for tau in (taus or [share / rate for share in TURNS])]
    found = [p for p in tried if p is not None]
    if not found:
        return None
    fewest = min(p.size for p in found)
    return min((p for p in found if p.size <= ENOUGH * fewest), key=lambda p: p.tau)


def _at(a: Floats, b: Floats, tau: float) -> Proportions | None:
    n, m = b.shape
    both = scipy.linalg.expm(np.block([[a, b], [np.zeros((m, n + m))]]) * tau)
    ad, bd = both[:n, :n], both[:n, n:]

    def of(unknown: Floats) -> tuple[Floats, Floats, Floats] | None:
        weights, r = np.exp(np.clip(unknown[:n], -12, 12)), np.exp(np.clip(unknown[n:], -12, 12))
        try:
            cost = scipy.linalg.solve_discrete_are(ad, bd, np.diag(weights), np.eye(m))
        except (np.linalg.LinAlgError, ValueError):
            return None
        gain = np.linalg.solve(np.eye(m) + bd.T @ cost @ bd, bd.T @ cost @ ad)
        spread = _spread(ad, ad - bd @ gain)
        return None if spread is None else (spread @ r / r, spread @ r, gain)

    def size(unknown: Floats) -> float:
        found = of(unknown)
        return _FAILED if found is None else float(np.log(found[0]).sum() + EVEN * np.var(np.log(found[1])))

    start = np.zeros(2 * n)
    options = {"maxfev": EVALUATIONS * 2 * n, "adaptive": True}
    for _ in range(2):  # begun again where it stopped: Nelder and Mead's simplex may have collapsed
        start = scipy.optimize.minimize(size, start, method="Nelder-Mead", options=options).x
    found = of(start)
    return None if found is None else Proportions(tau, *found)


def _spread(ad: Floats, closed: Floats) -> Floats | None:
    """M of this module's head; None where the closed loop does not settle."""
    if np.abs(np.linalg.eigvals(closed)).max() > _LARGEST:
        return None
    power, total, step = np.eye(len(ad)), np.zeros_like(ad), np.abs(ad)
    for _ in range(_ROUNDS):
        total += np.abs(power) @ step
        power = closed @ power
        if np.abs(power).max() < _SETTLED:
            return total
    return None
