"""Interval arithmetic for compiled kernels: an interval is a pair (lo, hi), every result is rounded outward.

A correctly rounded operation is off by at most half a unit in the last place; widening each end by `_ULPS` relative
(four times that) covers it and the rounding of the widening itself. Library functions are off by a few units in the
last place; `_LIBM` covers them.

An end is never NaN, which a comparison would drop: an end that no number bounds is infinite. An infinite end stands for
real numbers without a bound, so 0 times it is 0.
"""

from __future__ import annotations

import math

import numpy as np

from simgap.late import njit

_ULPS = 2.0**-51
_LIBM = 2.0**-49
_TINY = 1e-300
_PI = math.pi
Interval = tuple[float, float]


@njit(inline="always")
def widen(lo: float, hi: float) -> Interval:
    """The pair moved outward by the rounding of one operation."""
    return _moved(lo, hi, _ULPS)


@njit(inline="always")
def _moved(lo: float, hi: float, relative: float) -> Interval:
    low, high = lo - (abs(lo) * relative + _TINY), hi + (abs(hi) * relative + _TINY)
    return (low if low < np.inf else -np.inf), (high if high > -np.inf else np.inf)


@njit(inline="always")
def _widen_libm(lo: float, hi: float) -> Interval:
    return _moved(lo, hi, _LIBM)


@njit
def _times(a: float, b: float) -> float:
    return 0.0 if a == 0.0 or b == 0.0 else a * b


@njit
def iadd(a: Interval, b: Interval) -> Interval:
    """a + b."""
    return widen(a[0] + b[0], a[1] + b[1])


@njit
def imul(a: Interval, b: Interval) -> Interval:
    """a b."""
    p, q, r, s = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    if np.isnan(p + q + r + s):
        p, q, r, s = _times(a[0], b[0]), _times(a[0], b[1]), _times(a[1], b[0]), _times(a[1], b[1])
    return widen(min(min(p, q), min(r, s)), max(max(p, q), max(r, s)))


@njit
def iinv(a: Interval) -> Interval:
    """1 / a; the whole line when a holds 0."""
    if a[0] <= 0.0 <= a[1]:
        return -np.inf, np.inf
    return widen(1.0 / a[1], 1.0 / a[0])


@njit
def ipow(a: Interval, n: int) -> Interval:
    """a to a positive integer power."""
    lo, hi = 1.0, 1.0
    if n % 2 == 0 and a[0] < 0.0:
        small = 0.0 if a[1] >= 0.0 else -a[1]
        a = (small, max(-a[0], a[1]))
    for _ in range(n):  # both ends are monotone now: either n is odd or a >= 0
        lo, hi = lo * a[0], hi * a[1]
    if n % 2 == 1 and a[0] < 0.0 and n > 1:
        lo, hi = -((-a[0]) ** n), (a[1] ** n if a[1] >= 0.0 else -((-a[1]) ** n))
    return _moved(lo, hi, (n + 1) * _LIBM)


@njit
def isqrt(a: Interval) -> Interval:
    """Square root of the part of a that is not negative."""
    lo, hi = widen(math.sqrt(max(a[0], 0.0)), math.sqrt(max(a[1], 0.0)))
    return max(lo, 0.0), hi


@njit
def _holds(a: Interval, phase: float) -> bool:
    """True if phase + 2 pi k lies in a (or within 1e-9 of it) for some integer k."""
    k = math.ceil((a[0] - 1e-9 - phase) / (2.0 * _PI))
    return phase + 2.0 * _PI * k <= a[1] + 1e-9


@njit
def _wave(a: Interval, p: float, q: float, least: float, largest: float) -> Interval:
    """Range over a of a wave that is p and q at its ends, -1 at the phase `least` and 1 at `largest`.

    [-1, 1] where the argument is so wide or large that reduction is not trusted.
    """
    if not (abs(a[0]) < 1e6 and abs(a[1]) < 1e6) or a[1] - a[0] >= 2.0 * _PI:
        return -1.0, 1.0
    lo, hi = _widen_libm(min(p, q), max(p, q))
    if _holds(a, least):
        lo = -1.0
    if _holds(a, largest):
        hi = 1.0
    return max(lo, -1.0), min(hi, 1.0)


@njit
def isin(a: Interval) -> Interval:
    """Sine."""
    return _wave(a, math.sin(a[0]), math.sin(a[1]), -0.5 * _PI, 0.5 * _PI)


@njit
def icos(a: Interval) -> Interval:
    """Cosine."""
    return _wave(a, math.cos(a[0]), math.cos(a[1]), _PI, 0.0)


@njit
def _sinc(x: float) -> float:
    return 1.0 if abs(x) < 1e-9 else math.sin(x) / x


@njit
def isinc(a: Interval) -> Interval:
    """sin(x) / x; falling in |x| up to pi, bounded by 1 / |x| and -0.2173 beyond."""
    near = 0.0 if a[0] <= 0.0 <= a[1] else min(abs(a[0]), abs(a[1]))
    far = max(abs(a[0]), abs(a[1]))
    if far > _PI:
        return -0.2173, 1.0 if near < 1.0 else 1.0 / near * (1.0 + _LIBM)
    lo, hi = _sinc(far), _sinc(near)
    return lo - 8.0 * _LIBM, min(hi + 8.0 * _LIBM, 1.0)


@njit
def itan(a: Interval) -> Interval:
    """Tangent; the whole line across a pole."""
    if a[1] - a[0] >= _PI or _holds(a, 0.5 * _PI) or _holds(a, -0.5 * _PI) or abs(a[0]) > 1e6 or abs(a[1]) > 1e6:
        return -np.inf, np.inf
    return _widen_libm(math.tan(a[0]), math.tan(a[1]))


@njit
def iatan(a: Interval) -> Interval:
    """Arc tangent."""
    return _widen_libm(math.atan(a[0]), math.atan(a[1]))


@njit
def itanh(a: Interval) -> Interval:
    """Hyperbolic tangent."""
    lo, hi = _widen_libm(math.tanh(a[0]), math.tanh(a[1]))
    return max(lo, -1.0), min(hi, 1.0)


@njit
def iexp(a: Interval) -> Interval:
    """Exponential."""
    lo, hi = _widen_libm(math.exp(a[0]), math.exp(a[1]))
    return max(lo, 0.0), hi


@njit
def ilog(a: Interval) -> Interval:
    """Logarithm of the positive part of a."""
    lo = math.log(a[0]) if a[0] > 0.0 else -np.inf
    hi = math.log(a[1]) if a[1] > 0.0 else -np.inf
    return _widen_libm(lo, hi)


@njit
def iabs(a: Interval) -> Interval:
    """Absolute value."""
    if a[0] <= 0.0 <= a[1]:
        return 0.0, max(-a[0], a[1])
    return min(abs(a[0]), abs(a[1])), max(abs(a[0]), abs(a[1]))


@njit
def isign(a: Interval) -> Interval:
    """Sign, with sign(0) = 0."""
    return float(np.sign(a[0])), float(np.sign(a[1]))


@njit
def iheaviside(a: Interval) -> Interval:
    """The unit step, the derivative of max(0, .); anything between 0 and 1 at 0."""
    return (1.0 if a[0] > 0.0 else 0.0), (0.0 if a[1] < 0.0 else 1.0)


@njit
def idiracdelta(a: Interval) -> Interval:
    """The derivative of the unit step: 0 away from 0, and no number where a holds 0, where the step jumps."""
    return (-np.inf, np.inf) if a[0] <= 0.0 <= a[1] else (0.0, 0.0)


@njit
def imin(a: Interval, b: Interval) -> Interval:
    """Smaller of the two."""
    return min(a[0], b[0]), min(a[1], b[1])


@njit
def imax(a: Interval, b: Interval) -> Interval:
    """Larger of the two."""
    return max(a[0], b[0]), max(a[1], b[1])


@njit
def ihull(a: Interval, b: Interval) -> Interval:
    """The smallest interval with both, for the branches of a piecewise expression."""
    return min(a[0], b[0]), max(a[1], b[1])
