"""Dimensions of expressions: whether what is added is of one kind, and whether a rate is what its state has a second.

A number that stands in an equation may carry a unit that is not written (9.81, 0.01): what it multiplies is of any
dimension. Small whole numbers and their quotients are pure.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from simgap.late import sympy as sp
from simgap.model.symbolic import kinds
from simgap.units import PURE, Dimension, dimension

_PURE_NUMBERS = frozenset(Fraction(a, b) for a in range(-6, 7) for b in (1, 2, 3, 4, 6, 12))
_OF_PURE = "sin cos tan asin acos atan exp log sinh cosh tanh"
_LIKE_ITS_TERMS = "Add Abs Min Max"
_PURE_RESULT = "sign atan2 Heaviside"


class Mismatch(ValueError):
    """Dimensions that do not fit together, in words."""


def of_expression(expr: sp.Expr, known: Mapping[str, Dimension]) -> Dimension | None:
    """Dimension of an expression; None where a number of unknown unit decides it.

    Args:
        expr: in symbols; known: their dimensions by name.

    Raises:
        Mismatch: for a sum of different dimensions, or a sine or exponential of something that is no pure number.
    """
    if expr.is_Symbol:
        return known.get(str(expr))
    if expr.is_number:
        return PURE if expr.is_Rational and Fraction(int(expr.p), int(expr.q)) in _PURE_NUMBERS else None
    if isinstance(expr, kinds(_LIKE_ITS_TERMS)):
        return _alike(expr.args, known)
    if isinstance(expr, sp.Mul):
        return _product([of_expression(a, known) for a in expr.args])
    if isinstance(expr, sp.Pow) and not isinstance(expr, sp.exp):
        return _power(expr, known)
    if isinstance(expr, kinds(_OF_PURE)):
        inner = of_expression(expr.args[0], known)
        if inner is not None and inner != PURE:
            raise Mismatch(f"{expr.func.__name__}({expr.args[0]}) is taken of {inner}")
        return PURE
    if isinstance(expr, sp.Piecewise):
        return _alike([value for value, _ in expr.args], known)
    for a in expr.args:
        if isinstance(a, sp.Expr):
            of_expression(a, known)
    return PURE if isinstance(expr, kinds(_PURE_RESULT)) else None


def rate_mismatch(expr: sp.Expr, unit: str, known: Mapping[str, Dimension]) -> str:
    """Fault of the equation of a state in a unit, in words; "" if there is none.

    Args:
        expr: the rate of change; unit: of the state; known: dimensions of all symbols.
    """
    try:
        found = of_expression(expr, known)
    except Mismatch as wrong:
        return str(wrong)
    own = dimension(unit)
    wanted = own.over(dimension("s"))
    pure = found == own == PURE  # an equation in pure numbers, the second in the ones that stand in it
    return "" if pure or found in (None, wanted) else f"gives {found}, and the state changes by {wanted}"


def _alike(terms: Any, known: Mapping[str, Dimension]) -> Dimension | None:
    """The one dimension of all terms that have one."""
    first: tuple[sp.Expr, Dimension] | None = None
    for term in terms:
        own = of_expression(term, known)
        if own is None:
            continue
        if first is not None and own != first[1]:
            raise Mismatch(f"adds '{first[0]}' ({first[1]}) and '{term}' ({own})")
        first = first or (term, own)
    return first[1] if first else None


def _product(factors: list[Dimension | None]) -> Dimension | None:
    out = PURE
    for own in factors:
        if own is None:
            return None
        out = out.times(own)
    return out


def _power(expr: sp.Pow, known: Mapping[str, Dimension]) -> Dimension | None:
    base, exponent = expr.as_base_exp()
    inner = of_expression(base, known)
    if inner is None or inner == PURE:
        return inner
    return inner.to_the(float(exponent)) if exponent.is_number else None
