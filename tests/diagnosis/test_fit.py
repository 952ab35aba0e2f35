"""The least squares over windows: when they give up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simgap.diagnosis.search import fit as fit_module
from tests.diagnosis.plants import block, one_window, with_effect


def test_a_fit_whose_linear_problems_stay_far_from_the_noise_is_given_up(monkeypatch):
    """A spring cannot imitate a motion that viscous friction slows; after three linear problems that is known."""
    t = np.arange(0.0, 2.0, 0.01)
    problem, compiled = one_window(block(2.0), t, np.zeros_like(t))
    drag = with_effect(compiled, "viscous_friction", "slide", b=0.8)
    x0 = np.array([[0.0, 1.0]])
    problem = replace(problem, y=problem.states(drag, x0), sigma=np.full(2, 1e-6))
    slots = list(compiled.find("spring", "slide").slots)
    monkeypatch.setattr(fit_module, "PATIENCE", 3)
    passes = []
    linearise = fit_module.linearise
    monkeypatch.setattr(fit_module, "linearise", lambda *given: passes.append(1) or linearise(*given))
    whole = fit_module.fit(problem, compiled.null, x0, slots, {slots[0]: 1e-4})
    needed = len(passes)
    passes.clear()
    short = fit_module.fit(problem, compiled.null, x0, slots, {slots[0]: 1e-4}, useless=100.0 * problem.size)
    assert (len(passes), short.converged) == (3, False)
    assert whole.chi2 > 100.0 * problem.size  # nothing was lost
    assert needed > 3
