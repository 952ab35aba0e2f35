"""Faster right-hand sides: what depends on parameters alone is computed once a simulation, not at every step."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from simgap.late import sympy as sp


def hoist(
    exprs: Sequence[sp.Expr], parameters: Collection[sp.Symbol], prefix: str = "hoisted"
) -> tuple[list[sp.Expr], list[sp.Symbol], list[sp.Expr]]:
    """Split expressions into a part over new constants and the constants' own expressions over the parameters.

    Returns:
        the rewritten expressions, the constants' symbols, and what each constant is.
    """
    known: dict[sp.Expr, sp.Symbol] = {}
    frees: dict[sp.Basic, set[sp.Basic]] = {}
    walked: dict[sp.Basic, sp.Basic] = {}
    inner = set(parameters)

    def constant(e: sp.Expr) -> sp.Symbol:
        if e not in known:
            known[e] = sp.Symbol(f"{prefix}_{len(known)}", real=True)
        return known[e]

    def symbols(e: sp.Basic) -> set[sp.Basic]:
        if e not in frees:
            frees[e] = set().union(*map(symbols, e.args)) if e.args else set(e.free_symbols)
        return frees[e]

    def walk(e: sp.Basic) -> sp.Basic:
        if e not in walked:
            walked[e] = anew(e)
        return walked[e]

    def anew(e: sp.Basic) -> sp.Basic:
        free = symbols(e)
        if not free & inner or not e.args:
            return constant(e) if free and isinstance(e, sp.Symbol) and e in inner else e
        if isinstance(e, sp.Expr) and free <= inner:
            return constant(e)
        if isinstance(e, sp.Add | sp.Mul):
            alone = [a for a in e.args if symbols(a) <= inner]
            rest = [a for a in e.args if not symbols(a) <= inner]
            if any(symbols(a) for a in alone):
                return e.func(constant(e.func(*alone)), *(walk(a) for a in rest))
        return e.func(*(walk(a) for a in e.args))

    rewritten = [walk(sp.sympify(e)) for e in exprs]
    return rewritten, list(known.values()), list(known)
