"""SymPy expressions as numba kernels, once in floating point and once in outward rounded interval arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.kernel_cache import cached_kernel

Kernel = Callable[..., Any]


def compile_kernel(
    exprs: Sequence[sp.Expr], groups: Sequence[Sequence[sp.Symbol]], before: Sequence[tuple[sp.Symbol, sp.Expr]] = ()
) -> Kernel:
    """A numba function `g(a, b, ...) -> (value, ...)` of one 1-D float64 array for each group of symbols.

    `before`: symbols that later expressions hold, each with its own over the groups' symbols and those before it. A
    chain of minima and maxima that is written out as one expression takes SymPy a second.
    """
    vectors, names = [sp.DeferredVector(f"a{k}") for k in range(len(groups))], [s for s, _ in before]
    rows = _indexed([*(e for _, e in before), *exprs], [*groups, names], [*vectors, names])
    steps, values = [*zip(names, rows, strict=False)], tuple(_floating(e) for e in rows[len(names) :])
    return cached_kernel(sp.lambdify(vectors, values, modules="math", cse=(lambda e: (steps, e)) if steps else True))


def compile_interval_kernel(exprs: Sequence[sp.Expr], groups: Sequence[Sequence[sp.Symbol]]) -> Kernel:
    """A numba function `g(lo_a, hi_a, lo_b, hi_b, ...) -> ((lo, hi), ...)`: an outward rounded enclosure.

    For every point of the boxes [lo_a, hi_a] x [lo_b, hi_b] x ... the exact value of each expression lies in its pair.

    Raises:
        UserError: for a function without an interval version.
    """
    vectors = [sp.DeferredVector(f"a{k}") for k in range(len(groups))]
    ends = [sp.Symbol(f"a{k}_{side}") for k in range(len(groups)) for side in ("lo", "hi")]
    values = tuple(sp.sympify(e) for e in _indexed(exprs, groups, vectors))
    from simgap.model.interval_printer import PRIMITIVES, IntervalPrinter

    printer = IntervalPrinter({"fully_qualified_modules": False, "allow_unknown_functions": True})
    function = sp.lambdify(ends, values, modules=[PRIMITIVES], printer=printer, cse=True)
    return cached_kernel(function)


def _indexed(
    exprs: Sequence[sp.Expr], groups: Sequence[Sequence[sp.Symbol]], vectors: Sequence[Sequence[sp.Expr]]
) -> list[sp.Expr]:
    places = {s: v[i] for group, v in zip(groups, vectors, strict=True) for i, s in enumerate(group)}
    free = set().union(*(sp.sympify(e).free_symbols for e in exprs)) - set(places)
    if free:
        raise UserError(f"an expression holds symbols without a value: {sorted(map(str, free))}")
    return [sp.sympify(e).xreplace(places) for e in exprs]


def _floating(e: sp.Expr) -> sp.Expr:
    """Bare numbers as floats, so that all entries of the tuple have one type; and those that are no int64."""
    if e.is_number:
        return sp.Float(e, 17)
    return e.xreplace({n: sp.Float(n, 17) for n in e.atoms(sp.Rational) if max(abs(n.p), n.q) >= 2**63})
