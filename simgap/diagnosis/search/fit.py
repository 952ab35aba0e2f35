"""Nonlinear least squares over windows: parameters of effects and the initial state of every window together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import Linearised, chunks, linearise, slot_direction

Floats = NDArray[np.float64]
_MAX_ITERATIONS = 30


@dataclass(frozen=True, eq=False)
class Fit:
    """Where the least squares ended.

    Attributes:
        theta: all parameters; x0: (w, nx) initial states; slots: the free parameters.
        chi2: sum of squared residuals over the noise.
        covariance: (p, p) of the free parameters for the assumed noise, (projected J^T J)^-1.
        at_limit: slots that ended on a physical limit.
        converged: whether the last step was below the tolerance.
    """

    theta: Floats
    x0: Floats
    slots: tuple[int, ...]
    chi2: float
    covariance: Floats
    at_limit: tuple[int, ...]
    converged: bool


def chi_square(problem: Problem, theta: Floats, x0: Floats) -> float:
    """Sum of squared residuals over the noise."""
    total = 0.0
    for part in chunks(problem):
        sub = problem.part(part)
        total += float(np.sum(sub.residuals(theta, x0[part]) ** 2))
    return total


def fit(
    problem: Problem,
    theta: Floats,
    x0: Floats,
    slots: Sequence[int],
    steps: Mapping[int, float],
    max_iterations: int = _MAX_ITERATIONS,
) -> Fit:
    """Levenberg-Marquardt in the projected parameters; each initial state follows by its own Gauss-Newton step.

    Args:
        problem: windows and model.
        theta, x0: where to start, all parameters and (w, nx).
        slots: the parameters that are free; they stay within their physical limits.
        steps: difference step of each slot.
        max_iterations: most linearisations.

    Source: Levenberg (1944); Marquardt (1963); Nocedal, Wright (2006), Numerical Optimization, sec. 10.3.
    """
    free, damping, converged = list(slots), 1e-4, False
    theta, x0, chi2 = theta.copy(), x0.copy(), chi_square(problem, theta, x0)
    linear = None
    for _ in range(max_iterations):
        directions = [slot_direction(problem, theta, k, steps[k]) for k in free]
        linear = linearise(problem, theta, x0, directions)
        tolerance = 1e-3 + 1e-7 * chi2
        accepted = False
        while damping < 1e8:
            step = _step(problem, theta, free, linear, damping)
            new_theta = theta.copy()
            new_theta[free] = np.clip(theta[free] + step, problem.model.lower[free], problem.model.upper[free])
            new_x0 = x0 + linear.state_step(new_theta[free] - theta[free])
            new_chi2 = chi_square(problem, new_theta, new_x0)
            if new_chi2 <= chi2 + 1e-9 * chi2:
                accepted = True
                break
            if new_chi2 - chi2 < tolerance and _expected(linear, new_theta[free] - theta[free], chi2) < tolerance:
                break
            damping *= 10.0
        if not accepted:
            converged = True
            break
        gain, theta, x0, chi2 = chi2 - new_chi2, new_theta, new_x0, new_chi2
        damping = max(damping / 10.0, 1e-9)
        if gain < tolerance:
            converged = True
            break
    covariance = _covariance(linear.gram) if linear is not None else np.zeros((0, 0))
    limit = tuple(k for k in free if theta[k] in (problem.model.lower[k], problem.model.upper[k]))
    return Fit(theta, x0, tuple(slots), chi2, covariance, limit, converged)


def _expected(linear: Linearised, step: Floats, chi2: float) -> float:
    """Decrease of chi^2 that the linearised problem promises."""
    return chi2 - linear.rest + float(2 * linear.gradient @ step - step @ linear.gram @ step)


def _step(problem: Problem, theta: Floats, free: list[int], linear: Linearised, damping: float) -> Floats:
    """The damped step; a parameter on its limit that is pushed outward stays."""
    step = np.zeros(len(free))
    lower, upper = problem.model.lower[free], problem.model.upper[free]
    at = theta[free]
    outward = ((at <= lower) & (linear.gradient < 0)) | ((at >= upper) & (linear.gradient > 0))
    move = np.flatnonzero(~outward)
    if move.size:
        gram = linear.gram[np.ix_(move, move)]
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        scaled = gram / np.outer(scale, scale) + damping * np.eye(len(move))
        step[move] = np.linalg.lstsq(scaled, linear.gradient[move] / scale, rcond=1e-13)[0] / scale
    return step


def _covariance(gram: Floats) -> Floats:
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.asarray(np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale))
