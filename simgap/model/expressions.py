"""Expressions that a person writes in a case file, parsed by a whitelist and never evaluated."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Mapping

import sympy as sp

from simgap.errors import UserError
from simgap.model.symbolic import symbol

FUNCTIONS: Mapping[str, sp.Function] = {
    "sin": sp.sin,
    "cos": sp.cos,
    "tan": sp.tan,
    "atan": sp.atan,
    "tanh": sp.tanh,
    "exp": sp.exp,
    "log": sp.log,
    "sqrt": sp.sqrt,
    "abs": sp.Abs,
    "sign": sp.sign,
    "min": sp.Min,
    "max": sp.Max,
}
CONSTANTS: Mapping[str, sp.Expr] = {"pi": sp.pi}
_OPERATORS: Mapping[type[ast.operator], Callable[[sp.Expr, sp.Expr], sp.Expr]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def parse(text: str | float, names: Iterable[str]) -> sp.Expr:
    """The expression `text` over the given names; `^` and `**` are powers.

    Raises:
        UserError: for anything but numbers, the names, + - * / ^ and the functions listed in `FUNCTIONS`.
    """
    known = set(names)
    try:
        tree = ast.parse(str(text).replace("^", "**").strip(), mode="eval")
    except SyntaxError:
        raise UserError(f"'{text}' is not an expression", remedy="Use + - * / ^, numbers and names.") from None
    return _convert(tree.body, known, str(text))


def _convert(node: ast.expr, known: set[str], text: str) -> sp.Expr:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return sp.Integer(node.value) if isinstance(node.value, int) else sp.Float(node.value)
    if isinstance(node, ast.Name):
        return _name(node.id, known, text)
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_convert(node.left, known, text), _convert(node.right, known, text))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner = _convert(node.operand, known, text)
        return -inner if isinstance(node.op, ast.USub) else inner
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        if node.func.id in FUNCTIONS:
            return FUNCTIONS[node.func.id](*(_convert(a, known, text) for a in node.args))
        raise UserError(f"'{text}' calls '{node.func.id}'", remedy=f"Known functions: {', '.join(sorted(FUNCTIONS))}.")
    raise UserError(f"'{text}' is not allowed here", remedy="Use numbers, names, + - * / ^ and the known functions.")


def _name(name: str, known: set[str], text: str) -> sp.Expr:
    if name in known:
        return symbol(name)
    if name in CONSTANTS:
        return CONSTANTS[name]
    raise UserError(f"'{text}' names '{name}', which is not known", remedy=f"Known: {', '.join(sorted(known))}.")
