from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import linprog

from simgap.errors import UserError
from simgap.gap.bounds.linear import Basis
from simgap.gap.fitting.scenario import Design, solve_scenario
from tests.gap.gap_examples import PAPER, U, coulomb, on_grid, smooth


def make_design(terms=PAPER, function=smooth, eps=0.03):
    samples = on_grid(function, eps)
    return Design.of(Basis(terms, ("x1", "x2"), ("u",)), samples.grid.centres(), U), samples.d


def full_program(design, target, cap=None):
    """All rows at once with HiGHS: min eta, or min mean under a cap."""
    p = design.rows(np.arange(design.size))
    scale, level = np.abs(p).max(axis=0), np.abs(target).max()
    a, t = p / scale, target.ravel() / level
    ones = np.ones((len(a), 1))
    if cap is None:
        rows, right = np.block([[a, -ones], [-a, 0 * ones]]), np.concatenate([0 * t, -t])
        cost = np.r_[np.zeros(a.shape[1]), 1.0]
    else:
        rows, right = np.block([[a], [-a]]), np.concatenate([np.full_like(t, cap / level), -t])
        cost = a.mean(axis=0)
    found = linprog(cost, A_ub=rows, b_ub=right, bounds=(None, None), method="highs")
    assert found.success
    return found.fun * level


TARGETS = {
    "unsigned": lambda d: np.abs(d[:, :, 1]),
    "upper": lambda d: d[:, :, 1],
    "lower": lambda d: -d[:, :, 0],
    "all negative": lambda d: d[:, :, 1] - 0.05,
}


@pytest.mark.parametrize("side", TARGETS)
@pytest.mark.parametrize("function", [smooth, coulomb])
def test_equals_the_full_program(side, function):
    design, d = make_design(function=function)
    target = TARGETS[side](d)
    level = np.abs(target).max()
    result = solve_scenario(design, target, "lexicographic", slack=0.01)
    assert result.optimum == pytest.approx(full_program(design, target), abs=1e-6 * level)
    best_mean = full_program(design, target, cap=result.optimum + 0.01 * level)
    assert result.mean == pytest.approx(best_mean, abs=1e-6 * level)
    values = design.product(result.coefficients).whole()
    assert (target - values).max() <= result.worst_violation + 1e-15
    assert result.worst_violation <= 1e-6 * level
    assert values.max() <= result.optimum + (0.01 + 1e-6) * level


def test_paper_objective_has_the_same_optimum_but_not_the_mean():
    design, d = make_design()
    target = np.abs(d[:, :, 1])
    eta, both = (solve_scenario(design, target, o) for o in ("eta", "lexicographic"))
    assert eta.optimum == pytest.approx(both.optimum, rel=1e-6)
    assert eta.sup == pytest.approx(eta.optimum, rel=1e-6)
    assert both.mean < eta.mean


def test_a_gap_in_the_span_is_followed_exactly():
    design, _ = make_design(eps=0.02)
    target = design.product(np.array([0.1, -0.2, 0.3, 0.01, 0.02, -0.03, 0.004])).whole()
    result = solve_scenario(design, target, slack=1.0)
    assert np.abs(design.product(result.coefficients).whole() - target).max() <= 1e-6 * np.abs(target).max()


def test_terms_that_the_samples_do_not_tell_apart():
    design, d = make_design(("x1", "2*x1 + 0*u", "x1 + 1", "1", "u"))
    result = solve_scenario(design, d[:, :, 1])
    assert np.isfinite(result.coefficients).all()
    assert result.worst_violation <= 1e-6 * np.abs(d[:, :, 1]).max()


@pytest.mark.parametrize("target", [0.0, 3.0, -2.0])
def test_constant_targets(target):
    design, d = make_design()
    result = solve_scenario(design, np.full(d.shape[:2], target))
    assert result.sup == pytest.approx(target, abs=1e-6 * abs(target) + 1e-12)


def test_a_basis_that_cannot_cover():
    design, d = make_design(("x1",))
    with pytest.raises(UserError, match="Add the constant 1"):
        solve_scenario(design, np.abs(d[:, :, 1]) + 1.0)


def test_products_against_stored_rows():
    design, _ = make_design(("x1*u", "x1^2", "u^2", "1", "x2*x1"))
    q = np.array([0.3, -1.0, 2.0, 0.5, -0.25])
    rows = design.rows(np.arange(design.size))
    np.testing.assert_allclose(design.product(q).whole().ravel(), rows @ q, rtol=1e-13)
    np.testing.assert_allclose(design.mean, rows.mean(axis=0), atol=1e-15)
    np.testing.assert_allclose(design._gram, rows.T @ rows / len(rows), atol=1e-15)
    x, u = np.repeat(design.x.whole(), len(U), axis=0), np.tile(U, (design.shape[0], 1))
    for j in range(2):
        expected = design.basis.evaluate_gradient(x, u)[:, :, j] @ q
        np.testing.assert_allclose(design.slope(q, j).whole().ravel(), expected, atol=1e-15)


def test_a_program_that_one_solver_gives_up_is_the_others_and_then_told_with_its_key(monkeypatch):
    """Monomials of degree 6 over a gap that they fit to rounding are one; and a Furuta pendulum of some grams."""
    import clarabel
    import scipy

    design, d = make_design()
    target = np.abs(d[:, :, 1])
    usual = solve_scenario(design, target)
    stopped = SimpleNamespace(status=clarabel.SolverStatus.NumericalError)
    monkeypatch.setattr(clarabel, "DefaultSolver", lambda *program: SimpleNamespace(solve=lambda: stopped))
    assert solve_scenario(design, target).sup == pytest.approx(usual.sup, rel=1e-6)
    monkeypatch.setattr(scipy.optimize, "linprog", lambda *program, **more: SimpleNamespace(status=4))
    with pytest.raises(UserError, match="too ill-conditioned") as refused:
        solve_scenario(design, target)
    assert refused.value.key == "gap.basis"
