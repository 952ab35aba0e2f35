"""Held-out judgement of a model, agreement of its coefficients between folds, and the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.result import Judged, Verdict
from simgap.diagnosis.search.confidence import degrees_of_freedom, standard_errors, vanishing
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import COVERED_ERRORS, EXCESS_KEPT, FIT_QUALITY, FOLD_AGREEMENT, HELD_OUT_QUALITY
from simgap.diagnosis.verdict.horizon import HorizonError, horizon_error

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out error of one parameter vector: windows with refitted initial states, and the causal horizon."""

    states: Floats
    rmse: Floats
    ratio: float
    horizon: HorizonError | None


def judge(held: Problem, theta: Floats, horizon_s: float) -> HeldOut:
    """Refit only the initial states (w, nx) of held-out windows at theta (q,), and predict ahead causally."""
    at = fit(held, theta, initial_states(held), [], {})
    residual = held.residuals(theta, at.x0)
    lost = held.model.nx * len(held.windows) / residual.size  # degrees of freedom that the initial states took
    unbiased = math.sqrt(max(1.0 - lost, 0.1))
    rmse = np.sqrt(np.mean(residual**2, axis=0)) * held.sigma / unbiased
    ratio = float(np.sqrt(np.mean(residual**2))) / unbiased
    return HeldOut(at.x0, rmse, ratio, horizon_error(held, theta, horizon_s))


def chi2_dof(problem: Problem, at: Fit) -> float:
    """Reduced chi^2 of fitted windows."""
    return at.chi2 / max(problem.size - problem.model.nx * len(problem.windows) - len(at.slots), 1)


def judged(problem: Problem, at: Fit, held: HeldOut, horizon_s: float) -> Judged:
    """The figures of one model as they are reported."""
    names = problem.model.measured
    horizon = {} if held.horizon is None else dict(zip(names, map(float, held.horizon.rmse), strict=True))
    rmse = dict(zip(names, map(float, held.rmse), strict=True))
    return Judged(rmse, horizon_s, horizon, chi2_dof(problem, at), held.ratio)


def excess(held: HeldOut, floor: Floats | None, sigma: Floats) -> float:
    """Excess of E(h) over F(h), all channels together in units of their noise; of the windows without a horizon."""
    if held.horizon is None or floor is None:
        return math.sqrt(max(0.0, held.ratio**2 - 1.0))
    return float(np.sqrt(np.mean(np.maximum(held.horizon.rmse**2 - floor**2, 0.0) / sigma**2)))


def real(search: Search, found: Explanation, at_floor: bool) -> Explanation:
    """Without the effects whose interval contains "no effect", one after another, the rest fitted again."""
    while gone := vanished(search, found, at_floor):
        found = search.without(found, gone[0])
    return found


def vanished(search: Search, found: Explanation, at_floor: bool) -> list[Candidate]:
    """Its effects whose 95 % interval contains "no effect"."""
    if not found.members:
        return []
    reduced = chi2_dof(search.problem, found.fit)
    errors = standard_errors(search.problem, found.fit, search.steps, reduced, at_floor)
    dof = degrees_of_freedom(search.problem, found.fit, at_floor)
    return vanishing(search.problem, found.members, found.fit, errors, dof)


def folds_agree(problem: Problem, found: Explanation, steps: dict[int, float], samples: float) -> bool:
    """Whether two halves of the fitted windows give the same coefficients, within their size or two standard errors.

    `samples` is how many samples one independent sample is worth: the standard errors grow with its root.
    """
    w = problem.windows
    traces = np.unique(w.trace)
    half = np.isin(w.trace, traces[: len(traces) // 2]) if len(traces) > 1 else np.arange(len(w)) < len(w) // 2
    if half.all() or not half.any():
        return False
    ends = []
    for side in (half, ~half):
        part = problem.on(w.pick(side))
        ends.append((part, fit(part, found.fit.theta, found.fit.x0[side], found.fit.slots, steps)))
    null, slots = problem.model.null, list(found.fit.slots)
    a, b = (e.theta[slots] - np.where(np.isfinite(null[slots]), null[slots], 0.0) for _, e in ends)
    variances = [np.maximum(np.diag(e.covariance), 0.0) * max(chi2_dof(part, e), 1.0) for part, e in ends]
    spread = np.sqrt(sum(variances) * samples)
    near = np.abs(a - b) <= np.maximum(FOLD_AGREEMENT * np.maximum(np.abs(a), np.abs(b)), COVERED_ERRORS * spread)
    return bool(np.all(near))


def verdict(before: float, after: float, ratio: float, found: Explanation, share: float, agree: bool) -> Verdict:
    """The table of verdicts.

    Args:
        before, after: chi^2/dof of the declared and of the corrected model.
        ratio: held-out RMSE over noise of the corrected model.
        found: the chosen effects.
        share: held-out excess after over before.
        agree: whether the coefficients agree between folds.

    A fit that has not settled is never more than `partial`.
    """
    if not found.members:
        return "none" if before <= FIT_QUALITY else "unexplained"
    if after <= FIT_QUALITY and ratio <= HELD_OUT_QUALITY and found.fit.converged:
        return "attributed"
    return "partial" if share <= EXCESS_KEPT and found.physical and agree else "unexplained"
