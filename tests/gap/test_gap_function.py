import json

import numpy as np
import pytest

from simgap.errors import BrokenPromise, UserError
from simgap.gap.bases import Blocks, Expressions, Monomials
from simgap.gap.bounds.load import from_json
from simgap.gap.fitting.acceptance import check_fresh, clopper_pearson_upper
from tests.gap.fit_in_memory import fit_gap
from tests.gap.gap_examples import PAPER, U, X, coulomb, gap_section, off_grid, on_grid, smooth

KINDS = {
    "signed": {},
    "unsigned": {"sides": "unsigned"},
    "per axis": {"padding": "per_axis"},
    "paper": {"padding": "paper", "objective": "eta", "sides": "unsigned"},
    "constant": {"basis": Expressions(terms=("1",))},
    "blocks": {"basis": Blocks(blocks=(8, 8))},
    "cubic": {"basis": Monomials(degree=3)},
    "own terms": {"basis": Expressions(terms=("sin(x1)", "tanh(x2/0.05)", "u", "1"))},
}


def fit(samples, **kind):
    options = {"basis": Expressions(terms=PAPER), "extreme_value": False}
    return fit_gap(samples, gap_section(**(options | kind)))


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("function", [smooth, coulomb])
def test_every_bound_covers_off_the_grid_or_is_refused(name, function):
    samples = on_grid(function, eps=0.0147)
    if function is coulomb and name in ("per axis", "paper"):
        with pytest.raises(BrokenPromise, match="not Lipschitz"):
            fit(samples, **KINDS[name])
        return
    result = fit(samples, **KINDS[name])
    check = check_fresh(result.function, *off_grid(function, 50_000))
    assert check.violations == 0
    assert all(np.isfinite(s.size) for s in result.function.sup().values())
    assert {tier.level for tier in result.function.tiers} == {1, 2}


@pytest.mark.parametrize("name", ["signed", "unsigned", "blocks", "own terms"])
def test_kernel_boxes_points_and_json_agree(name):
    function = fit(on_grid(smooth), **KINDS[name]).function
    again = from_json(json.loads(json.dumps(function.to_json())))
    x, u, _ = off_grid(smooth, 200)
    half = np.random.default_rng(1).uniform(0.0, 0.02, x.shape)
    lo, hi = np.maximum(x - half, X.lo), np.minimum(x + half, X.hi)
    below, above = function.box_bounds(lo, hi, u)
    for one, other in zip(again.box_bounds(lo, hi, u), (below, above), strict=True):
        np.testing.assert_array_equal(one, other)
    kernel, low, high = function.kernel(), np.empty(2), np.empty(2)
    for k in range(len(x)):
        kernel(lo[k], hi[k], u[k], low, high)
        np.testing.assert_allclose(low, below[k], rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(high, above[k], rtol=1e-12, atol=1e-18)
    inside = lo + (hi - lo) * np.random.default_rng(2).random(x.shape)
    at_lo, at_hi = function.bounds(inside, u)
    slack = 1e-15  # both are rounded outward, by different amounts
    assert np.all(below <= at_lo + slack)
    assert np.all(at_hi <= above + slack)
    suprema = list(function.sup().values())
    assert np.all(np.maximum(-at_lo, at_hi).max(axis=0) <= np.array([s.size for s in suprema]) * (1 + 1e-6))
    assert np.all((at_hi - at_lo).max(axis=0) <= np.array([s.width for s in suprema]) * (1 + 1e-6) + slack)


@pytest.mark.parametrize("name", ["signed", "unsigned", "blocks"])
def test_no_bound_outside_the_domain(name):
    function = fit(on_grid(smooth), **KINDS[name]).function
    lo, hi = function.bounds(np.array([[0.21, 0.0], [0.2, 0.5]]), U[:2])
    assert np.all(np.isneginf(lo[0]))
    assert np.all(np.isposinf(hi[0]))
    assert np.isfinite([lo[1], hi[1]]).all()
    kernel, low, high = function.kernel(), np.empty(2), np.empty(2)
    kernel(np.array([0.19, 0.0]), np.array([0.21, 0.1]), U[0], low, high)
    assert np.isneginf(low).all()
    assert np.isposinf(high).all()


def test_cell_tables_know_their_inputs():
    function = fit(on_grid(smooth), **KINDS["blocks"]).function
    lo, hi = function.bounds(np.zeros((1, 2)), np.array([[0.123]]))
    assert np.isneginf(lo).all()
    assert np.isposinf(hi).all()


@pytest.mark.parametrize("padding", ["inflate", "per_axis", "paper"])
def test_unsigned_bounds_are_never_negative_and_signed_never_upside_down(padding):
    """A gap that vanishes on a line invites a negative gamma there, as the paper's printed one."""
    for sides in ("signed", "unsigned"):
        result = fit(on_grid(lambda x, u: smooth(x, u) * x[..., :1] ** 2, eps=0.02), padding=padding, sides=sides)
        assert np.all(result.function.narrowest() >= 0.0)


def test_zero_gap():
    result = fit(on_grid(lambda x, u: np.zeros(x.shape)))
    assert all(s.size <= 1e-13 for s in result.function.sup().values())
    assert np.all(result.function.narrowest() >= 0.0)


def test_local_padding_beats_global_padding():
    samples = on_grid(smooth)
    widths = {p: fit(samples, padding=p).dimensions[1].mean_width for p in ("inflate", "per_axis", "paper")}
    assert widths["inflate"] < widths["per_axis"] < widths["paper"]


def test_hidden_states_spread_the_gap():
    base = on_grid(smooth)
    samples = on_grid(smooth, d_upper=base.d + 1e-3)
    function = fit(samples).function
    x, u, d = off_grid(smooth)
    assert check_fresh(function, x, u, d, d_upper=d + 1e-3).violations == 0
    assert check_fresh(function, x, u, d + 2e-3).violations == len(x)


def test_free_axes():
    """A gap that is declared not to depend on x1 is sampled in one cell along it and holds for all x1."""
    from simgap.geometry import Grid
    from tests.gap.fit_in_memory import GapSamples

    grid = Grid(X, [1, 60])
    x = np.broadcast_to(grid.centres()[:, None], (60, len(U), 2)) * [0.0, 1.0]
    u = np.broadcast_to(U, (60, len(U), 1))
    samples = GapSamples(grid, U, smooth(x, u), ("x1", "x2"), ("u",), free=(0,))
    function = fit(samples, basis=Expressions(terms=("x2", "x2^2", "u", "1"))).function
    far, u, _ = off_grid(smooth, 1000)
    d = smooth(far * [0.0, 1.0], u)
    far[:, 0] *= 100.0
    assert check_fresh(function, far, u, d).violations == 0
    with pytest.raises(UserError, match="symmetry"):
        fit(samples)


def test_raised_moves_outward():
    function = fit(on_grid(smooth)).function
    x, u, _ = off_grid(smooth, 10)
    lo, hi = function.bounds(x, u)
    low, high = function.raised(np.array([1.0, 0.0]), np.array([0.0, 2.0])).bounds(x, u)
    np.testing.assert_allclose(lo - low, [[1.0, 0.0]] * 10, atol=1e-12)
    np.testing.assert_allclose(high - hi, [[0.0, 2.0]] * 10, atol=1e-12)


def test_clopper_pearson():
    assert clopper_pearson_upper(300_000, 0) == pytest.approx(1.0e-5, rel=0.01)
    assert clopper_pearson_upper(300_000, 0) == pytest.approx(1 - 0.05 ** (1 / 300_000), rel=1e-9)
    assert clopper_pearson_upper(10, 10) == 1.0
    with pytest.raises(UserError):
        clopper_pearson_upper(10, 11)
