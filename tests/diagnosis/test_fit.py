"""The least squares over windows: when they give up, which of their ends is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simgap.diagnosis.search import fit as fit_module
from simgap.diagnosis.search.explanations import Search
from simgap.diagnosis.search.scoring import list_starts
from tests.diagnosis.plants import block, one_window, with_effect


def _slowed(sigma):
    """A block that viscous friction slows for two seconds: the problem, its model, where it begins."""
    t, x0 = np.arange(0.0, 2.0, 0.01), np.array([[0.0, 1.0]])
    problem, compiled = one_window(block(2.0), t, np.zeros_like(t))
    drag = with_effect(compiled, "viscous_friction", "slide", b=0.8)
    return replace(problem, y=problem.states(drag, x0), sigma=np.full(2, sigma)), compiled, x0


def test_a_fit_whose_linear_problems_stay_far_from_the_noise_is_given_up(monkeypatch):
    """A spring cannot imitate a motion that viscous friction slows; after three linear problems that is known."""
    problem, compiled, x0 = _slowed(1e-6)
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


def test_an_end_that_is_not_physical_does_not_replace_one_that_is(monkeypatch):
    """A set ends at a drag, and lower at a friction that drives: the drag stays, till a lower one comes."""
    problem, compiled, x0 = _slowed(1e-3)
    c, base = compiled.find("viscous_friction", "slide"), fit_module.fit(problem, compiled.null, x0, [], {})
    search = Search(problem, list_starts(problem))
    kept = []
    for b, chi2 in ((0.8, 50.0), (-0.1, 20.0), (0.7, 40.0), (0.9, 60.0)):
        theta = with_effect(compiled, "viscous_friction", "slide", b=b)
        end = fit_module.Fit(theta, x0, c.slots, chi2, np.eye(1), (), True, problem)
        monkeypatch.setattr(search, "_ended", lambda *given, end=end: end)
        kept.append(search.explain((c,), theta, base, again=True).fit.chi2)
    assert kept == [50.0, 50.0, 40.0, 40.0]
