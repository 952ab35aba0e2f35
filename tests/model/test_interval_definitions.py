"""Interval arithmetic against exact rationals and 60 digits: no end may lie inside the exact range, by any amount."""

from fractions import Fraction as Q

import mpmath
import numpy as np
import pytest
import sympy as sp

from simgap.model import interval
from simgap.model.compile import compile_interval_kernel

RNG = np.random.default_rng(20)
mpmath.mp.dps = 60


def intervals(count, lo=-3.0, hi=3.0):
    ends = np.sort(RNG.uniform(lo, hi, (count, 2)), axis=1)
    return [(float(a), float(b)) for a, b in ends]


def exact(found, values):
    assert Q(found[0]) <= min(values)
    assert Q(found[1]) >= max(values)


def test_sums_and_products_are_rounded_outward_whatever_the_signs():
    for a, b in zip(intervals(300), intervals(300), strict=True):
        p, q = [Q(v) for v in a], [Q(v) for v in b]
        exact(interval.iadd(a, b), [p[0] + q[0], p[1] + q[1]])
        exact(interval.imul(a, b), [x * y for x in p for y in q])


def test_inverses_and_roots():
    for a in [*intervals(200, 0.1), *intervals(200, -3.0, -0.1)]:
        exact(interval.iinv(a), [1 / Q(a[0]), 1 / Q(a[1])])
    for a in ((0.0, 1.0), (-1.0, 0.0), (-1.0, 2.0)):
        assert interval.iinv(a) == (-np.inf, np.inf)
    for a in intervals(200, 0.0, 5.0):
        lo, hi = interval.isqrt(a)
        assert Q(lo) ** 2 <= Q(a[0])
        assert Q(hi) ** 2 >= Q(a[1])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_powers(n):
    for a in [*intervals(150), *intervals(50, -3.0, -1.0), *intervals(50, 1.0, 3.0)]:
        inside = [Q(a[0]), Q(a[1])] + ([Q(0)] if a[0] <= 0.0 <= a[1] else [])
        exact(interval.ipow(a, n), [v**n for v in inside])


FUNCTIONS = {
    "isin": (mpmath.sin, [mpmath.pi * (k + mpmath.mpf(1) / 2) for k in range(-4, 4)], None),
    "icos": (mpmath.cos, [mpmath.pi * k for k in range(-4, 4)], None),
    "iatan": (mpmath.atan, [], None),
    "itanh": (mpmath.tanh, [], None),
    "iexp": (mpmath.exp, [], None),
    "ilog": (mpmath.log, [], 0.05),
    "isinc": (mpmath.sinc, [0, mpmath.findroot(lambda x: mpmath.tan(x) - x, 4.4934),
                            -mpmath.findroot(lambda x: mpmath.tan(x) - x, 4.4934)], None),
}  # fmt: skip


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_hold_their_ends_and_what_turns_between(name):
    function, turning, least = FUNCTIONS[name]
    for a in [*intervals(150, least or -6.0, 6.0), *intervals(100, least or 0.5, 2.5)]:
        points = [mpmath.mpf(a[0]), mpmath.mpf(a[1]), *(t for t in turning if a[0] <= t <= a[1])]
        values = [function(p) for p in points]
        lo, hi = getattr(interval, name)(a)
        assert mpmath.mpf(lo) <= min(values)
        assert mpmath.mpf(hi) >= max(values)


def test_a_tangent_across_a_pole_is_anything():
    for a in ((1.5, 1.6), (-1.6, -1.5), (0.0, 3.2), (4.7, 4.8)):
        assert interval.itan(a) == (-np.inf, np.inf)
    lo, hi = interval.itan((0.3, 1.2))
    assert mpmath.mpf(lo) <= mpmath.tan(mpmath.mpf(0.3))
    assert mpmath.mpf(hi) >= mpmath.tan(mpmath.mpf(1.2))


def test_extremes_of_two_and_sizes():
    for a, b in zip(intervals(100), intervals(100), strict=True):
        for name, of in (("imin", min), ("imax", max)):
            assert getattr(interval, name)(a, b) == (of(a[0], b[0]), of(a[1], b[1]))
        assert interval.ihull(a, b) == (min(a[0], b[0]), max(a[1], b[1]))
        lo, hi = interval.iabs(a)
        assert hi == max(-a[0], a[1])
        assert lo == (0.0 if a[0] <= 0.0 <= a[1] else min(abs(a[0]), abs(a[1])))
        assert interval.isign(a) == (np.sign(a[0]), np.sign(a[1]))


UNBOUNDED = [
    (lo, hi) for lo in (-np.inf, -1e300, -2.0, 0.0, 0.5, 1e300) for hi in (-2.0, 0.0, 0.5, 1e300, np.inf) if lo <= hi
]  # fmt: skip


def inside(a):
    """Some real numbers of an interval whose ends may be infinite."""
    lo, hi = max(a[0], -1e305), min(a[1], 1e305)
    return sorted({Q(lo), Q(hi), *(Q(v) for v in (-3.0, -0.1, 0.0, 0.1, 3.0) if lo <= v <= hi)})


def bounded(found, values):
    """No end is NaN, and each is a bound: an infinite one of all numbers, a finite one of these."""
    lo, hi = found
    assert lo == -np.inf or Q(lo) <= min(values)
    assert hi == np.inf or Q(hi) >= max(values)


def test_what_has_no_bound_is_never_narrowed():
    for a in UNBOUNDED:
        p = inside(a)
        for n in (1, 2, 3):
            bounded(interval.ipow(a, n), [v**n for v in p])
        for name in ("isin", "icos", "itan", "itanh", "iatan", "iexp", "ilog", "isqrt", "isinc"):
            lo, hi = getattr(interval, name)(a)
            assert lo < np.inf, (name, a)
            assert hi > -np.inf, (name, a)
        if any(p):
            bounded(interval.iinv(a), [1 / v for v in p if v])
        for b in UNBOUNDED:
            q = inside(b)
            bounded(interval.iadd(a, b), [x + y for x in p for y in q])
            bounded(interval.imul(a, b), [x * y for x in p for y in q])
            if any(p):
                ratio = interval.imul(b, interval.iinv(a))
                bounded(interval.imin((1.0, 1.0), ratio), [min(Q(1), y / x) for x in p for y in q if x])


def test_every_constant_and_an_unknown_slope_have_an_enclosure():
    x, u = sp.symbols("x u", real=True)
    found = compile_interval_kernel([sp.E * x, sp.pi * x, sp.diff(sp.sign(x / u), x)], ([x], [u]))
    at = np.ones(1)
    e, pi, slope = found(at, at, at, at)
    assert mpmath.mpf(e[0]) <= mpmath.e <= mpmath.mpf(e[1])
    assert mpmath.mpf(pi[0]) <= mpmath.pi <= mpmath.mpf(pi[1])
    assert slope == (-np.inf, np.inf)
