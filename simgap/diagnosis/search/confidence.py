"""95 % confidence intervals of the parameters of a fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import linearise, slot_direction

Floats = NDArray[np.float64]


def standard_errors(problem: Problem, at: Fit, steps: dict[int, float], reduced: float, at_floor: bool) -> Floats:
    """Standard deviations of the free parameters, (p,).

    At the noise floor: Gauss-Newton covariance times chi^2/dof (the noise is estimated). Above it the residuals are not
    white, so that windows, not samples, are the independent units: the sandwich estimate clustered by window (Liang,
    Zeger (1986), Biometrika 73(1)), never less than the former.
    """
    plain = np.sqrt(np.maximum(np.diag(at.covariance), 0.0) * reduced)
    windows, p = len(problem.windows), len(at.slots)
    if at_floor or windows <= p or not p:
        return np.asarray(plain)
    directions = [slot_direction(problem, at.theta, k, steps[k]) for k in at.slots]
    parts = linearise(problem, at.theta, at.x0, directions).window_gradient
    meat = parts.T @ parts * windows / (windows - p)
    robust = np.sqrt(np.maximum(np.diag(at.covariance @ meat @ at.covariance), 0.0))
    return np.asarray(np.maximum(plain, robust))


def interval(value: float, error: float, dof: int) -> tuple[float, float]:
    """95 % interval by Student's t with that many degrees of freedom."""
    half = float(student.ppf(0.975, max(dof, 1))) * error
    return value - half, value + half
