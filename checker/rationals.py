"""The arithmetic of `intervals` in exact rational numbers, one interval at a time: a pair (lo, hi) of Fractions.

Only sine and cosine are not rational: their ends are cut outward after `BITS` binary places.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil, floor

BITS = 160
# pi to 50 places: 3.14159265358979323846264338327950288419716939937510|58...
_PI = 314159265358979323846264338327950288419716939937510
HALF_PI = (Fraction(_PI, 2 * 10**50), Fraction(_PI + 1, 2 * 10**50))
_LINE = (Fraction(-(10**30)), Fraction(10**30))


def number(value):
    return value, value


def add(a, b):
    return a[0] + b[0], a[1] + b[1]


def negative(a):
    return -a[1], -a[0]


def mul(a, b):
    products = [x * y for x in a for y in b]
    return min(products), max(products)


def inverse(a):
    """1 / a; where a holds 0 so wide that no box can hold it."""
    return _LINE if a[0] <= 0 <= a[1] else (1 / a[1], 1 / a[0])


def power(a, n):
    if n % 2 == 0:
        a = absolute(a)
    return a[0] ** n, a[1] ** n


def absolute(a):
    ends = sorted((abs(a[0]), abs(a[1])))
    return (Fraction(0) if a[0] <= 0 <= a[1] else ends[0]), ends[1]


def sign(a):
    return Fraction(1 if a[0] > 0 else -1), Fraction(-1 if a[1] < 0 else 1)


def hull(a, b):
    return min(a[0], b[0]), max(a[1], b[1])


def meet(a, b):
    return max(a[0], b[0]), min(a[1], b[1])


def minimum(a, b):
    return min(a[0], b[0]), min(a[1], b[1])


def maximum(a, b):
    return max(a[0], b[0]), max(a[1], b[1])


def sin(a):
    return _wave(a, 0)


def cos(a):
    return _wave(a, 1)


def _wave(a, quarter):
    lo, hi = hull(_at(a[0], quarter), _at(a[1], quarter))
    for crest, top in ((1 - quarter, True), (-1 - quarter, False)):
        near = [(end - crest * HALF_PI[0]) / (4 * HALF_PI[0]) for end in a]
        if ceil(near[0] - Fraction(1, 10**9)) <= floor(near[1] + Fraction(1, 10**9)):
            lo, hi = (lo, Fraction(1)) if top else (Fraction(-1), hi)
    return max(lo, Fraction(-1)), min(hi, Fraction(1))


def _at(x, quarter):
    k = round(x / HALF_PI[0])
    r = add((x, x), negative(mul((Fraction(k), Fraction(k)), HALF_PI)))
    r = _cut(r)
    s, c = _series(r, 1), _series(r, 0)
    return ((s, c, negative(s), negative(c)))[(k + quarter) % 4]


def _series(r, first):
    """Taylor's alternating sum of sine (first power 1) or cosine (0) on |r| < 0.8, with its remainder."""
    square = power(r, 2)
    total, term = (Fraction(0), Fraction(0)), ((Fraction(1), Fraction(1)) if first == 0 else r)
    n = first
    for _ in range(16):
        total = add(total, term)
        n += 2
        term = _cut(negative(mul(mul(term, square), number(Fraction(1, n * (n - 1))))))
    rest = max(abs(term[0]), abs(term[1]))
    return _cut((total[0] - rest, total[1] + rest))


def _cut(a):
    return Fraction(floor(a[0] * 2**BITS), 2**BITS), Fraction(ceil(a[1] * 2**BITS), 2**BITS)
