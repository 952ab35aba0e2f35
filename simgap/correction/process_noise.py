"""How far what a model misses moves its states in a step, told apart from the noise of the readings.

Stretches of readings are the model's path from an unknown start, moved by an unknown force that is constant in each
step (process noise), and reading noise. Linearised about the path that fits best, its variance is bounded by the
marginal likelihood of all stretches (restricted maximum likelihood; Harville 1977, JASA 72): the largest one that the
profile likelihood allows, over the size of the reading noise and over every correlation of the forces from step to step
that is named in `_correlations`, alternating ones among them. A force that the readings hide as noise is therefore not
taken for none. Chebyshev's inequality makes a bound of a variance, whatever the law of the forces is.

Assumed: reading noise is white, and the forces of a stretch have one variance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.correction.transitions import joined, mean_input
from simgap.diagnosis.result import WindowPrediction
from simgap.late import scipy
from simgap.late import sympy as sp
from simgap.model.compile import compile_columns
from simgap.model.symbolic import SymbolicModel

_STEPS, _PIECES, _MOST = 20, 4, 200
"""Steps of a stretch at most (an unstable plant stays near its path), and of the integration in a step: at least so
many for each reading, and at most."""
_ROUNDS = 2
_TOGETHER = 16  # stretches that are integrated in one pass: memory does not grow with the record
_OF_INTERVAL = 0.2
"""Of the probability that is left, the interval's share: it widens slowly, and the inequality fast."""
_FREQUENCIES, _LASTING = 9, (0.5, 0.9, 0.99)
"""Of the correlations cos(k w) r^k of forces k steps apart: w between 0 and pi, and r."""
_RATIOS = np.logspace(-10.0, 10.0, 401)
"""Variances that are tried, of that which a single step of a stretch would tell from noise."""


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Readings over whole steps: t (n,) s since its begin, read and used (n, k), inputs (steps * pieces, m), start
    (nx,)."""

    trace: str
    steps: int
    t: Floats
    read: Floats
    used: Floats
    inputs: Floats
    start: Floats

    @property
    def rows(self) -> int:
        """How many readings it has."""
        return int(np.count_nonzero(self.used))


@dataclass(frozen=True, eq=False)
class _Regression:
    """Readings of a stretch over noise, explained by the start, which is eliminated, and by the forces of a kind.

    Attributes:
        g: (kinds, steps, steps), b: (kinds, steps): normal equations. rss: of none; rows: how many readings, less nx.
        moved: (kinds, nx) largest effect of a unit force at the end of its step.
    """

    trace: str
    g: Floats
    b: Floats
    rss: float
    rows: int
    moved: Floats


def bound_forces(
    windows: Sequence[WindowPrediction], sigma: Mapping[str, float], model: SymbolicModel, step: float, level: float
) -> dict[str, float]:
    """State -> how far what the model misses moves it in a step: exceeded by a share 1 - level of steps at most.

    Args:
        windows: of the recordings that count; each recording has forces of its own, and the largest are taken.
        sigma: noise of each measured state, in the order of the columns.
        model: what remembers earlier commands are states or delays of it.
        step: s. level: of all: what it leaves is shared by the likelihood's interval and Chebyshev's inequality.

    Returns:
        nothing where too few readings were taken to tell anything.
    """
    whole = [w for w in joined(windows) if w.t[-1] - w.t[0] >= 3.0 * step]
    if not whole:
        return {}
    plant = _Plant(model, list(sigma), np.array(list(sigma.values())), step, whole)
    stretches = [s for w in whole for s in plant.stretches(w)]
    regressions = plant.regressions(stretches)
    if not regressions:
        return {}
    kinds, total = len(plant.forced), np.zeros(len(model.state_names))
    share = math.sqrt(kinds / ((1.0 - _OF_INTERVAL) * (1.0 - level)))  # Chebyshev's, the kinds together
    for k in range(kinds):
        variance = max(
            _largest_credible([r for r in regressions if r.trace == trace], k, _OF_INTERVAL * (1.0 - level))
            for trace in {r.trace for r in regressions}
        )
        total += share * math.sqrt(variance) * np.max([r.moved[k] for r in regressions], axis=0)
    return dict(zip(model.state_names, total.tolist(), strict=True))


class _Plant:
    """The model, integrated and linearised over stretches."""

    def __init__(
        self, model: SymbolicModel, measured: Sequence[str], sigma: Floats, step: float,
        windows: Sequence[WindowPrediction],
    ) -> None:  # fmt: skip
        names = list(model.state_names)
        self.model, self.sigma, self.step = model, sigma, step
        self.measured = [names.index(n) for n in measured]
        positions = {c.position for c in model.coordinates}
        velocities = {c.velocity for c in model.coordinates if c.position in measured}
        self.forced = [j for j, n in enumerate(names) if n not in positions and (n in measured or n in velocities)]
        self.rate = compile_columns(list(model.numeric()), [*names, *model.input_names])
        dt = min(float(np.median(np.diff(w.t))) for w in windows)
        self.pieces = min(max(_PIECES * math.ceil(step / dt * (1 - 1e-9)), 2 * _PIECES), _MOST)
        spread = np.concatenate([w.states for w in windows]).std(axis=0)
        sizes = {n: 1e-3 * max(float(s), 1e-9) for n, s in zip(names, spread, strict=False)}
        noise = dict(zip(measured, sigma.tolist(), strict=True))
        sizes |= {c.velocity: noise[c.position] / step for c in model.coordinates if c.position in noise} | noise
        self.varied = np.array([sizes.get(n, 1e-3) for n in names])

    def stretches(self, w: WindowPrediction) -> list[_Stretch]:
        """A window cut into stretches of nearly the same number of steps."""
        steps = int((w.t[-1] - w.t[0]) / self.step * (1 + 1e-9))
        edges = np.linspace(0, steps, -(-steps // _STEPS) + 1).astype(int)
        numbers = self.model.values()
        late = [float(sp.sympify(self.model.delays.get(n, 0)).subs(numbers)) for n in self.model.input_names]
        found, h = [], self.step / self.pieces
        for a, b in itertools.pairwise(edges):
            first = float(w.t[0] + a * self.step)
            inside = (w.t >= first - 1e-9) & (w.t <= w.t[0] + b * self.step * (1 + 1e-9))
            at = first + h * np.arange((b - a) * self.pieces)
            inputs = np.reshape([mean_input(w, j, at - s, h) for j, s in enumerate(late)], (len(late), len(at))).T
            start, begin = np.zeros(len(self.model.state_names)), int(np.argmax(inside))
            start[: w.states.shape[1]] = w.states[begin, : len(start)]
            start[self.measured] = w.measured[begin]
            read = w.measured[inside], w.used[inside]
            found.append(_Stretch(w.trace, int(b - a), w.t[inside] - first, *read, inputs, start))
        return found

    def regressions(self, stretches: Sequence[_Stretch]) -> list[_Regression]:
        """Of those with more readings than what is unknown; stretches of as many steps are integrated together."""
        found: list[_Regression] = []
        told = [s for s in stretches if s.rows - len(self.varied) > s.steps * len(self.forced)]
        for _, alike in itertools.groupby(sorted(told, key=lambda s: s.steps), key=lambda s: s.steps):
            every = list(alike)
            for k in range(0, len(every), _TOGETHER):
                found += self._regressions(every[k : k + _TOGETHER])
        return found

    def _regressions(self, group: Sequence[_Stretch]) -> Iterator[_Regression]:
        nx, starts = len(self.varied), np.stack([s.start for s in group])
        for _ in range(_ROUNDS):
            for start, s, (read, _) in zip(starts, group, self._paths(starts, group, forces=False), strict=True):
                a, y = self._rows(read, s)
                start += self.varied * np.linalg.lstsq(a, y, rcond=None)[0]
        for s, (read, ends) in zip(group, self._paths(starts, group, forces=True), strict=True):
            a, y = self._rows(read, s)
            basis = np.linalg.qr(a[:, :nx])[0]
            later, y = (x - basis @ (basis.T @ x) for x in (a[:, nx:], y))
            own = [later[:, k :: len(self.forced)] for k in range(len(self.forced))]
            moved = np.abs(ends[1:, :, 1 + nx :] - ends[1:, :, :1]).reshape(s.steps, nx, s.steps, len(own))
            largest = np.diagonal(moved, axis1=0, axis2=2).max(axis=2).T  # at the end of each one's own step
            g, b = np.stack([x.T @ x for x in own]), np.stack([x.T @ y for x in own])
            yield _Regression(s.trace, g, b, float(y @ y), s.rows - nx, largest)

    def _rows(self, path: Floats, s: _Stretch) -> tuple[Floats, Floats]:
        base = path[:, :, :1]
        a = (path[:, :, 1:] - base) * (s.used / self.sigma)[:, :, None]
        return a.reshape(-1, path.shape[2] - 1), ((s.read - base[:, :, 0]) * s.used / self.sigma).ravel()

    def _paths(self, starts: Floats, group: Sequence[_Stretch], forces: bool) -> Iterator[tuple[Floats, Floats]]:
        """Of each stretch, varied in the start and, if asked for, in each force: readings (n, k, variants), states at
        ends of steps (steps + 1, nx, variants)."""
        nx, h, steps = len(self.varied), self.step / self.pieces, group[0].steps
        kinds = self.forced if forces else []
        x = np.repeat(starts.T[:, :, None], 1 + nx + steps * len(kinds), axis=2)  # (nx, stretches, variants)
        x[np.arange(nx), :, 1 + np.arange(nx)] += self.varied[:, None]
        inputs = np.stack([s.inputs.T for s in group], axis=1)[..., None]  # (m, stretches, pieces, 1)
        ends, trail = [x.copy()], [x[self.measured].copy()]
        for m in range(steps):
            more = np.zeros((nx, 1, x.shape[2]))
            for k, j in enumerate(kinds):
                more[j, 0, 1 + nx + m * len(kinds) + k] = self.varied[j] / self.step
            for p in range(m * self.pieces, (m + 1) * self.pieces):
                u = inputs[:, :, p]
                half = x + 0.5 * h * (self.rate([*x, *u]) + more)
                x = x + h * (self.rate([*half, *u]) + more)
                trail.append(x[self.measured])
            ends.append(x.copy())
        whole, states = np.stack(trail), np.stack(ends)
        for i, s in enumerate(group):
            seen, at = whole[:, :, i], np.clip(s.t / h, 0.0, len(trail) - 1.0)
            low = np.minimum(at.astype(np.int64), len(seen) - 2)
            share = (at - low)[:, None, None]
            yield (1.0 - share) * seen[low] + share * seen[low + 1], states[:, :, i]


def _correlations(steps: int) -> Floats:
    """Of the forces of a stretch: none, and for each frequency ones that last; roots, (c, steps, steps)."""
    apart = np.abs(np.subtract.outer(np.arange(steps), np.arange(steps)))
    turns = np.linspace(0.0, np.pi, _FREQUENCIES)
    values, vectors = np.linalg.eigh([np.eye(steps), *(np.cos(w * apart) * r**apart for w in turns for r in _LASTING)])
    return np.asarray(vectors * np.sqrt(values.clip(0.0))[:, None])


def _largest_credible(regressions: Sequence[_Regression], k: int, beyond: float) -> float:
    """The largest variance of a kind of force that the profile likelihood of these stretches allows, but for a
    probability `beyond`."""
    rows, rss = sum(r.rows for r in regressions), sum(r.rss for r in regressions)
    roots = {n: _correlations(n) for n in {len(r.b[k]) for r in regressions}}
    costs, squares = [], []
    unit = 1.0 / np.median(np.concatenate([np.diag(r.g[k]) for r in regressions]).clip(1e-300))
    for c in range(len(next(iter(roots.values())))):
        eigen, z = [], []
        for r in regressions:
            root = roots[len(r.b[k])][c]
            values, vectors = np.linalg.eigh(root.T @ r.g[k] @ root)
            eigen.append(values.clip(0.0))
            z.append((vectors.T @ root.T @ r.b[k]) ** 2)
        q = unit * _RATIOS[:, None]
        gain = 1.0 + q * np.concatenate(eigen)
        left = np.maximum(rss - np.sum(q * np.concatenate(z) / gain, axis=1), 1e-12 * rss)
        costs.append(0.5 * (np.log(gain).sum(axis=1) + rows * np.log(left / rows) + rows))
        squares.append(left / rows)
    cost, square, ratio = np.array(costs), np.array(squares), unit * _RATIOS
    room = cost.min() + 0.5 * scipy.special.chdtri(1, 2.0 * beyond) - cost
    # the noise, larger than fits this ratio best: rows / 2 (log f + 1 / f - 1) of further cost
    factors = np.linspace(1.0, 2.0, 201)
    price = 0.5 * rows * (np.log(factors) + 1.0 / factors - 1.0)
    wide = factors[np.searchsorted(price, room.clip(0.0), side="right") - 1]
    return float(np.max(np.where(room >= 0.0, ratio * square * wide, 0.0)))
