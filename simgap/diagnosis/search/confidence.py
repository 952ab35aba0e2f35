"""95 % confidence intervals of the parameters of a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.noise import samples_as_one
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.noise_law import are_gross
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import linearise, slot_direction
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import A_FEW, CONFIDENCE, FIT_QUALITY, SELDOM
from simgap.effects import EffectParameter
from simgap.statistics import chi2 as chi_squared
from simgap.statistics import student


def at_noise(chi2: float, free: float) -> bool:
    """Whether a sum of squares with so many degrees of freedom is no more than noise; few numbers tell little."""
    return chi2 <= max(FIT_QUALITY * free, float(chi_squared.isf(SELDOM, free)))


def misfit(problem: Problem, at: Fit) -> tuple[float, float]:
    """chi^2 of what is no gross error, and its degrees of freedom; of everything, where gross errors are not few."""
    chi2, size = at.chi2, float(problem.size)
    if problem.usual is not None:
        loss = problem.residuals(at.theta, at.x0)
        gross = are_gross(loss, problem.spread)
        share = float(np.sum(gross) / np.sum(problem.compared))
        if 0.0 < share <= A_FEW:
            chi2, size = chi2 - float(np.sum(loss[gross] ** 2)), size * (1.0 - share)
    return chi2, max(size - problem.taken - len(at.slots), 1.0)


def chi2_dof(problem: Problem, at: Fit) -> float:
    """Reduced chi^2 of fitted windows, gross errors apart."""
    chi2, free = misfit(problem, at)
    return chi2 / free


def independent_share(problem: Problem, at: Fit) -> float:
    """Samples that one independent sample is worth, by the residuals of all windows and channels together."""
    residual = problem.residuals(at.theta, at.x0)
    most = int(np.min(problem.windows.stop - problem.windows.start)) // 2
    return samples_as_one(np.split(residual, problem.rows[1:-1]), most)


def standard_errors(problem: Problem, at: Fit, steps: dict[int, float], at_floor: bool) -> tuple[Floats, int]:
    """Standard deviations of the free parameters, (p,), and the degrees of freedom of their intervals.

    At the noise floor: Gauss-Newton covariance times chi^2/dof (the noise is estimated). Above it the residuals are not
    white, so that windows, not samples, are the independent units: the sandwich estimate clustered by window (Liang,
    Zeger (1986), Biometrika 73(1)), never less than the former.
    """
    plain = np.sqrt(np.maximum(np.diag(at.covariance), 0.0) * chi2_dof(problem, at))
    windows, p = len(problem.windows), len(at.slots)
    if at_floor or windows <= p or not p:
        return plain, problem.size if at_floor else windows - p
    directions = [slot_direction(problem, at.theta, k, steps[k]) for k in at.slots]
    parts = linearise(problem, at.theta, at.x0, directions).window_gradient
    meat = parts.T @ parts * windows / (windows - p)
    robust = np.sqrt(np.maximum(np.diag(at.covariance @ meat @ at.covariance), 0.0))
    return np.maximum(plain, robust), windows - p


def vanishing(problem: Problem, members: Sequence[Candidate], at: Fit, errors: Floats, dof: int) -> list[Candidate]:
    """Effects whose 95 % interval contains "no effect": every number that makes them act may be at its null.

    A saturation acts on nothing where its limit may lie above the largest command. `errors`: (p,) standard deviations.
    """
    by_slot = dict(zip(at.slots, errors.tolist(), strict=True))

    def is_gone(c: Candidate) -> bool:
        acting = [(p, k) for p, k in zip(c.effect.parameters, c.slots, strict=True) if not (p.shape or p.integer)]
        ends = [(p.null, *interval(float(at.theta[k]), by_slot.get(k, 0.0), dof)) for p, k in acting]
        return all(_reached(problem, c, null, lo, hi) for null, lo, hi in ends)

    return [c for c in members if is_gone(c)]


def undetermined(members: Sequence[Candidate], at: Fit, errors: Floats, dof: int) -> list[Candidate]:
    """Effects that refine another one by a number the data do not give: its 95 % interval leaves what is possible.

    A Stribeck peak of a width that may be 0 is Coulomb friction to these data. `errors`: (p,) standard deviations.
    """
    by_slot = dict(zip(at.slots, errors.tolist(), strict=True))

    def is_loose(p: EffectParameter, k: int) -> bool:
        fitted = p.shape and not p.may_vanish and k in by_slot
        return fitted and interval(float(at.theta[k]), by_slot[k], dof)[0] <= p.lower

    refining = [c for c in members if c.effect.contains is not None]
    return [c for c in refining if any(map(is_loose, c.effect.parameters, c.slots))]


def _reached(problem: Problem, c: Candidate, null: float, lo: float, hi: float) -> bool:
    if math.isinf(null) and c.on in problem.model.model.input_names:
        return hi >= float(np.abs(problem.u[:, problem.model.model.input_names.index(c.on)]).max())
    return lo <= null <= hi


def interval(value: float, error: float, dof: int) -> tuple[float, float]:
    """95 % interval by Student's t with that many degrees of freedom."""
    half = float(student.ppf(0.5 + 0.5 * CONFIDENCE, max(dof, 1))) * error
    return value - half, value + half
