"""Largest and smallest of expressions that are taken as they are written.

Whenever a symbol in it is replaced, SymPy asks anew whether one argument of a `Max` or `Min` is always the larger, for
most of the time that building a model with every candidate takes; of what acts between a command and a plant none is.
"""

from __future__ import annotations

from typing import Any

import sympy as sp


class Max(sp.Max):
    """`sympy.Max`, its arguments not compared; of the same name, by which printers know it."""

    def __new__(cls, *args: Any, **assumptions: Any) -> Any:
        """As `Max(*args, evaluate=False)`, also where SymPy builds it again."""
        return super().__new__(cls, *args, **(assumptions | {"evaluate": False}))


class Min(sp.Min):
    """`sympy.Min`, its arguments not compared; of the same name, by which printers know it."""

    def __new__(cls, *args: Any, **assumptions: Any) -> Any:
        """As `Min(*args, evaluate=False)`, also where SymPy builds it again."""
        return super().__new__(cls, *args, **(assumptions | {"evaluate": False}))


_LAZY = {sp.Max: Max, sp.Min: Min}


def lazily(e: sp.Expr) -> sp.Expr:
    """The expression with every `Max` and `Min` as one that is not asked again."""
    if not e.has(sp.Max, sp.Min):
        return e
    return e.replace(lambda part: type(part) in _LAZY, lambda part: _LAZY[type(part)](*part.args))
