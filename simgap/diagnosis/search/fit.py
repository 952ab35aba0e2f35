"""Nonlinear least squares over windows: parameters of effects and the initial state of every window together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import (
    PATIENCE,
    SOONER,
    Refit,
    begun_afresh,
    refit,
    refit_from_all,
    stand_out,
    window_chi2,
)
from simgap.diagnosis.simulation.sensitivity import Linearised, inverted, linearise, scaled, slot_direction

EQUIVALENT_CHI2 = 1.0
"""Two fits whose chi^2 differ by less predict the same: an exact equivalence if their sensitivities span the same, and
the end of a fit where no initial state still promises more."""
_SETTLED = 0.05
"""Largest drop of chi^2 that the linear problem may still promise of the parameters, in units of chi^2/dof where that
is above 1 (a step of less than a quarter of a standard error); of the initial state of each window `EQUIVALENT_CHI2`.
Under dry friction what fitting such windows afresh from several starts gains counts instead of the promise: in the
drive with rests of benchmarks/dry_friction.py ends that a window held up, at a kink where it comes to rest, still
promised .4 to 136; begun afresh they ended lower by 20 to 350."""
_MAX_ITERATIONS = 30
_SOFTEST, _STIFFEST = 1e-9, 1e8  # damping
_RANK = 1e-8  # of the largest eigenvalue, and of a unit vector: what is less is not there
_ROUNDS = 3  # descents, windows that stand out begun afresh between them
_FEW = 4  # linearisations of a window that does worse than foreseen
_SHORT, _LEAST = 0.3, 0.05  # a window whose chi^2 misses this share of its foreseen drop, and this much in units of
# its chi^2/dof where that is above 1, is refitted


@dataclass(frozen=True, eq=False)
class Fit:
    """Where the least squares ended.

    Attributes:
        theta: all parameters; x0: (w, nx) initial states; slots: the free parameters.
        chi2: sum of squared residuals over the noise.
        covariance: (p, p) of the free parameters for the assumed noise, (projected J^T J)^-1.
        at_limit: slots that ended on a physical limit.
        converged: whether what the linear problem still promises is within `_SETTLED` and `EQUIVALENT_CHI2`.
        problem: that it is a fit to.
    """

    theta: Floats
    x0: Floats
    slots: tuple[int, ...]
    chi2: float
    covariance: Floats
    at_limit: tuple[int, ...]
    converged: bool
    problem: Problem | None = None

    @property
    def variances(self) -> Floats:
        """Of the free parameters, (p,); infinite for those that have a part in what the data do not show."""
        own = np.maximum(np.diag(self.covariance), 0.0)
        size = np.sqrt(np.where(own > 0.0, own, 1.0))
        values, vectors = np.linalg.eigh(self.covariance / np.outer(size, size))
        hidden = values <= _RANK * np.abs(values).max(initial=0.0)
        return np.where(np.sum(vectors[:, hidden] ** 2, axis=1) > _RANK, np.inf, own)

    def begin(self, problem: Problem) -> Floats:
        """Where a fit to the problem begins, (w, nx): its initial states, new ones in windows that are not its own."""
        if self.problem is None or self.problem.t is not problem.t:
            return initial_states(problem)
        if self.problem.windows is problem.windows:
            return self.x0
        own, x0 = dict(zip(self.problem.windows, self.x0, strict=True)), initial_states(problem)
        return np.stack([own.get(window, guess) for window, guess in zip(problem.windows, x0, strict=True)])


@dataclass(frozen=True, eq=False)
class _Point:
    """Where a descent stands: all parameters, initial states (w, nx), chi^2 of each window (w,)."""

    theta: Floats
    x0: Floats
    chi2: Floats

    @property
    def total(self) -> float:
        return float(np.sum(self.chi2))


def fit(
    problem: Problem,
    theta: Floats,
    x0: Floats,
    slots: Sequence[int],
    steps: Mapping[int, float],
    max_iterations: int = _MAX_ITERATIONS,
    rounds: int = _ROUNDS,
    useless: float = math.inf,
) -> Fit:
    """Levenberg-Marquardt in the projected parameters; each initial state follows by its own step.

    Under dry friction, or where a step fails, each window takes its step or stays, and those that do worse than the
    linear problem foresees are refitted one by one. At the start and at the end those that stand out are begun afresh:
    see `simulation.refit`.

    Args:
        problem: windows and model.
        theta, x0: where to start, all parameters and (w, nx).
        slots: the parameters that are free; they stay within their physical limits.
        steps: difference step of each slot.
        max_iterations: most linearisations of a descent; rounds: most descents.
        useless: a chi^2 at which the fit serves nobody. It is given up where `PATIENCE` linear problems in a row
            promise no less.

    Source: Levenberg (1944); Marquardt (1963); Nocedal, Wright (2006), Numerical Optimization, sec. 10.3.
    """
    free = list(slots)
    if not free:
        ends = refit_from_all(problem, theta, x0)
        chi2, settled = float(np.sum(ends.chi2)), not _open(problem, ends.promise, ends.chi2).any()
        return Fit(theta.copy(), ends.x0, (), chi2, np.zeros((0, 0)), (), settled, problem)
    at = _Point(theta.copy(), x0.copy(), window_chi2(problem, theta, x0))
    at, converged = _begun_afresh(problem, at, np.zeros(len(x0))), False
    for _ in range(rounds):
        at, linear, settled, given_up = _descend(problem, at, free, steps, max_iterations, useless)
        if given_up:
            break
        still = at.chi2 - linear.window_rest  # what the initial states still promise, by the linear problem
        mended = _begun_afresh(problem, at, still)
        if mended.total > at.total - EQUIVALENT_CHI2 * max(1.0, at.total / problem.size):
            converged = settled and (problem.model.rubs(at.theta) or not _open(problem, still, at.chi2).any())
            break
        at = mended
    limit = tuple(k for k in free if at.theta[k] in (problem.model.lower[k], problem.model.upper[k]))
    return Fit(at.theta, at.x0, tuple(slots), at.total, inverted(linear.gram, 1e-12), limit, converged, problem)


def states_fitted(problem: Problem, theta: Floats) -> Fit:
    """The fit of the initial states alone, at theta (q,)."""
    return fit(problem, theta, initial_states(problem), [], {})


def _least_gain(problem: Problem, at: _Point) -> float:
    """A decrease of chi^2 that is worth no further step, in units of chi^2/dof where that is above 1."""
    return 1e-3 * max(1.0, at.total / problem.size) + 1e-7 * at.total


def _descend(
    problem: Problem, at: _Point, free: list[int], steps: Mapping[int, float], most: int, useless: float
) -> tuple[_Point, Linearised, bool, bool]:
    """Steps until none is worth while.

    Returns:
        the end, the last linearisation, whether that promises no more of the parameters, whether it was given up.
    """
    damping, harder, settled, vain = 1e-4, SOONER, False, 0
    for _ in range(most):
        directions = [slot_direction(problem, at.theta, k, steps[k]) for k in free]
        linear = linearise(problem, at.theta, at.x0, directions)
        whole = _clipped(problem, at, free, _step(problem, at.theta, free, linear, _SOFTEST))
        foreseen = linear.foreseen(whole[free] - at.theta[free])
        of_parameters = float(np.sum(linear.window_rest - foreseen))
        settled = of_parameters <= _SETTLED * max(1.0, at.total / problem.size)
        if at.total - float(np.sum(foreseen)) < _least_gain(problem, at):
            break
        vain = vain + 1 if float(np.sum(foreseen)) > useless else 0
        if vain == PATIENCE:
            return at, linear, False, True
        while damping < _STIFFEST:
            theta = _clipped(problem, at, free, _step(problem, at.theta, free, linear, damping))
            step = theta[free] - at.theta[free]
            new = _follow(problem, at, linear, theta, step)
            if new.total <= at.total:
                break
            if float(np.sum(linear.window_rest - linear.foreseen(step))) < _least_gain(problem, at):
                break  # a shorter step has nothing left to gain
            damping, harder = damping * harder, harder * SOONER
        if not new.total <= at.total:  # no step leads down: not at a minimum by any word of the linear problem
            break
        gain, at = at.total - new.total, new
        damping, harder = max(damping / SOONER, _SOFTEST), SOONER
        if gain < _least_gain(problem, at):
            break
    return at, linear, settled, False


def _follow(problem: Problem, at: _Point, linear: Linearised, theta: Floats, step: Floats) -> _Point:
    """The initial states' Gauss-Newton step; each window takes it or stays, and one that falls short is refitted."""
    x0 = at.x0 + linear.state_step(step)
    chi2 = window_chi2(problem, theta, x0)
    if float(np.sum(chi2)) <= at.total and not problem.model.rubs(theta):
        return _Point(theta, x0, chi2)
    foreseen, least = linear.foreseen(step), _LEAST * np.maximum(1.0, at.chi2 / problem.counts)
    worse = np.flatnonzero(chi2 > foreseen + least)
    if worse.size:  # its own acceptance: a window for which the step is no good stays where it was
        old = window_chi2(problem.on(problem.windows.pick(worse)), theta, at.x0[worse])
        back = worse[old < chi2[worse]]
        x0[back], chi2[back] = at.x0[back], old[old < chi2[worse]]
    lost = np.flatnonzero(chi2 > foreseen + _SHORT * np.maximum(at.chi2 - foreseen, 0.0) + least)
    if lost.size:
        ends = refit(problem.on(problem.windows.pick(lost)), theta, x0[lost], _FEW)
        x0[lost], chi2[lost] = ends.x0, ends.chi2
    return _Point(theta, x0, chi2)


def _begun_afresh(problem: Problem, at: _Point, promise: Floats) -> _Point:
    """Windows whose chi^2 stands out, or under dry friction still promise, are refitted from several starts."""
    out = stand_out(problem, at.theta, at.chi2)
    if problem.model.rubs(at.theta):
        out |= _open(problem, promise, at.chi2)
    ends = begun_afresh(problem, at.theta, Refit(at.x0, at.chi2, promise), out)
    return _Point(at.theta, ends.x0, ends.chi2)


def _open(problem: Problem, promise: Floats, chi2: Floats) -> Bools:
    """Windows (w,) whose initial states still promise something."""
    return ~np.asarray(promise <= EQUIVALENT_CHI2 * np.maximum(1.0, chi2 / problem.counts))


def _clipped(problem: Problem, at: _Point, free: list[int], step: Floats) -> Floats:
    theta = at.theta.copy()
    theta[free] = np.clip(theta[free] + step, problem.model.lower[free], problem.model.upper[free])
    return theta


def _step(problem: Problem, theta: Floats, free: list[int], linear: Linearised, damping: float) -> Floats:
    """The damped step; a parameter on its limit that is pushed outward stays."""
    step = np.zeros(len(free))
    lower, upper = problem.model.lower[free], problem.model.upper[free]
    at = theta[free]
    outward = ((at <= lower) & (linear.gradient < 0)) | ((at >= upper) & (linear.gradient > 0))
    move = np.flatnonzero(~outward)
    if move.size:
        gram, size = scaled(linear.gram[np.ix_(move, move)])
        damped = gram + damping * np.eye(len(move))
        step[move] = np.linalg.lstsq(damped, linear.gradient[move] / size, rcond=1e-13)[0] / size
    return step
