"""What a model misses in each sampling time, told apart from the noise of the readings.

A stretch of readings is the model's path from an unknown start, moved by an unknown constant rate in each step, and
noise. Linearised about the path that fits best this is a linear regression with a flat prior on the start and a normal
one on the rates of each state that a force or an unknown rate moves, of mean 0, variance q and correlation rho from
step to step: the disturbance smoother (de Jong 1989, Biometrika 76) of an input that is constant between samples. rho
and q are set by the marginal likelihood of all stretches (empirical Bayes), q at the upper end of its one-sided
profile-likelihood interval: what the readings cannot tell from noise is counted as missed.

Assumed: white noise of known size at most. A rate that the readings hardly show is taken for one that lasts or forgets,
not for one that cancels its predecessor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.late import scipy

Rate = Callable[[Sequence[Floats]], Floats]
"""States and inputs, each of any shape, one after another -> rates of the states."""

_ROUNDS, _AGAIN = 3, 2
"""Linearisations of the start, and of all: the second over rates as large as they are, which friction does not hold."""
_LEAST, _MOST = -18.0, 14.0
"""log q is sought between these, from that which the readings of a single step would tell from noise."""
_ANY_LAW = 2.0 / 3.0
"""Over the root of a probability: beyond so many standard deviations no law with one mode at 0 has more (Gauss 1823).
What the readings show is normal as their noise is; what they hide has a law that nobody has seen."""
_RHO = (-0.9, -0.5, 0.0, 0.5, 0.9)
_TOGETHER = 50
"""Stretches that are simulated at once: what they take of the memory."""
_FLAT = 1e8
"""Variance of the start, in units of what it is varied by: next to no prior."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """Readings over whole steps.

    Attributes:
        t: (n,) s since its begin; read: (n, k); used: (n, k) 1 for a reading that counts, 0 for none.
        inputs: (steps * pieces, m) means over each piece of the integration; start: (nx,) a first guess.
        held_out: whether no fit has seen it.
    """

    t: Floats
    read: Floats
    used: Floats
    inputs: Floats
    start: Floats
    held_out: bool = True


@dataclass(frozen=True, eq=False)
class Plant:
    """The model, and what is known of it.

    Attributes:
        rate: of its states; measured: columns of the readings among the states; moved: states with unknown rates.
        sigma: (k,) noise; varied: (nx,) by how much states are varied to linearise.
        step: s; steps: of each stretch; pieces: of the integration in one.
    """

    rate: Rate
    measured: Sequence[int]
    moved: Sequence[int]
    sigma: Floats
    varied: Floats
    step: float
    steps: int
    pieces: int


@dataclass(frozen=True, eq=False)
class Missed:
    """Of each step of each stretch: (s, steps, nx).

    Attributes:
        at: smoothed state at its begin. by: what the model misses at its end, posterior mean.
        spread: posterior standard deviation of that. beyond: how much more it may be with the level asked for.
    """

    at: Floats
    by: Floats
    spread: Floats
    beyond: Floats


@dataclass(frozen=True, eq=False)
class _Regression:
    """Normal equations of each stretch without its start, and what gives that back; see `_regression`."""

    g: Floats
    b: Floats
    back: Floats
    own: Floats
    base: Floats
    from_start: Floats
    from_rates: Floats
    squares: Floats


def missed_by(plant: Plant, stretches: Sequence[Stretch], level: float) -> Missed:
    """What the model misses in each step of the stretches.

    q is the larger one of those of the stretches that were fitted and of those that were not. The noise of a channel is
    at most what the path that fits best leaves of its readings.

    Args:
        level: of the upper end of q.
    """
    kinds = np.tile(np.arange(len(plant.moved)), plant.steps)
    fresh = np.array([s.held_out for s in stretches])
    parts = [own for own in (fresh, ~fresh) if own.any()]
    r = _regression(plant, stretches)
    plant = replace(plant, sigma=np.minimum(plant.sigma, np.sqrt(r.squares.mean(axis=0))))
    for again in range(_AGAIN):
        r = _regression(plant, stretches)
        rho = _correlations(r.g, r.b, kinds, level)
        q = np.max([_largest_credible(r.g[own], r.b[own], rho, kinds, level)[0] for own in parts], axis=0)
        if again < _AGAIN - 1:
            wider = np.ones(len(plant.varied))
            wider[list(plant.moved)] = np.maximum(1.0, np.sqrt(q))
            plant = replace(plant, varied=plant.varied * wider)
    root = np.sqrt(q)[kinds][:, None] * _root(rho, kinds)
    cov = root @ np.linalg.inv(np.eye(len(kinds)) + root.T @ r.g @ root) @ root.T
    rates = np.einsum("sij,sj->si", cov, r.b)
    start = r.own - np.einsum("sij,sj->si", r.back, rates)
    path = r.base + np.einsum("smnj,sj->smn", r.from_start, start) + np.einsum("smnj,sj->smn", r.from_rates, rates)
    by, spread, prior = np.zeros((3, len(stretches), plant.steps, r.base.shape[2]))
    for m in range(plant.steps):
        here = slice(m * len(plant.moved), (m + 1) * len(plant.moved))
        own = r.from_rates[:, m + 1, :, here]
        by[:, m] = np.einsum("snj,sj->sn", own, rates[:, here])
        spread[:, m] = np.sqrt(np.einsum("snj,sjk,snk->sn", own, cov[:, here, here], own).clip(0.0))
        prior[:, m] = np.sqrt(np.einsum("snj,j->sn", own**2, q))
    hidden = spread**2 / np.maximum(prior**2, 1e-300)
    normal, any_law = float(scipy.special.ndtri(0.5 + 0.5 * level)), _ANY_LAW / np.sqrt(1.0 - level)
    return Missed(path[:, :-1], by, spread, (normal + hidden * (any_law - normal)) * spread)


def _regression(plant: Plant, stretches: Sequence[Stretch]) -> _Regression:
    """Start and rates in units of their variation; the start is eliminated from the normal equations.

    `g` (s, r, r) and `b` (s, r) are those of the rates alone; the start is `own` - `back` @ rates; states at the steps'
    ends are `base` (s, steps + 1, nx) moved by `from_start` and `from_rates`. `squares` (s, k) is what the path from
    the best start leaves of the readings, mean square.
    """
    parts = [_linearised(plant, stretches[k : k + _TOGETHER]) for k in range(0, len(stretches), _TOGETHER)]
    return _Regression(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _linearised(plant: Plant, stretches: Sequence[Stretch]) -> tuple[Floats, ...]:
    """The fields of `_Regression`."""
    nx, start = len(plant.varied), np.stack([s.start for s in stretches], axis=1)
    for _ in range(_ROUNDS):
        _, read = _paths(plant, start, stretches, False)
        for k, s in enumerate(stretches):
            a, y, w = _rows(read[k], s, plant)
            normal = a.T @ (w[:, None] * a) + np.eye(nx) / _FLAT
            start[:, k] += plant.varied * np.linalg.solve(normal, a.T @ (w * y))
    ends, read = _paths(plant, start, stretches, True)
    moved, base = np.moveaxis(ends[:, :, 1:] - ends[:, :, :1], 3, 0), np.moveaxis(ends[:, :, 0], 2, 0)
    rows = []
    for k, s in enumerate(stretches):
        a, y, w = _rows(read[k], s, plant)
        first, later = a[:, :nx], a[:, nx:]
        inverse = np.linalg.inv(first.T @ (w[:, None] * first) + np.eye(nx) / _FLAT)
        cross, own = first.T @ (w[:, None] * later), first.T @ (w * y)
        back = inverse @ cross
        g, b = later.T @ (w[:, None] * later) - cross.T @ back, later.T @ (w * y) - back.T @ own
        squares = (s.used * y.reshape(s.read.shape) ** 2).sum(axis=0) / np.maximum(s.used.sum(axis=0), 1.0)
        rows.append((g, b, back, inverse @ own, base[k], moved[k, ..., :nx], moved[k, ..., nx:], squares))
    return tuple(np.stack(columns) for columns in zip(*rows, strict=True))


def _rows(path: Floats, s: Stretch, plant: Plant) -> tuple[Floats, Floats, Floats]:
    """Design matrix, what is to be explained and weights of a stretch: path (n, k, variants) at its stamps."""
    base = path[:, :, :1]
    a = (path[:, :, 1:] - base).reshape(-1, path.shape[2] - 1)
    return a, (s.read - base[:, :, 0]).ravel(), (s.used / plant.sigma**2).ravel()


def _paths(plant: Plant, start: Floats, stretches: Sequence[Stretch], rates: bool) -> tuple[Floats, list[Floats]]:
    """Simulate all stretches, varied in their start and, if asked for, in each of their rates.

    Returns:
        states at the steps' ends (steps + 1, nx, variants, s), the first variant as it is; readings of each stretch at
        its stamps (n, k, variants).
    """
    nx, nr = len(plant.varied), len(plant.moved) if rates else 0
    count, h = 1 + nx + plant.steps * nr, plant.step / plant.pieces
    x = np.repeat(start[:, None, :], count, axis=1)
    for i in range(nx):
        x[i, 1 + i] += plant.varied[i]
    inputs = np.stack([s.inputs for s in stretches], axis=2)
    ends, trail = [x.copy()], [x[list(plant.measured)].copy()]
    for m in range(plant.steps):
        more = np.zeros((nx, count, 1))
        for j, i in enumerate(plant.moved[:nr]):
            more[i, 1 + nx + m * nr + j] = plant.varied[i] / plant.step
        for p in range(plant.pieces):
            u = inputs[m * plant.pieces + p]
            half = x + 0.5 * h * (plant.rate([*x, *u]) + more)
            x = x + h * (plant.rate([*half, *u]) + more)
            trail.append(x[list(plant.measured)])
        ends.append(x.copy())
    seen = np.stack(trail)  # (pieces of all steps + 1, k, variants, s)
    found = []
    for k, s in enumerate(stretches):
        at = np.clip(s.t / h, 0.0, len(seen) - 1.0)
        low = np.minimum(at.astype(np.int64), len(seen) - 2)
        share = (at - low)[:, None, None]
        found.append((1.0 - share) * seen[low, :, :, k] + share * seen[low + 1, :, :, k])
    return np.stack(ends), found


def _root(rho: Sequence[float], kinds: Ints) -> Floats:
    """A root of the correlations of the rates, (r, r): AR(1) along the steps, none between kinds."""
    step = np.arange(len(kinds)) // len(rho)
    apart = np.abs(step[:, None] - step)
    each = np.asarray(rho)[kinds]
    return np.linalg.cholesky(np.where(kinds[:, None] == kinds, np.sign(each) ** apart * np.abs(each) ** apart, 0.0))


def _correlations(g: Floats, b: Floats, kinds: Ints, level: float) -> list[float]:
    """rho of each kind of rate: 0 but where another one is credible and 0 is not."""
    rho = [0.0] * (int(kinds.max()) + 1)
    for k in range(len(rho)):
        tries = {own: _largest_credible(g, b, [*rho[:k], own, *rho[k + 1 :]], kinds, level)[1] for own in _RHO}
        best = min(tries, key=lambda own: tries[own])
        rho[k] = best if tries[best] < tries[0.0] - 0.5 * np.log(g.shape[0] * g.shape[1]) else 0.0
    return rho


def _largest_credible(
    g: Floats, b: Floats, rho: Sequence[float], kinds: Ints, level: float
) -> tuple[Floats, float]:  # fmt: skip
    """Variances of the rates (kinds,), each at the upper end of its interval, and the least negative log likelihood."""
    count, like = len(rho), _root(rho, kinds)
    each = np.array([np.median(1.0 / np.einsum("sii->si", g)[:, kinds == k].clip(1e-300)) for k in range(count)])
    inner, y = like.T @ g @ like, b @ like

    def cost(log_q: Floats) -> float:
        root = np.sqrt(each * np.exp(log_q))[kinds]
        whole = np.eye(len(kinds)) + root[:, None] * inner * root
        z = y * root
        explained = np.einsum("si,si->s", z, np.linalg.solve(whole, z[..., None])[..., 0])
        return 0.5 * float(np.sum(np.linalg.slogdet(whole)[1] - explained))

    ends = [(_LEAST, _MOST)] * count
    tries = [scipy.optimize.minimize(cost, np.full(count, at), bounds=ends, method="L-BFGS-B") for at in (-4.0, 4.0)]
    found = min(tries, key=lambda f: float(f.fun))
    allowed = found.fun + 0.5 * scipy.special.chdtri(1, 2.0 - 2.0 * level)
    upper = found.x.copy()
    for k in range(count):

        def beyond(value: float, k: int = k) -> float:
            return cost(np.where(np.arange(count) == k, value, found.x)) - allowed

        upper[k] = scipy.optimize.brentq(beyond, found.x[k], _MOST, xtol=0.01) if beyond(_MOST) > 0.0 else _MOST
    return np.asarray(each * np.exp(upper)), float(found.fun)
