"""Simplified expressions that outlive their process.

Simplifying the equations of a model file takes seconds, and every stage of a case builds its model. What comes out is
kept in the cache folder, under a digest of what went in and of SymPy's version; it is written as a tree of names and
numbers, so that nothing of it is ever run. Only what reads back as the same expression is kept.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from simgap import reading
from simgap.cache import cache_folder, whole_file
from simgap.late import sympy as sp
from simgap.model.symbolic import symbol

_OPERATIONS = frozenset({"Add", "Mul", "Pow", "sin", "cos", "tan"})
_RULE = "1"  # of how it is written here


class _Other(ValueError):
    """An expression with something in it that is not written here."""


def simplified(matrix: sp.Matrix, how: Callable[[sp.Matrix], sp.Matrix], name: str) -> sp.Matrix:
    """`how(matrix)`, from the cache folder if it was made before.

    Args:
        matrix: in symbols as `model.symbolic.symbol` makes them; how: a function of nothing else.
        name: of the function and its version.
    """
    question = f"{_RULE} {sp.__version__} {name} {sp.srepr(matrix)}"
    home = cache_folder()
    path = home / "expressions" / f"{hashlib.sha256(question.encode()).hexdigest()[:32]}.json" if home else None
    known = _read(path) if path else None
    if known is not None:
        return known
    made = how(matrix)
    if path:
        _keep(path, made)
    return made


def _read(path: Path) -> sp.Matrix | None:
    """The matrix of a file; None if it is not there, damaged or from another hand."""
    try:
        digest, body = reading.read_text(path).split("\n", 1)
        if digest != _digest(body):
            return None
        content = json.loads(body)
        return sp.Matrix(*content["shape"], [_expression(e) for e in content["entries"]])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _keep(path: Path, matrix: sp.Matrix) -> None:
    """Write it whole or not at all; without a place to write, nothing is kept."""
    try:
        entries = [_written(e) for e in matrix]
        if [_expression(e) for e in entries] != list(matrix):
            return
        body = json.dumps({"shape": matrix.shape, "entries": entries})
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with whole_file(path) as file:
            file.write(f"{_digest(body)}\n{body}".encode())
    except (_Other, OSError, RecursionError):
        return


def _digest(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()


def _written(e: sp.Expr) -> Any:
    """A symbol as its name, a rational as its two whole numbers, an operation as a list."""
    if e.is_Symbol and e == symbol(e.name):
        return e.name
    if e.is_Rational:
        return {"p": str(e.p), "q": str(e.q)}
    name = type(e).__name__
    if name not in _OPERATIONS or getattr(sp, name) is not type(e):
        raise _Other(name)
    return [name, *(_written(a) for a in e.args)]


def _expression(node: Any) -> sp.Expr:
    if isinstance(node, str):
        return symbol(node)
    if isinstance(node, dict):
        return sp.Rational(int(node["p"]), int(node["q"]))
    if node[0] not in _OPERATIONS:
        raise _Other(node[0])
    return getattr(sp, node[0])(*(_expression(a) for a in node[1:]))
