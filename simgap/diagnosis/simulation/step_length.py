"""How long an integration step may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import window_chi2
from simgap.diagnosis.thresholds import MATTERS

_SHARE = 0.01  # of the noise
_MOST_HALVINGS = 6


def resolved(problem: Problem, theta: Floats, x0: Floats) -> bool:
    """Whether the integration step that suits the model as declared does at theta (q,), x0 (w, nx) too.

    A step that is too long for a stiff effect gives it another motion, even none that ends. What half the step changes
    is compared with the misses.
    """
    part, few = problem.some()
    coarse, fine = (replace(part, h_max=h).residuals(theta, x0[few]) for h in (problem.h_max, problem.h_max / 2))
    moved = float(np.sqrt(np.mean(np.square(coarse - fine))))
    return moved <= MATTERS * max(1.0, float(np.sqrt(np.mean(np.square(coarse)))))


def resolved_everywhere(problem: Problem, theta: Floats, x0: Floats) -> bool:
    """Whether half the step moves the predictions of no window by more than a tenth of what it misses, or of the noise.

    A reactor that runs away in one window of forty is stiff there alone.
    """
    at, half = (window_chi2(replace(problem, h_max=h), theta, x0) for h in (problem.h_max, problem.h_max / 2))
    return bool(np.all(np.abs(half - at) <= 2.0 * MATTERS * np.maximum(at, problem.counts)))


def settled(problem: Problem) -> Problem:
    """The problem with the longest integration step whose halving moves no prediction by a hundredth of the noise.

    Where none does, the one whose halving moves them least: a model that runs into a singularity has no right path
    behind it, and short steps would only take their time.
    """
    part, _ = problem.some()
    x0, theta, h, tried = initial_states(part), problem.model.null, problem.h_max, []
    for _ in range(_MOST_HALVINGS):
        coarse, fine = (replace(part, h_max=step).residuals(theta, x0) for step in (h, h / 2))
        moved = float(np.max(np.abs(coarse - fine)))
        if moved < _SHARE:
            return replace(problem, h_max=h)
        h /= 2
        tried.append((moved, h))
    return replace(problem, h_max=min(tried)[1])
