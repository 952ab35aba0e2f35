"""How long an integration step may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem

_SHARE = 0.01  # of the noise
_MOST_HALVINGS = 6
_WINDOWS = 8


def settled(problem: Problem) -> Problem:
    """The problem with the longest integration step whose halving moves no prediction by a hundredth of the noise."""
    few = np.unique(np.linspace(0, len(problem.windows) - 1, _WINDOWS).astype(int))
    part = problem.on(problem.windows.pick(few))
    x0, theta, h = initial_states(part), problem.model.null, problem.h_max
    for _ in range(_MOST_HALVINGS):
        coarse, fine = (replace(part, h_max=step).residuals(theta, x0) for step in (h, h / 2))
        if float(np.max(np.abs(coarse - fine))) < _SHARE:
            break
        h /= 2
    return replace(problem, h_max=h)
