"""Gaps of simulators in closed form: the bound holds between samples where an estimate from samples does not."""

import signal
from contextlib import contextmanager

import numpy as np
import pytest
import sympy as sp

from simgap.errors import BrokenPromise, UserError
from simgap.gap.bases import Expressions
from simgap.gap.bounds.enclosures import ClosedFormGap
from simgap.geometry import Box, Grid
from simgap.model.expressions import parse
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import symbol
from tests.gap.fit_in_memory import GapSamples, fit_gap
from tests.gap.gap_examples import U, X, gap_section

XS, US = (symbol("x1"), symbol("x2")), (symbol("u"),)
NOMINAL = ("x1 + 0.005*x2", "x2 + 0.015*u - 0.07*sin(x1)")
GRID = Grid(X, [20, 50])
PEAK = "1e-4*exp(-((x1 - 0.1)/0.001)^2)"  # far narrower than a cell, on the border between two


def model():
    return NominalModel(XS, US, tuple(parse(t, ["x1", "x2", "u"]) for t in NOMINAL), 0.005)


def known(*extra):
    """The nominal map plus a term in each row."""
    names = ["x1", "x2", "u"]
    rows = [parse(f"{row} + {term}", names) for row, term in zip(NOMINAL, extra, strict=True)]
    return ClosedFormGap.of(rows, model())


def numbers(gap, x, u):
    """The gap by SymPy's own lambdas, at (n, nx), (n, nu)."""
    rows = [sp.lambdify([*XS, *US], sp.sympify(e), "numpy") for e in gap.d]
    return np.stack([np.broadcast_to(f(*x.T, *u.T), len(x)) for f in rows], axis=1)


def samples(gap, grid=GRID, use=True, off=0.0):
    x, u = np.repeat(grid.centres(), len(U), axis=0), np.tile(U, (grid.size, 1))
    d = (numbers(gap, x, u) + off).reshape(grid.size, len(U), 2)
    return GapSamples(grid, U, d, ("x1", "x2"), ("u",), known=gap if use else None)


def outside(function, gap, x, u):
    lo, hi = function.bounds(x, u)
    d = numbers(gap, x, u)
    return int(((d < lo) | (d > hi)).any(axis=1).sum())


def dense(n=40_000, seed=5):
    """Random points, the peak's place, faces and corners of X, and both sides of rest."""
    rng = np.random.default_rng(seed)
    x = X.sample(rng, n)
    x[: n // 4, 0] = 0.1 + rng.normal(0, 1e-3, n // 4)
    x[n // 4 : n // 2, 1] = rng.choice([0.0, 1e-12, -1e-12, -0.5, 0.5], n // 4)
    x[n // 2 : n // 2 + 100, 0] = rng.choice([-0.2, 0.2], 100)
    return x, U[rng.integers(0, len(U), n)]


BOUNDS = [
    {"padding": "inflate"}, {"padding": "inflate", "sides": "unsigned"}, {"padding": "per_axis"}, {"padding": "paper"},
    {"basis": Expressions(terms=("1",))},
]  # fmt: skip


@pytest.mark.parametrize("how", BOUNDS, ids=str)
def test_a_peak_narrower_than_a_cell_is_covered(how):
    gap, (x, u) = known("1e-6*u*x1", PEAK), dense()
    settings = gap_section(extreme_value=False, **how)
    result = fit_gap(samples(gap), settings)
    assert outside(result.function, gap, x, u) == 0
    assert [tier.level for tier in result.function.tiers] == [1]
    assert "given" in result.function.tiers[0].text  # "No Lipschitz constant is given or estimated"
    assert all(d.lipschitz.proven for d in result.dimensions)
    estimated = fit_gap(samples(gap, use=False), settings)
    assert outside(estimated.function, gap, x, u) > 0  # what samples alone cannot see
    assert [tier.level for tier in estimated.function.tiers] == [1, 2]


def test_dry_friction_is_covered_on_both_sides_of_rest_and_at_rest():
    gap, (x, u) = known("0", "-6e-4*sign(x2) + 1e-3*x1*x2"), dense()
    result = fit_gap(samples(gap), gap_section(extreme_value=False))
    assert outside(result.function, gap, x, u) == 0
    assert [tier.level for tier in result.function.tiers] == [1]
    assert not result.dimensions[1].lipschitz.resolved


@pytest.mark.parametrize("how", [{"padding": "per_axis"}, {"padding": "paper"}], ids=str)
def test_a_jump_has_no_constant(how):
    with pytest.raises(BrokenPromise, match="not Lipschitz"):
        fit_gap(samples(known("0", "-6e-4*sign(x2)")), gap_section(extreme_value=False, **how))


def test_a_smooth_gap_costs_no_more_than_the_estimate():
    gap = known("1e-5*sin(3*x1)", "1e-3*x1*x2^2 + 2e-3*u")
    proven, estimated = (fit_gap(samples(gap, use=use), gap_section(extreme_value=False)) for use in (True, False))
    for a, b in zip(proven.dimensions, estimated.dimensions, strict=True):
        assert a.mean_width <= 1.05 * b.mean_width
        np.testing.assert_allclose(a.lipschitz.constants, b.lipschitz.constants, rtol=0.15, atol=1e-9)


@pytest.mark.parametrize(
    "term", ["1e-3*abs(x2)", "1e-3*max(x1, x2)", "1e-3*x2*abs(x2)", "1e-3*min(x1^2, 0.01)", "tanh(x1*x2)"]
)
def test_slopes_of_every_cell_hold_those_between_points_of_it(term):
    gap, rng = known("0", term), np.random.default_rng(2)
    ranges, c = gap.ranges(1, GRID, U), GRID.centres()
    for _ in range(20):
        a, b = (c + GRID.h * rng.uniform(-1, 1, c.shape) for _ in range(2))
        for m, u in enumerate(U):
            da, db = (numbers(gap, p, np.tile(u, (len(p), 1)))[:, 1] for p in (a, b))
            s = b - a
            ends = np.stack([ranges.slope_lo[:, m] * s, ranges.slope_hi[:, m] * s])
            assert (db - da <= ends.max(axis=0).sum(axis=1) + 1e-15).all()
            assert (db - da >= ends.min(axis=0).sum(axis=1) - 1e-15).all()
            assert ((ranges.lo[:, m] <= da) & (da <= ranges.hi[:, m])).all()


def test_roll_outs_that_are_not_those_of_the_equations_are_refused():
    gap = known("0", "1e-3*x1")
    with pytest.raises(BrokenPromise, match="roll-outs are not those of the equations"):
        fit_gap(samples(gap, off=1e-13), gap_section(extreme_value=False))


@pytest.mark.parametrize("term", ["1e-3/x1", "log(x1)", "sqrt(x2)"])
def test_what_is_not_bounded_is_refused_in_one_line(term):
    gap = known("0", term)
    with pytest.raises(UserError) as caught:
        gap.ranges(1, GRID, U)
    assert "\n" not in str(caught.value)


def test_coefficients_are_taken_as_the_numbers_that_they_are():
    """0.1 + 0.2 - 0.3 of floating-point numbers is not 0, and must not be rounded away."""
    row = parse("x1 + 0.1 + 0.2", ["x1"])
    gap = ClosedFormGap.of([row], NominalModel((XS[0],), (), (parse("x1 + 0.3", ["x1"]),), 1.0))
    assert gap.d[0].is_Rational
    assert gap.simulator[0] == XS[0] + sp.Rational(float(row - XS[0]))
    assert float(gap.d[0]) == float(row - XS[0]) - 0.3


def test_a_rounded_argument_may_fall_on_the_other_side_of_a_jump():
    from simgap.gap.bounds.enclosures import enclose

    box = {XS[0]: (-0.2, 0.2)}
    away, at, exactly = (enclose(parse(t, ["x1"]), box) for t in ("sign(x1 + 0.3)", "sign(x1 + 0.1)", "sign(x1)"))
    assert (away.error < 1e-14, exactly.error < 1e-14) == (True, True)  # an argument that is a state is not rounded
    assert at.error == 2.0


@contextmanager
def within(seconds):
    """Fails what takes longer, in the middle of what it does."""

    def stop(*_):
        raise TimeoutError(f"longer than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def runge_kutta(rates, x, h):
    """The classical step of order four, written out: one expression a state."""
    a = rates(x)
    b = rates([s + h / 2 * r for s, r in zip(x, a, strict=True)])
    c = rates([s + h / 2 * r for s, r in zip(x, b, strict=True)])
    d = rates([s + h * r for s, r in zip(x, c, strict=True)])
    return [s + h / 6 * (p + 2 * q + 2 * r + t) for s, p, q, r, t in zip(x, a, b, c, d, strict=True)]


def magnet(k, resistance):
    """A ball below a magnet: (i/z)^2 inside itself, a few times."""
    return lambda x: [x[1], 9.81 - k / 0.05 * (x[2] / x[0]) ** 2, (4.0 - resistance * x[2]) / 0.2]


def test_fractions_in_fractions_are_not_multiplied_out_for_ever():
    x = (*XS, symbol("x3"))
    half = runge_kutta(magnet(1.07e-4, 8.4), list(x), 0.0025)
    simulator = runge_kutta(magnet(1.07e-4, 8.4), half, 0.0025)
    nominal = runge_kutta(magnet(1.1036e-4, 8.0), list(x), 0.005)
    gap = ClosedFormGap.of(simulator, NominalModel(x, (), tuple(nominal), 0.005))
    with within(120):
        assert len(gap.d) == 3  # minutes and more, before
        grid = Grid(Box([0.009, -0.15, 0.5], [0.015, 0.15, 1.1]), [20, 4, 4])
        ranges = gap.ranges(0, grid, np.zeros((1, 0)))
    points = grid.centres() + grid.h * np.random.default_rng(4).uniform(-1, 1, (grid.size, 3))
    rows = [sp.lambdify(x, e, "numpy")(*points.T) for e in (simulator[0], nominal[0])]
    assert ((ranges.lo[:, 0] - 1e-15 <= rows[0] - rows[1]) & (rows[0] - rows[1] <= ranges.hi[:, 0] + 1e-15)).all()
    assert (ranges.hi - ranges.lo).max() < 1e-3  # of a position of 0.015 m


def test_what_both_maps_have_below_a_fraction_bar_cancels():
    rows = ["x1*x2/(1 + x1^2 + x2) + (x1 + x2)^2", "x2"]
    a, b = (parse(f"{rows[0]} + {more}", ["x1", "x2"]) for more in ("2*x1", "x1 + x1*x2 - x2*x1"))
    other = parse(rows[1], ["x2"])
    assert ClosedFormGap.of([a, other], NominalModel(XS, (), (b, other), 1.0)).d == (XS[0], 0)


def test_what_is_not_shown_to_be_bounded_is_named_and_not_said_to_be_unbounded():
    """sin(20 x) / (20 x) is at most 1, and no enclosure of a quotient says so."""
    with pytest.raises(UserError, match="'1/x1' divides by what may be 0") as refused:
        known("1e-4*sin(20*x1)/(20*x1)", "0").ranges(0, GRID, U)
    assert "write it in terms that are finite everywhere" in refused.value.remedy
