"""First guesses of the states at the start of windows, from the measured channels."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.simulation.problem import FARTHEST, Problem
from simgap.diagnosis.simulation.sensitivity import state_columns, state_steps, sums
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel

_SPANS = (15, 10, 7, 5)  # samples
_HEADINGS = 24
GROWTH = 20.0
"""A pole of 6 per window grows by e^3 in its half. With windows of a second a balanced Furuta pendulum (10 1/s) was not
fitted from a plain start, a cart-pole (5 1/s) was."""
_STILL = 5  # samples over which a window that begins stuck stands still


def initial_states(problem: Problem) -> Floats:
    """States at the first sample of each window, (w, begun).

    A measured state is a cubic fitted to the first samples, a state that is the rate of a measured one is the slope of
    that cubic; of a few spans the one that tells this slope best (a motion may turn round within the longest). An angle
    that nothing tells (a heading that was not recorded) is the best of a few directions, by what the declared model
    then predicts. Anything else starts at zero.
    """
    model, measured = problem.model.model, problem.model.measured
    names, position = model.state_names, _position_of(model)
    x0 = np.zeros((len(problem.windows), problem.model.begun))
    known: dict[tuple[int, int], list[tuple[float, float]]] = problem.memo.kept("starts", problem.sigma.tobytes(), dict)
    for w, (a, b) in enumerate(zip(problem.windows.start, problem.windows.stop, strict=True)):
        stop = min(int(b), int(a) + max(_SPANS))
        if (a, stop) not in known:
            known[a, stop] = [
                _value_and_slope(problem.t[a:stop] - problem.t[a], y, float(sigma))
                for y, sigma in zip(problem.y[a:stop].T, problem.sigma, strict=True)
            ]
        begins = known[a, stop]
        for i, name in enumerate(names):
            if name in measured:
                x0[w, i] = begins[measured.index(name)][0]
            elif position.get(name) in measured:
                x0[w, i] = begins[measured.index(position[name])][1]
    for i, v in enumerate(model.states):
        if v.name not in measured and v.name not in position and v.unit == "rad":
            x0 = _best_angle(problem, x0, i)
    return x0


def runs_away(problem: Problem) -> bool:
    """Whether an error of the start grows `GROWTH` times in the second half of most windows, as the model is declared.

    The largest that it does in each half is compared: what swings passes through zero. What drifts or accelerates grows
    twofold or fourfold there; what falls from an unstable rest grows without end, until the prediction is lost.
    """
    part, _ = problem.some()
    x0, theta = initial_states(part), part.model.null
    missed, moved = state_columns(part, theta, x0, state_steps(x0), Problem.misses)
    size = np.max(np.abs(moved), axis=2)
    halves = np.ravel(np.column_stack([part.rows[:-1], part.rows[:-1] + np.diff(part.rows) // 2 + 1]))
    first, second = np.maximum.reduceat(size, halves, axis=1).reshape(len(size), -1, 2).transpose(2, 0, 1)
    lost = np.maximum.reduceat(np.max(np.abs(missed), axis=1), part.rows[:-1]) >= FARTHEST
    with np.errstate(invalid="ignore", divide="ignore"):
        grown = np.max(np.where(first > 0.0, second / first, 0.0), axis=0)
    return bool(np.median(np.where(lost, np.inf, grown)) > GROWTH)


def _value_and_slope(t: Floats, y: Floats, sigma: float) -> tuple[float, float]:
    """Value and rate at t = 0 of a cubic through the first readings: (n,) s from 0, (n,), their noise.

    The span is the one whose slope has the smallest standard error, with what the cubic misses taken for noise.
    """
    best, least = (float(y[0]), 0.0), np.inf
    for n in (n for n in _SPANS if n <= len(t)):
        s = float(t[n - 1])
        basis = np.vander(t[:n] / s, 4, increasing=True)
        fit = np.linalg.lstsq(basis, y[:n], rcond=None)[0]
        missed = float(np.sqrt(np.sum(np.square(y[:n] - basis @ fit)) / (n - 4)))
        error = max(missed, sigma) * float(np.linalg.norm(np.linalg.pinv(basis)[1])) / s
        if error < least:
            best, least = (float(fit[0]), float(fit[1]) / s), error
        if missed <= sigma:  # a shorter span tells less
            break
    return best


def at_rest(problem: Problem, guess: Floats) -> Floats:
    """The guess with dry-friction coordinates at rest, measured positions the mean of the first samples: (w, nx)."""
    names, x0 = problem.model.model.state_names, guess.copy()
    x0[:, problem.model.dynamics.speed] = 0.0
    for c in problem.model.model.coordinates:
        if c.position in problem.model.measured:
            column = problem.y[:, problem.model.measured.index(c.position)]
            stops = np.minimum(problem.windows.start + _STILL, problem.windows.stop)
            spans = zip(problem.windows.start, stops, strict=True)
            x0[:, names.index(c.position)] = [np.mean(column[a:b]) for a, b in spans]
    return x0


def _position_of(model: SymbolicModel) -> dict[str, str]:
    """Velocity -> position for every state whose rate is another state."""
    rates = zip(model.state_names, map(sp.sympify, model.xdot), strict=True)
    return {str(rate): name for name, rate in rates if rate.is_Symbol and str(rate) in model.state_names}


def _best_angle(problem: Problem, x0: Floats, i: int) -> Floats:
    """Of evenly spread values of state i, the one with the smallest residual in each window."""
    best, least = x0.copy(), np.full(len(x0), np.inf)
    for angle in np.linspace(-np.pi, np.pi, _HEADINGS, endpoint=False):
        tried = x0.copy()
        tried[:, i] = angle
        size = sums(problem, problem.residuals(problem.model.null, tried))
        better = size < least
        best[better], least[better] = tried[better], size[better]
    return best
