"""Symbolic dynamics as a Drake system: what a case writes as equations is a plant like any other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel


def symbolic_plant(model: SymbolicModel) -> Any:
    """The model as a `pydrake.systems.primitives.SymbolicVectorSystem` in continuous time.

    States and inputs keep their order, parameters take their declared numbers, the output is what the sensors read.

    Raises:
        UserError: a function in the equations that Drake does not have, or an input that acts with a delay.
    """
    from pydrake.symbolic import Expression, Variable
    from pydrake.systems.primitives import SymbolicVectorSystem

    late = [name for name, seconds in model.delays.items() if seconds != 0]
    if late:
        raise UserError(
            f"the inputs {late} act with a delay, which a SymbolicVectorSystem does not have",
            remedy="Leave the delay out and wire one before the system, such as Drake's DiscreteTimeDelay.",
        )
    states = [Variable(v.name) for v in model.states]
    inputs = [Variable(v.name) for v in model.inputs]
    symbols = [v.symbol for v in (*model.states, *model.inputs)]
    place: dict[sp.Symbol, Any] = dict(zip(symbols, (Expression(v) for v in (*states, *inputs)), strict=True))
    values = model.values()
    readings = [sp.sympify(model.outputs.get(v.name, v.symbol)).subs(values) for v in model.states]
    return SymbolicVectorSystem(
        state=np.array(states),
        input=np.array(inputs),
        dynamics=np.array([to_drake(e, place) for e in model.numeric()]),
        output=np.array([to_drake(e, place) for e in readings]),
    )


def evaluator(
    exprs: Sequence[sp.Expr], x: Sequence[sp.Symbol], u: Sequence[sp.Symbol]
) -> Callable[[Floats, Floats], Floats]:
    """Drake's own numeric evaluation of expressions: a function (n, nx), (n, nu) -> (n, len(exprs)).

    Raises:
        UserError: a function in the expressions that Drake does not have.
    """
    from pydrake.symbolic import Evaluate, Expression, Variable

    variables = [Variable(s.name) for s in (*x, *u)]
    place: dict[sp.Symbol, Any] = dict(zip((*x, *u), (Expression(v) for v in variables), strict=True))
    rows = np.array([to_drake(e, place) for e in exprs])

    def evaluate(states: Floats, inputs: Floats) -> Floats:
        points = np.concatenate([states, inputs], axis=1)
        return np.array([Evaluate(rows, dict(zip(variables, p, strict=True))).ravel() for p in points])

    return evaluate


def to_drake(e: sp.Expr, place: Mapping[sp.Symbol, Any]) -> Any:
    """A SymPy expression as a Drake one; `place` maps its symbols.

    Raises:
        UserError: a symbol without a place, or a function that Drake does not have.
    """
    from pydrake.symbolic import Expression

    e = sp.sympify(e)
    if e.is_number:
        return Expression(float(e))
    if isinstance(e, sp.Symbol):
        if e not in place:
            raise UserError(f"the symbol {e} has no value")
        return place[e]
    parts = [to_drake(a, place) for a in e.args] if not isinstance(e, sp.Piecewise) else []
    if isinstance(e, sp.Add):
        return reduce(lambda a, b: a + b, parts)
    if isinstance(e, sp.Mul):
        return reduce(lambda a, b: a * b, parts)
    functions = _functions()
    if e.func in functions:
        return functions[e.func](*parts)
    raise UserError(
        f"Drake has no function '{e.func.__name__}'", remedy=f"It has {sorted(f.__name__ for f in functions)}."
    )


def _functions() -> dict[Any, Callable[..., Any]]:
    from pydrake import symbolic as drake

    def sign(a: Any) -> Any:
        return drake.if_then_else(a > 0, 1.0, drake.if_then_else(a < 0, -1.0, 0.0))

    def sinc(a: Any) -> Any:
        return drake.if_then_else(a == 0, 1.0, drake.sin(a) / a)

    functions: dict[Any, Callable[..., Any]] = {
        sp.Pow: drake.pow, sp.sin: drake.sin, sp.cos: drake.cos, sp.tan: drake.tan, sp.asin: drake.asin,
        sp.acos: drake.acos, sp.atan: drake.atan, sp.atan2: drake.atan2, sp.exp: drake.exp, sp.log: drake.log,
        sp.sinh: drake.sinh, sp.cosh: drake.cosh, sp.tanh: drake.tanh, sp.Abs: drake.abs, sp.sign: sign, sp.sinc: sinc,
        sp.Min: lambda *a: reduce(drake.min, a), sp.Max: lambda *a: reduce(drake.max, a),
    }  # fmt: skip
    return functions
