"""Sensitivities of the windows to parameters, with the initial states projected out.

Columns are one-sided differences of the simulation, with a step so small that the response is a fraction of the noise
and the curvature vanishes beside it; the simulation is exact at friction reversals and input switches, so that it is
smooth enough for that. Eliminating the initial state of each window by QR is variable projection: Golub,
Pereyra (1973), SIAM J. Numer. Anal. 10(2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.simulation.problem import Problem

Missed = Callable[[Problem, Floats, Floats], Floats]
_ROWS_AT_ONCE = 60_000  # memory of a pass does not grow with the record
_RANK = 1e-10
_VISIBLE = 1e-14
"""An effect is seen if more than this share of what it does to the readings (of its square) is not what other initial
states would do. Of an offset of the position of a mass that slides freely 2e-19 was left and less (rounding; positions
about 0 and about 1000 m), with a spring that swings it once in 15 minutes 3.5e-12 (a record of 10 s): tests/diagnosis/
test_names.py."""
_BENDS, _SHORTER = 3.0, 1e-2
"""Of the noise, and of a step. Two links that whirl multiply an initial speed by 650 within a second: a step of 1e-6
moved readings by 14 of their noise, and no fit settled."""
_FIRST_STEP, _STEPS = 1e-4, (1e-10, 1e-2)  # of a difference: the one that is tried first, and how far it may go
_TARGET_RESPONSE = 0.001  # of the noise, root mean square
_JERKED_RESPONSE = 0.2
"""The same: between kinks slopes are steep. Of 12 fits of play that hardly rebounds 9 settled and 10 intervals held the
width at 0.2, 7 and 6 at 0.02; of four none settled at 0.001."""


@dataclass(frozen=True)
class Direction:
    """A point away from theta, and the step to it: the column is (prediction(away) - prediction(theta)) / step."""

    away: Floats
    step: float


@dataclass(frozen=True, eq=False)
class Linearised:
    """The least-squares problem around a point, initial states eliminated.

    Attributes:
        gram: (p, p) projected J^T J; gradient: (p,) projected J^T r; rest: projected r^T r.
        window_gradient: (w, p), window_gram: (w, p, p), window_rest: (w,): share of each window in these.
        state_r: (w, nx, nx) triangular factors of the initial-state columns; state_b: (w, nx, p) and
        state_g: (w, nx), Q^T of the parameter columns and of the residual, to recover the initial states' step.
    """

    gram: Floats
    gradient: Floats
    rest: float
    window_gradient: Floats
    window_gram: Floats
    window_rest: Floats
    state_r: Floats
    state_b: Floats
    state_g: Floats

    @property
    def visible(self) -> Bools:
        """(p,) whether a column is more than what the initial states can stand for, beyond rounding."""
        left = np.diag(self.gram)
        whole = left + np.sum(self.state_b**2, axis=(0, 1))
        return np.asarray(left > _VISIBLE * whole)

    def foreseen(self, step: Floats) -> Floats:
        """chi^2 of each window after a parameter step, initial states moved along, if all were linear: (p,) -> (w,)."""
        curved = np.einsum("i,wij,j->w", step, self.window_gram, step)
        return np.asarray(self.window_rest - 2.0 * self.window_gradient @ step + curved)

    def state_step(self, step: Floats) -> Floats:
        """The initial states' Gauss-Newton step that goes with a parameter step: (p,) -> (w, nx)."""
        right = self.state_g - self.state_b @ step
        size = np.abs(np.einsum("wii->wi", self.state_r))
        whole = np.all(size > _RANK * np.maximum(size.max(axis=1, keepdims=True), 1e-300), axis=1)
        out = np.empty_like(right)
        out[whole] = np.linalg.solve(self.state_r[whole], right[whole][:, :, None])[:, :, 0]
        for w in np.flatnonzero(~whole):
            out[w] = np.linalg.lstsq(self.state_r[w], right[w], rcond=_RANK)[0]
        return out


def scaled(gram: Floats) -> tuple[Floats, Floats]:
    """Normal equations (p, p) with columns of size 1, and their sizes (p,)."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return gram / np.outer(size, size), size


def inverted(gram: Floats, rank: float = 1e-10) -> Floats:
    """(p, p) inverse, columns scaled to one size; what the data do not show is left out."""
    own, size = scaled(gram)
    return np.asarray(np.linalg.pinv(own, rcond=rank, hermitian=True) / np.outer(size, size))


def promised(gram: Floats, gradient: Floats) -> tuple[float, Floats]:
    """Drop of chi^2 that normal equations (p, p), (p,) promise, and their solution (p,)."""
    own, size = scaled(gram)
    found = np.linalg.lstsq(own, gradient / size, rcond=1e-10)[0]
    return float(found @ (gradient / size)), np.asarray(found / size)


def slot_direction(problem: Problem, theta: Floats, slot: int, step: float) -> Direction:
    """One-sided difference in one parameter of theta (q,), away from its limits."""
    own = step if theta[slot] + step <= problem.model.upper[slot] else -step
    return Direction(with_values(theta, {slot: theta[slot] + own}), own)


def choose_steps(problem: Problem, theta: Floats, x0: Floats, slots: Iterable[int]) -> dict[int, float]:
    """A difference step for each slot, whose response is about `_TARGET_RESPONSE` of the noise: theta (q,), x0 (w, nx).

    Under an effect that jerks it is about `_JERKED_RESPONSE`.
    """
    part, few = problem.some()
    target = _JERKED_RESPONSE if problem.model.jerks(theta) else _TARGET_RESPONSE
    ways = {slot: partial(slot_direction, part, theta, slot) for slot in slots}
    return {slot: step_of(part, theta, x0[few], way, target, _STEPS, 3) for slot, way in ways.items()}


def step_of(
    part: Problem, theta: Floats, x0: Floats, way: Callable[[float], Direction], target: float,
    ends: tuple[float, float], tries: int,
) -> float:  # fmt: skip
    """The difference step, within these ends, that moves readings by the target (in units of the noise, RMS)."""
    step, here = _FIRST_STEP, part.residuals(theta, x0)
    for _ in range(tries):
        response = np.abs(part.residuals(way(step).away, x0) - here)
        size = float(np.sqrt(np.mean(np.minimum(response, 1e6) ** 2)))
        if size > 0.0 and 0.2 < size / target < 5.0:
            break
        step = float(np.clip(step * target / max(size, 1e-12), *ends))
    return step


def chunks(problem: Problem) -> Iterator[Ints]:
    """Neighbouring windows of a bounded number of samples."""
    begin, count, ends = 0, len(problem.windows), problem.rows[1:]
    while begin < count:
        stop = max(int(np.searchsorted(ends, problem.rows[begin] + _ROWS_AT_ONCE, "right")), begin + 1)
        yield np.arange(begin, stop)
        begin = stop


def sums(problem: Problem, residual: Floats) -> Floats:
    """Sum of squares of each window, (w,): (rows, k)."""
    return np.asarray(np.add.reduceat(np.einsum("rk,rk->r", residual, residual), problem.rows[:-1]))


def state_steps(x0: Floats) -> Floats:
    """Difference steps for the initial states, (nx,)."""
    return 1e-6 * (0.1 + np.abs(x0).max(axis=0))


def state_columns(
    problem: Problem, theta: Floats, x0: Floats, steps: Floats, missed: Missed = Problem.residuals
) -> tuple[Floats, Floats]:
    """What is missed (rows, k) from initial states (w, nx), and what each of their numbers does to the predictions,
    (nx, rows, k), by differences of `steps` (nx,): one pass over all windows, shifted and not.

    Where a step moves a reading by more than `_BENDS`, a window may bend within it: there by much shorter ones.
    """
    nx = x0.shape[1]
    shifts = np.vstack([np.zeros(nx), np.diag(steps)])
    flat = missed(problem.shifted, theta, (x0 + shifts[:, None]).reshape(-1, nx))
    all_of_them = flat.reshape(nx + 1, -1, flat.shape[1])
    moved = all_of_them[0] - all_of_them[1:]
    columns, largest = moved / steps[:, None, None], np.abs(moved).max(axis=(0, 2), initial=0.0)
    most = np.maximum.reduceat(largest, problem.rows[:-1])
    if (wild := (most > _BENDS) & (most * _SHORTER <= _BENDS)).any():
        part, which = problem.on(problem.windows.pick(wild)), np.repeat(wild, np.diff(problem.rows))
        columns[:, which] = state_columns(part, theta, x0[wild], _SHORTER * steps, missed)[1]
    return all_of_them[0], columns


def foreseen_variance(known: Floats, ahead: Floats) -> Floats:
    """Variance of predictions whose errors an initial state moves by `ahead`, (nx, ..., k), over that of the noise.

    The state is estimated from readings that it moves by `known`, (nx, n, k).
    """
    own = known.reshape(len(known), -1)
    return 1.0 + np.einsum("i...,ij,j...->...", ahead, np.linalg.pinv(own @ own.T, rcond=1e-12), ahead)


def linearise(problem: Problem, theta: Floats, x0: Floats, directions: Sequence[Direction]) -> Linearised:
    """Residual and columns of all windows, projected: theta, (w, nx), p directions."""
    p, nx, w = len(directions), x0.shape[1], len(problem.windows)
    window_gradient, window_gram, window_rest = np.zeros((w, p)), np.zeros((w, p, p)), np.zeros(w)
    state_r, state_b, state_g = np.zeros((w, nx, nx)), np.zeros((w, nx, p)), np.zeros((w, nx))
    steps = state_steps(x0)
    for part in chunks(problem):
        sub = problem.pick(part)
        here, moved = state_columns(sub, theta, x0[part], steps)
        residual, states = here.ravel(), np.ascontiguousarray(moved.reshape(nx, -1).T)
        columns = np.empty((len(residual), p))
        for j, d in enumerate(directions):
            columns[:, j] = (residual - sub.residuals(d.away, x0[part]).ravel()) / d.step
        lengths = np.diff(sub.rows) * problem.y.shape[1]
        for length in np.unique(lengths):
            (alike,) = np.nonzero(lengths == length)
            rows = sub.rows[alike, None] * problem.y.shape[1] + np.arange(length)
            q, r = _orthogonal(states[rows])
            b, e, back = columns[rows], residual[rows][..., None], q.transpose(0, 2, 1)
            qb, qe = back @ b, back @ e
            b, e = b - q @ qb, e - q @ qe
            at = part[alike]
            window_gram[at], window_gradient[at] = b.transpose(0, 2, 1) @ b, (b.transpose(0, 2, 1) @ e)[..., 0]
            window_rest[at] = np.sum(e * e, axis=(1, 2))
            state_r[at], state_b[at], state_g[at] = r, qb, qe[..., 0]
    gram, gradient, rest = window_gram.sum(axis=0), window_gradient.sum(axis=0), float(window_rest.sum())
    return Linearised(gram, gradient, rest, window_gradient, window_gram, window_rest, state_r, state_b, state_g)


def _orthogonal(states: Floats) -> tuple[Floats, Floats]:
    """QR of the columns of each window (w, n, nx); those that are 0 are left alone: what a state does not do it must
    not take away either."""
    q, r = np.linalg.qr(states)
    none = ~np.any(states, axis=1)
    for j in np.flatnonzero(none.any(axis=1)):
        kept = ~none[j]
        q[j], r[j] = 0.0, np.diag(np.where(kept, 0.0, np.abs(r[j]).max(initial=1.0)))
        q[j][:, kept], r[j][np.ix_(kept, kept)] = np.linalg.qr(states[j][:, kept])
    return q, r


def with_values(theta: Floats, values: Mapping[int, float]) -> Floats:
    """A copy of theta with some slots changed: (q,) -> (q,)."""
    out = theta.copy()
    out[list(values)] = list(values.values())
    return out
