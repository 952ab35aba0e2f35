"""Interval arithmetic on arrays of doubles: an interval is a pair (lo, hi) of arrays, every result rounded outward.

IEEE 754 rounds +, -, *, / to the nearest double, so the next double below (above) a computed end is a lower (upper)
bound of the exact one. No library function but these four, `nextafter` and `rint` is trusted: sine and cosine are
summed here.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

HALF_PI = (1.5707963267948966, 1.5707963267948968)  # neighbouring doubles around pi / 2
TRUSTED = 1e6  # beyond it an angle is not reduced


def down(x):
    return np.nextafter(x, -np.inf)


def up(x):
    return np.nextafter(x, np.inf)


def number(value):
    """A number given exactly, as a Fraction."""
    nearest = float(value)
    if Fraction(nearest) == value:
        return np.float64(nearest), np.float64(nearest)
    return np.float64(np.nextafter(nearest, -np.inf)), np.float64(np.nextafter(nearest, np.inf))


def add(a, b):
    return down(a[0] + b[0]), up(a[1] + b[1])


def negative(a):
    return -a[1], -a[0]


def mul(a, b):
    p, q, r, s = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    lo, hi = np.minimum(np.minimum(p, q), np.minimum(r, s)), np.maximum(np.maximum(p, q), np.maximum(r, s))
    return down(lo), up(hi)


def inverse(a):
    """1 / a; the whole line where a holds 0."""
    holds = (a[0] <= 0) & (a[1] >= 0)
    one = np.where(holds, 1.0, a[0]), np.where(holds, 1.0, a[1])
    return np.where(holds, -np.inf, down(1.0 / one[1])), np.where(holds, np.inf, up(1.0 / one[0]))


def power(a, n):
    """a to the positive integer power n."""
    if n % 2 == 0:
        a = absolute(a)
    result = a
    for _ in range(n - 1):  # both ends are monotone: n is odd or a >= 0
        result = down(result[0] * np.abs(a[0])), up(result[1] * np.abs(a[1]))
    return result


def absolute(a):
    lo, hi = np.minimum(np.abs(a[0]), np.abs(a[1])), np.maximum(np.abs(a[0]), np.abs(a[1]))
    return np.where((a[0] <= 0) & (a[1] >= 0), 0.0, lo), hi


def sign(a):
    """The slopes of the absolute value."""
    return np.where(a[0] > 0, 1.0, -1.0), np.where(a[1] < 0, -1.0, 1.0)


def hull(a, b):
    return np.minimum(a[0], b[0]), np.maximum(a[1], b[1])


def meet(a, b):
    """What two enclosures of one number leave."""
    return np.maximum(a[0], b[0]), np.minimum(a[1], b[1])


def minimum(a, b):
    return np.minimum(a[0], b[0]), np.minimum(a[1], b[1])


def maximum(a, b):
    return np.maximum(a[0], b[0]), np.maximum(a[1], b[1])


def sin(a):
    return _wave(a, 0)


def cos(a):
    return _wave(a, 1)


def _wave(a, quarter):
    """sin(a + quarter * pi / 2): the values at both ends, and +-1 where a crest may lie between."""
    lo, hi = hull(_at(a[0], quarter), _at(a[1], quarter))
    turn = 4.0 * HALF_PI[0]
    for crest, top in ((1 - quarter, True), (-1 - quarter, False)):
        first = np.ceil((a[0] - crest * HALF_PI[0]) / turn - 1e-9)
        passes = first <= np.floor((a[1] - crest * HALF_PI[0]) / turn + 1e-9)
        lo, hi = (lo, np.where(passes, 1.0, hi)) if top else (np.where(passes, -1.0, lo), hi)
    far = ~((np.abs(a[0]) < TRUSTED) & (np.abs(a[1]) < TRUSTED))
    return np.where(far, -1.0, np.maximum(lo, -1.0)), np.where(far, 1.0, np.minimum(hi, 1.0))


def _at(x, quarter):
    """sin(x + quarter * pi / 2) at doubles: reduced to |r| <= pi / 4, then Taylor's sum with its remainder."""
    x = np.where(np.abs(x) < TRUSTED, x, 0.0)
    k = np.rint(x / HALF_PI[0])
    turned = mul((k, k), HALF_PI)
    r = add((x, x), negative((np.where(k == 0, 0.0, turned[0]), np.where(k == 0, 0.0, turned[1]))))
    r = np.where(k == 0, x, r[0]), np.where(k == 0, x, r[1])
    s, c = _series(r)
    which = (k + quarter) % 4
    lo = np.select([which == 0, which == 1, which == 2], [s[0], c[0], -s[1]], -c[1])
    hi = np.select([which == 0, which == 1, which == 2], [s[1], c[1], -s[0]], -c[0])
    return lo, hi


def _series(r):
    """Sine and cosine of |r| <= 0.8: alternating sums whose remainder is below the first term left out."""
    square, one = power(r, 2), (np.float64(1.0), np.float64(1.0))
    s, c = one, one
    for n in range(9, 0, -1):
        s = add(one, negative(mul(mul(square, number(Fraction(1, 2 * n * (2 * n + 1)))), s)))
        c = add(one, negative(mul(mul(square, number(Fraction(1, 2 * n * (2 * n - 1)))), c)))
    rest = 1e-19  # the first terms left out: 0.8^20 / 20! = 4.8e-21 of the cosine, less of the sine
    return mul(r, (down(s[0] - rest), up(s[1] + rest))), (down(c[0] - rest), up(c[1] + rest))
