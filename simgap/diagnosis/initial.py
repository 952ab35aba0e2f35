"""First guesses of the states at the start of windows, from the measured channels alone."""

from __future__ import annotations

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from simgap.diagnosis.problem import Problem
from simgap.dynamics.model import symbol

Floats = NDArray[np.float64]
_SAMPLES = 15


def initial_states(problem: Problem) -> Floats:
    """States at the first sample of each window, (w, nx).

    A measured state is a cubic fitted to the first samples, a state that is the rate of a measured one is the slope of
    that cubic, anything else starts at zero.
    """
    model = problem.model.model
    names, measured = model.state_names, problem.model.measured
    rate_of = {str(e): n for n, e in zip(names, map(sp.sympify, model.xdot), strict=True) if e.is_Symbol}
    x0 = np.zeros((len(problem.windows), len(names)))
    for w, (a, b) in enumerate(zip(problem.windows.start, problem.windows.stop, strict=True)):
        stop = min(int(b), int(a) + _SAMPLES)
        t = problem.t[a:stop] - problem.t[a]
        span = max(float(t[-1]), 1e-9)
        basis = np.vander(t / span, min(4, len(t) - 1), increasing=True)
        fit = np.linalg.lstsq(basis, problem.y[a:stop], rcond=None)[0]
        for i, name in enumerate(names):
            if name in measured:
                x0[w, i] = fit[0, measured.index(name)]
            elif rate_of.get(name) in measured:
                x0[w, i] = fit[1, measured.index(str(rate_of[name]))] / span
    return x0


def rate_pairs(problem: Problem) -> dict[str, str]:
    """Position -> velocity for every state whose rate is another state."""
    model = problem.model.model
    return {n: str(e) for n, e in zip(model.state_names, model.xdot, strict=True) if sp.sympify(e).is_Symbol}


_ = symbol
