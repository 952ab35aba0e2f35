"""Ranges of expressions over a box, with a bound of the rounding of their floating-point evaluation.

An `Enclosure` (lo, hi, error) of an expression over a box says two things: the exact value lies in [lo, hi] at every
point of the box, and evaluating the expression in double precision, with sums and products in any order, is off by at
most `error`. The second is a running error analysis (Higham, Accuracy and Stability of Numerical Algorithms,
section 3.3) over the expression tree, with magnitudes from the first; it is computed once for a basis and makes
rounding outward cost one addition afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce

from simgap.errors import UserError
from simgap.late import interpreted
from simgap.late import sympy as sp
from simgap.model import interval as compiled

interval = interpreted(compiled)  # a few calls are no reason to wait for a compiler
_UNIT = 2.0**-52  # twice the unit roundoff: covers second-order terms
_LIBM = 2.0**-49  # library functions, a few units in the last place
_LITERAL = 2.0**-46  # generated code may print a literal to 15 digits only
_TINY = 1e-300
_FINITE = "Leave out of X where it is not, or write it in terms that are finite everywhere."
_KNOWN = "Use powers, sin, cos, tan, atan, tanh, exp, log, sqrt."

_MONOTONE_SLOPE = {"sin": 1.0, "cos": 1.0, "tanh": 1.0, "atan": 1.0, "sign": 0.0, "Abs": 1.0}


@dataclass(frozen=True)
class Enclosure:
    """Range [lo, hi] of exact values and bound `error` of the rounding of the computed ones."""

    lo: float
    hi: float
    error: float = 0.0

    @property
    def magnitude(self) -> float:
        """Largest absolute exact value."""
        return max(abs(self.lo), abs(self.hi))

    @property
    def pair(self) -> tuple[float, float]:
        """(lo, hi)."""
        return self.lo, self.hi


def enclose(expr: sp.Expr, box: Mapping[sp.Symbol, tuple[float, float]]) -> Enclosure:
    """Range and rounding of `expr` over `box` (symbol -> (lower, upper)).

    Raises:
        UserError: where the expression is not finite on the box, or holds a function without an interval version.
    """
    result = _visit(sp.sympify(expr), box)
    if not (math.isfinite(result.lo) and math.isfinite(result.hi) and math.isfinite(result.error)):
        raise UserError(f"'{expr}' is not shown to be bounded on the state and input sets", remedy=_FINITE)
    return result


def _visit(e: sp.Expr, box: Mapping[sp.Symbol, tuple[float, float]]) -> Enclosure:
    if e.is_Symbol:
        if e not in box:
            raise UserError(f"'{e}' is neither a state nor an input")
        lo, hi = box[e]
        return Enclosure(float(lo), float(hi))
    if e.is_number:
        return _number(e)
    parts = [_visit(a, box) for a in e.args]
    if e.is_Add:
        return _add(parts)
    if e.is_Mul:
        return _product(parts)
    if e.is_Pow:
        return _pow(e, parts[0])
    if isinstance(e, sp.Min | sp.Max):
        return _extreme(e, parts)
    return _function(e, parts)


def _number(e: sp.Expr) -> Enclosure:
    value = float(e)
    if e.is_Integer and abs(int(e)) <= 2**53:
        return Enclosure(value, value)
    slack = abs(value) * _LITERAL + _TINY
    return Enclosure(value - slack, value + slack, slack)


def _add(parts: list[Enclosure]) -> Enclosure:
    size = sum(p.magnitude + p.error for p in parts)
    error = sum(p.error for p in parts) + len(parts) * _UNIT * size
    return Enclosure(*reduce(interval.iadd, [p.pair for p in parts]), error)


def _product(parts: list[Enclosure]) -> Enclosure:
    total = parts[0]
    for p in parts[1:]:
        a, b = total.magnitude, p.magnitude
        error = a * p.error + b * total.error + total.error * p.error
        error += _UNIT * (a + total.error) * (b + p.error) + _TINY
        lo, hi = interval.imul(total.pair, p.pair)
        total = Enclosure(lo, hi, error)
    return total


def _pow(e: sp.Pow, base: Enclosure) -> Enclosure:
    exponent = e.exp
    if exponent.is_Float and exponent == int(exponent):
        exponent = sp.Integer(int(exponent))
    if not exponent.is_Integer and (2 * exponent).is_Integer:
        base, exponent = _sqrt(e, base), 2 * exponent
    if not exponent.is_Integer:
        raise UserError(f"'{e}' has a power without an interval version", remedy="Use integer powers or sqrt.")
    n = abs(int(exponent))
    size = base.magnitude + base.error
    error = n * size ** (n - 1) * base.error + 4.0 * n * _UNIT * size**n + _TINY
    lo, hi = interval.ipow(base.pair, n)
    power = Enclosure(lo, hi, error)
    return power if exponent > 0 else _inverse(e, power)


def _inverse(e: sp.Expr, a: Enclosure) -> Enclosure:
    lo, hi = interval.iinv(a.pair)
    nearest = min(abs(a.lo), abs(a.hi)) - a.error
    if not math.isfinite(lo) or nearest <= 0.0:
        raise UserError(f"'{e}' divides by what may be 0 on the state and input sets", remedy=_FINITE)
    return Enclosure(lo, hi, a.error / nearest**2 + _UNIT / nearest)


def _sqrt(e: sp.Expr, a: Enclosure) -> Enclosure:
    if a.lo < 0.0:
        raise UserError(f"'{e}' takes the root of what may be negative on the state and input sets", remedy=_FINITE)
    lo, hi = interval.isqrt(a.pair)
    error = math.sqrt(a.error) if a.lo <= a.error else a.error / math.sqrt(a.lo - a.error)
    return Enclosure(lo, hi, error + _LIBM * hi)


def _extreme(e: sp.Expr, parts: list[Enclosure]) -> Enclosure:
    join = interval.imin if isinstance(e, sp.Min) else interval.imax
    return Enclosure(*reduce(join, [p.pair for p in parts]), max(p.error for p in parts))


def _function(e: sp.Expr, parts: list[Enclosure]) -> Enclosure:
    name = type(e).__name__
    primitive = getattr(interval, "i" + name.lower(), None)
    if primitive is None or len(parts) != 1:
        raise UserError(f"'{e}' has no interval version", remedy=_KNOWN)
    a = parts[0]
    try:
        lo, hi = (float(v) for v in primitive(a.pair))
    except (OverflowError, ValueError):  # of Python, where compiled code has an infinity
        lo, hi = -math.inf, math.inf
    if name == "sign" and a.error > 0.0 and a.lo <= a.error and a.hi >= -a.error:
        return Enclosure(lo, hi, 2.0)  # a rounded argument may fall on the other side of the jump
    if name in _MONOTONE_SLOPE:
        slope = _MONOTONE_SLOPE[name]
    elif name == "exp":
        slope = hi * math.exp(min(a.error, 1.0)) if a.error <= 1.0 else math.inf
    elif name == "tan":
        slope = 2.0 * (1.0 + max(abs(lo), abs(hi)) ** 2)
    elif name == "log" and a.lo > a.error:
        slope = 1.0 / (a.lo - a.error)
    else:
        raise UserError(f"'{e}' is not shown to be bounded on the state and input sets", remedy=_FINITE)
    return Enclosure(lo, hi, slope * a.error + _LIBM * max(abs(lo), abs(hi)) + _TINY)
