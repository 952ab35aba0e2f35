"""Prints an expression as nested calls of the primitives in `interval`; imported by whoever is about to print."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import reduce

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from simgap.errors import UserError
from simgap.model import interval

PRIMITIVES = {
    name: getattr(interval, name)
    for name in dir(interval)
    if name.startswith("i") and callable(getattr(interval, name))
}


class IntervalPrinter(PythonCodePrinter):
    """Prints an expression as nested calls of the primitives in `interval`."""

    def _print_Symbol(self, expr: sp.Symbol) -> str:
        name = str(expr.name)
        if "[" in name:  # an element of a group: "a0[1]"
            vector, rest = name.split("[")
            return f"({vector}_lo[{rest}, {vector}_hi[{rest})"
        return name

    def _number(self, expr: sp.Expr) -> str:
        value = float(Fraction(int(expr.p), int(expr.q))) if expr.is_Rational else float(expr)
        if sp.Rational(value) == expr or (expr.is_Float and sp.Float(value, 17) == expr):
            return f"({value!r}, {value!r})"
        return f"({math.nextafter(value, -math.inf)!r}, {math.nextafter(value, math.inf)!r})"

    _print_Integer = _print_Float = _print_Rational = _print_Half = _print_Pi = _print_NumberSymbol = _number
    _print_Exp1 = _number
    _print_Zero = _print_One = _print_NegativeOne = _number

    def _nested(self, name: str, args: Sequence[sp.Expr]) -> str:
        return reduce(lambda a, b: f"{name}({a}, {b})", [str(self._print(a)) for a in args])

    def _print_Add(self, expr: sp.Expr, order: str | None = None) -> str:
        return self._nested(f"i{type(expr).__name__.lower()}", expr.args)

    _print_Mul = _print_Max = _print_Min = _print_Add

    def _print_Piecewise(self, expr: sp.Piecewise) -> str:
        return self._nested("ihull", [branch for branch, _ in expr.args])

    def _print_Derivative(self, expr: sp.Derivative) -> str:
        """Any slope at all, for what SymPy cannot differentiate, such as the sign of a quotient."""
        return "iinv((-1.0, 1.0))"

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:
        base, exponent = str(self._print(expr.base)), expr.exp
        if exponent.is_Float and exponent == int(exponent):
            exponent = sp.Integer(int(exponent))
        if exponent == sp.Rational(1, 2):
            return f"isqrt({base})"
        if exponent == -sp.Rational(1, 2):
            return f"iinv(isqrt({base}))"
        if exponent.is_Integer:
            power = base if abs(exponent) == 1 else f"ipow({base}, {abs(int(exponent))})"
            return power if exponent > 0 else f"iinv({power})"
        raise UserError(f"no interval version of the power {expr}", remedy="Use integer powers or sqrt.")

    def _print_Function(self, expr: sp.Function) -> str:
        name = "i" + type(expr).__name__.lower()
        if name not in PRIMITIVES or len(expr.args) != 1:
            raise UserError(f"no interval version of {type(expr).__name__}")
        return f"{name}({self._print(expr.args[0])})"

    def _print_Heaviside(self, expr: sp.Heaviside) -> str:
        return f"iheaviside({self._print(expr.args[0])})"

    _print_sin = _print_cos = _print_tan = _print_tanh = _print_atan = _print_exp = _print_log = _print_Function
    _print_Abs = _print_sign = _print_sinc = _print_DiracDelta = _print_Function
