"""Expressions as nested lists, operation first, with exact numbers: what a certificate holds and any program can read.

A number is the hexadecimal form of a double ('0x1.8p+0') or a fraction of integers ('1/3'); a state or an input is its
name; everything else is a list [operation, argument, ...]. `docs/how-to/certificate.md` describes it for its readers.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from simgap.errors import UserError
from simgap.late import sympy as sp

_OPERATIONS = {"Add": "+", "Mul": "*", "sin": "sin", "cos": "cos", "Abs": "abs", "Min": "min", "Max": "max"}


def prefix(e: Any) -> Any:
    """The expression as nested lists.

    Raises:
        UserError: for what the form does not have; it would need an enclosure in whatever reads it.
    """
    e = sp.sympify(e)
    if e.is_Symbol:
        return str(e.name)
    if e.is_Float:
        return float(e).hex()
    if e.is_Rational:
        return fraction(Fraction(int(e.p), int(e.q)))
    operation = type(e).__name__
    if operation in _OPERATIONS and type(e) is getattr(sp, operation):
        return [_OPERATIONS[operation], *(prefix(part) for part in e.args)]
    if e.is_Pow:
        return _power(e)
    raise UserError(
        f"a certificate has no form for '{type(e).__name__}'", key="plant",
        remedy=f"It has numbers, powers with integers, {', '.join(_OPERATIONS.values())}.",
    )  # fmt: skip


def fraction(value: Fraction) -> str:
    """A number as a double where it is one, else as 'p/q'."""
    nearest = float(value)
    return nearest.hex() if Fraction(nearest) == value else f"{value.numerator}/{value.denominator}"


def _power(e: sp.Pow) -> Any:
    n = e.exp
    if n.is_number and n == int(n) and n != 0:
        base = prefix(e.base) if abs(int(n)) == 1 else ["^", prefix(e.base), abs(int(n))]
        return base if n > 0 else ["/", base]
    raise UserError(f"a certificate has no form for '{e}'", key="plant", remedy="Use powers with integers.")
