"""First guesses of the states at the start of windows, from the measured channels."""

from __future__ import annotations

import itertools

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import state_columns, state_steps, sums
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel

_SPANS = (15, 10, 7, 5)  # samples
_HEADINGS = 24
_PIECES = 8  # of each half of a window, in which a wrong model has no time to fall away
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
    """Whether an error of the start grows `GROWTH` times in the second half of most windows, by the model as declared.

    The largest that it does to a reading in each half is compared: what swings passes through zero. What drifts or
    accelerates grows twofold or fourfold there; what falls from an unstable rest grows without end. It grows along the
    readings, from one piece of a window to the next: a model that is wrong falls away from them, perhaps to calm.
    """
    part, _ = problem.some()
    return float(np.median([_grown(part, *window) for window in part.windows])) > GROWTH


def _grown(problem: Problem, start: int, stop: int, trace: int) -> float:
    """By what factor an error of the start of a window grows in its second half, infinite if the prediction is lost."""
    names = problem.model.model.state_names
    read = [names.index(name) for name in problem.model.measured]
    edges = np.unique(np.ceil(np.linspace(start, stop - 1, 2 * _PIECES + 1)).astype(np.int64))
    traces = np.full(len(edges) - 1, trace)
    beyond = np.minimum(edges[:-1] + max(_SPANS), problem.edges[trace + 1])
    x0 = initial_states(problem.on(Windows(edges[:-1], beyond, traces)))
    pieces = problem.on(Windows(edges[:-1], edges[1:] + 1, traces))
    moves = state_columns(pieces, pieces.model.null, x0, state_steps(x0), Problem.states)[1][:, pieces.rows[1:] - 1]
    with np.errstate(over="ignore", invalid="ignore"):
        chain = itertools.accumulate(moves.transpose(1, 2, 0), lambda so_far, move: move @ so_far)
        moved = np.array(list(chain))[:, read]
    if not np.isfinite(moved).all():
        return np.inf
    size = np.max(np.abs(moved) / problem.sigma[:, None], axis=1)
    half = max(len(size) // 2, 1)
    was, now = np.max(size[:half], axis=0), np.max(size[half:], axis=0, initial=0.0)
    return float(np.max(np.divide(now, was, out=np.zeros_like(now), where=was > 0.0)))


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
            x0[:, names.index(c.position)] = [np.mean(column[a : min(a + _STILL, b)]) for a, b, _ in problem.windows]
    return x0


def _position_of(model: SymbolicModel) -> dict[str, str]:
    """Velocity -> position for every state whose rate is another state."""
    rates = zip(model.state_names, map(sp.sympify, model.xdot), strict=True)
    return {str(rate): name for name, rate in rates if rate.is_Symbol and str(rate) in model.state_names}


def _best_angle(problem: Problem, x0: Floats, i: int) -> Floats:
    """Of evenly spread values of state i, the one with the smallest residual in each window."""
    angles, others = np.linspace(-np.pi, np.pi, _HEADINGS, endpoint=False), np.arange(x0.shape[1]) != i
    tries = [np.where(others, x0, angle) for angle in angles]
    best = np.argmin([sums(problem, problem.residuals(problem.model.null, tried)) for tried in tries], axis=0)
    return np.where(others, x0, angles[best][:, None])
