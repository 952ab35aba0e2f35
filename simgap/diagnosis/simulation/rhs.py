"""The dynamics with all candidate effects as one compiled first-class function."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.arrays import Ints
from simgap.diagnosis.simulation.runge_kutta import GLIDE_SIGNATURE, RHS_SIGNATURE, SLOPE_SIGNATURE
from simgap.late import sympy as sp
from simgap.model.compile import compile_kernel
from simgap.model.kept import kept_as
from simgap.model.symbolic import SymbolicModel, kinds, symbol

_TRANSCENDENTAL = "sin cos tan tanh atan exp log"


@dataclass(frozen=True)
class Costly:
    """Terms of xdot that are only evaluated while `gate` (an expression of the parameters) is not 0."""

    xdot: tuple[sp.Expr, ...]
    gate: sp.Expr


@dataclass(frozen=True, eq=False)
class Dynamics:
    """`rhs` of signature `RHS_SIGNATURE`, whose parameters are what `constants` (theta -> tuple) returns.

    `slope`: the same with what sticks, of signature `SLOPE_SIGNATURE`; `glide`: steps under it, of signature
    `GLIDE_SIGNATURE`; `speed` holds the index of each coordinate's velocity.
    """

    rhs: Any
    slope: Any
    glide: Any
    constants: Any
    speed: Ints


def is_costly(force: sp.Expr) -> bool:
    """Whether a term is worth skipping while it is switched off."""
    return bool(force.has(*kinds(_TRANSCENDENTAL)))


def compile_dynamics(plant: SymbolicModel, costly: Costly, theta: tuple[sp.Symbol, ...]) -> Dynamics:
    """Compile xdot over (x, u, constants, signs): the sign of each coordinate's velocity is an argument of its own."""
    speeds = [symbol(c.velocity) for c in plant.coordinates]
    signs = [symbol(f"sign_{k}") for k in range(len(speeds))]
    swap = {sp.sign(v): s for v, s in zip(speeds, signs, strict=True)}
    swap |= {s: sp.Float(v) for s, v in plant.values().items()}
    nx = len(plant.states)
    split = [sp.sympify(e).xreplace(swap) for e in (*plant.xdot, *costly.xdot, costly.gate)]
    exprs, names, inner = hoist(split[:-1], theta)
    groups = ([v.symbol for v in plant.states], [v.symbol for v in plant.inputs], [symbol("gate"), *names], signs)
    main, rest = compile_kernel(exprs[:nx], groups), compile_kernel(exprs[nx:], groups)
    constants = compile_kernel([split[-1], *inner], (theta,))

    @kept_as(RHS_SIGNATURE)
    def rhs(x: Any, u: Any, c: Any, s: Any, out: Any) -> None:
        derivative = main(x, u, c, s)
        for i in range(nx):
            out[i] = derivative[i]
        if c[0] != 0.0:
            more = rest(x, u, c, s)
            for i in range(nx):
                out[i] += more[i]

    index = [plant.state_names.index(c.velocity) for c in plant.coordinates]
    glide = _glide(main, rest, nx, len(plant.inputs))
    return Dynamics(rhs, _slope(main, rest, nx), glide, constants, np.array(index, dtype=np.int64))


def _slope(main: Any, rest: Any, nx: int) -> Any:
    """Xdot with the signs of what sticks solved for: what they are without a grip, over what a whole one adds."""

    @kept_as(SLOPE_SIGNATURE)
    def slope(x: Any, u: Any, c: Any, s: Any, stuck: Any, speed: Any, out: Any, scratch: Any) -> None:
        gate, count = c[0] != 0.0, 0
        for j in range(speed.size):
            if stuck[j]:
                count += 1
        turns = speed.size * (1 if count < 2 else 4) if count else 0
        for turn in range(2 * turns + 1):  # free and gripped for each coordinate in turn, and once for the answer
            j = (turn // 2) % speed.size if turn < 2 * turns else 0
            if turn < 2 * turns:
                if not stuck[j]:
                    continue
                s[j] = 1.0 if turn % 2 else 0.0
            derivative = main(x, u, c, s)
            for i in range(nx):
                out[i] = derivative[i]
            if gate:
                more = rest(x, u, c, s)
                for i in range(nx):
                    out[i] += more[i]
            if turn < 2 * turns:
                if turn % 2:
                    free = scratch[0]
                    grip = out[speed[j]] - free
                    s[j] = -free / grip if grip != 0.0 else 0.0
                else:
                    scratch[0] = out[speed[j]]
        for j in range(speed.size):
            if stuck[j]:
                out[speed[j]] = 0.0

    return slope


def _glide(main: Any, rest: Any, nx: int, m: int) -> Any:
    """Classical Runge-Kutta steps, the dynamics inlined: a first-class call a stage would cost five times as much."""

    @kept_as(GLIDE_SIGNATURE)
    def glide(x: Any, u: Any, middle: Any, last: Any, c: Any, s: Any, h: Any, steps: Any, at: Any, v: Any) -> None:
        gate = c[0] != 0.0
        for _ in range(steps):
            for i in range(nx):
                at[i] = x[i]
            for stage in range(4):
                weight = 2.0 if stage == 1 or stage == 2 else 1.0
                ahead = h if stage == 2 else 0.5 * h
                for j in range(m):
                    v[j] = u[j] if stage == 0 else last[j] if stage == 3 else middle[j]
                slope = main(at, v, c, s)
                more = rest(at, v, c, s) if gate else slope
                for i in range(nx):
                    k = slope[i] + more[i] if gate else slope[i]
                    at[nx + i] = k if stage == 0 else at[nx + i] + weight * k
                    at[i] = x[i] + ahead * k
            for i in range(nx):
                x[i] += h / 6.0 * at[nx + i]

    return glide


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
