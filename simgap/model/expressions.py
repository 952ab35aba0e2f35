"""Expressions that a person writes in a case file: parsed by a whitelist, never evaluated.

The limits below keep what a stranger wrote from taking the machine: each is checked before the work that it bounds.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from simgap.errors import UserError, excerpt
from simgap.late import sympy as sp
from simgap.model.symbolic import no_number, symbol

FUNCTIONS = {name: name for name in ("sin", "cos", "tan", "atan", "tanh", "exp", "log", "sqrt", "sign")} | {
    "abs": "Abs",
    "min": "Min",
    "max": "Max",
}
"""Functions that may be called, and SymPy's names of them."""
SEVERAL = frozenset({"min", "max"})
"""Functions of one or more arguments; all others have exactly one."""
LONGEST = 10_000
"""Characters of an expression."""
MOST_PARTS = 2_000
"""Numbers, names, operators and calls of an expression."""
DEEPEST = 60
"""Brackets, calls and powers within each other."""
LARGEST_POWER = 100
"""Size of an exponent that is a number."""
LARGEST_NUMBER = 1e300
"""Size of a number, written or computed."""
MOST_COMPARED = 16
"""Arguments of all `min` and `max` together: SymPy compares each with each."""
SIMPLE = 50
"""Operations of an argument that SymPy may expand to simplify a function of it."""
CONSTANTS = frozenset({"pi"})
"""Also SymPy's names."""
_OPERATORS: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def parse(text: str | float, names: Iterable[str]) -> sp.Expr:
    """The expression `text` over the given names; `^` and `**` are powers.

    Raises:
        UserError: for anything but numbers, the names, + - * / ^ and the functions listed in `FUNCTIONS`, for what is
            above the limits of this module, and where a part is not a finite real number, such as 1/0 or sqrt(-1).
    """
    text = str(text)
    quoted = f"'{excerpt(text, 60)}'"
    if len(text) > LONGEST:
        raise UserError(f"{quoted} has {len(text)} characters", remedy=f"At most {LONGEST} are allowed.")
    try:
        tree = ast.parse(text.replace("^", "**").strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):  # the last three: digits, null bytes, brackets
        raise UserError(f"{quoted} is not an expression", remedy="Use + - * / ^, numbers and names.") from None
    _check_size(tree, quoted)
    return _whole(_Reader(frozenset(names), quoted).convert(tree), quoted)


def _check_size(tree: ast.expr, quoted: str) -> None:
    """Refuse what is too large; the operands of a chain such as a + b - c stand side by side."""
    todo, parts, compared = [(tree, 0)], 0, 0
    while todo:
        node, depth = todo.pop()
        parts += 1
        if parts > MOST_PARTS:
            raise UserError(f"{quoted} has too many parts", remedy=f"At most {MOST_PARTS} are allowed.")
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in SEVERAL:
            compared += len(node.args)
        if compared > MOST_COMPARED:
            raise UserError(f"{quoted} compares too much", remedy=f"At most {MOST_COMPARED} arguments of min and max.")
        if depth > DEEPEST:
            raise UserError(f"{quoted} is nested too deeply", remedy=f"At most {DEEPEST} levels are allowed.")
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.expr):
                chained = isinstance(node, ast.BinOp) and child is node.left and isinstance(child, ast.BinOp)
                todo.append((child, depth if chained else depth + 1))


@dataclass(frozen=True)
class _Reader:
    known: frozenset[str]
    quoted: str

    def convert(self, node: ast.expr) -> sp.Expr:
        chain = []
        while isinstance(node, ast.BinOp):  # not by recursion: a sum of many terms leans to the left
            chain.append((node.op, node.right))
            node = node.left
        value = self._single(node)
        for op, right in reversed(chain):
            value = self._binary(op, value, self.convert(right))
        return value

    def _single(self, node: ast.expr) -> sp.Expr:
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            if not abs(node.value) <= LARGEST_NUMBER:
                raise self._refused("has a number that is too large", f"At most {LARGEST_NUMBER:g} is allowed.")
            return sp.Integer(node.value) if isinstance(node.value, int) else sp.Float(node.value)
        if isinstance(node, ast.Name):
            return self._name(node.id)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            inner = self.convert(node.operand)
            return -inner if isinstance(node.op, ast.USub) else inner
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            return self._call(node.func.id, node.args)
        raise self._refused("is not allowed here", "Use numbers, names, + - * / ^ and the known functions.")

    def _binary(self, op: ast.operator, left: sp.Expr, right: sp.Expr) -> sp.Expr:
        if type(op) not in _OPERATORS:
            raise self._refused("is not allowed here", "Use numbers, names, + - * / ^ and the known functions.")
        if isinstance(op, ast.Div) and (right.is_zero if right.is_number else right == 0):
            raise self._refused("divides by 0", "Correct it.")
        if not isinstance(op, ast.Pow):
            return _OPERATORS[type(op)](left, right)
        if self._number(right).is_number and not abs(right) <= LARGEST_POWER:
            raise self._refused("has a power that is too large", f"At most {LARGEST_POWER} is allowed.")
        if right.is_number and not right.is_integer:
            self._not_negative(left)
        return self._number(operator.pow(self._number(left), right))

    def _call(self, name: str, arguments: list[ast.expr]) -> sp.Expr:
        if name not in FUNCTIONS:
            raise self._refused(f"calls '{excerpt(name, 40)}'", f"Known functions: {', '.join(sorted(FUNCTIONS))}.")
        if not arguments or (len(arguments) > 1 and name not in SEVERAL):
            wanted = "one argument or more" if name in SEVERAL else "one argument"
            raise self._refused(f"gives {name} {len(arguments)} arguments", f"It takes {wanted}.")
        values = [self._number(self.convert(a)) for a in arguments]
        if name in ("log", "sqrt"):
            self._not_negative(values[0])
        function = getattr(sp, FUNCTIONS[name])
        simple = len(values) > 1 or values[0].is_extended_real or values[0].count_ops() <= SIMPLE
        try:
            return self._number(function(*values) if simple else function(*values, evaluate=False))
        except (TypeError, ValueError):  # SymPy: such as the larger of two things that are not real
            raise self._refused(f"has a {name} that is not a real number", "Correct it.") from None

    def _name(self, name: str) -> sp.Expr:
        if name in self.known:
            return symbol(name)
        if name in CONSTANTS:
            return getattr(sp, name)
        known = excerpt(", ".join(sorted(self.known)), 300)
        raise self._refused(f"names '{excerpt(name, 40)}', which is not known", f"Known: {known}.")

    def _number(self, value: sp.Expr) -> sp.Expr:
        """The value; checked if it is a number, so that no power or function is taken of an infinite or a huge one."""
        if value.is_number and not _is_finite_real(value):
            raise self._refused("has a part that is not a finite real number", "Correct it.")
        return value

    def _not_negative(self, value: sp.Expr) -> None:
        if value.is_extended_negative:  # whatever the names in it stand for
            raise self._refused("has a part that is not a finite real number", "Correct it.")

    def _refused(self, problem: str, remedy: str) -> UserError:
        return UserError(f"{self.quoted} {problem}", remedy=remedy)


def _is_finite_real(value: sp.Expr) -> bool:
    if no_number(value):
        return False
    try:
        number = complex(value.evalf(15))
    except (ArithmeticError, TypeError, ValueError):
        return False
    return number.imag == 0 and abs(number.real) <= LARGEST_NUMBER


def _whole(value: sp.Expr, quoted: str) -> sp.Expr:
    """The value; refused where constants that met made a part not a finite real number, as in sqrt(-1)*x."""
    numbers = all(abs(n) <= LARGEST_NUMBER for n in value.atoms(sp.Number)) if not no_number(value) else False
    if not numbers or (value.is_number and not _is_finite_real(value)):
        raise UserError(f"{quoted} has a part that is not a finite real number", remedy="Correct it.")
    return value
