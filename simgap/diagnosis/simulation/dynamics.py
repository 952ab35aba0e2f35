"""The dynamics with all candidate effects as compiled functions: the derivative, and Runge-Kutta steps under it.

They are handed to other compiled code by their address: numba would look up the machine code of a function argument at
each call, for longer than a few windows take to simulate.
Source: Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, sec. II.1; Filippov (1988), sec. 4.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numba import boolean, float64, int64, types, void
from numba.core import cgutils
from numba.extending import intrinsic

from simgap.arrays import Floats, Ints
from simgap.late import sympy as sp
from simgap.model.compile import cached_kernel_as, compile_kernel
from simgap.model.symbolic import SymbolicModel, symbol

VECTOR, MATRIX, INDICES, FLAGS = float64[::1], float64[:, ::1], int64[::1], boolean[::1]
SLOPE_SIGNATURE = void(VECTOR, VECTOR, VECTOR, VECTOR, FLAGS, INDICES, VECTOR)
"""(x, u, constants, signs, stuck, speed, xdot out): xdot, the signs of stuck coordinates solved for (in
place); Gauss-Seidel if several stick at once."""
SLOPE = types.FunctionType(SLOPE_SIGNATURE)
STEP_SIGNATURE = void(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, float64, int64, VECTOR)
"""(x, u, u halfway, u at the end, constants, signs, h, steps, at): steps of length h (s), x in place; (2 nx,) to
work in."""
STEP = types.FunctionType(STEP_SIGNATURE)


def address_of(function: Any, kind: types.FunctionType) -> int:
    """Where the machine code of a compiled function of this kind begins; valid while the function is kept."""
    compiled = function.get_compile_result(kind.signature)
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


@intrinsic
def function_at(typing: Any, kind: Any, address: Any) -> Any:
    """The first-class function of a kind (`numba.types.FunctionType`) at an address (int64)."""
    function = kind.instance_type

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        made = cgutils.create_struct_proxy(function)(context, builder)
        made.jit_addr = builder.inttoptr(arguments[1], context.get_value_type(types.voidptr))
        return made._getvalue()

    return function(kind, address), generate


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The compiled plant.

    Attributes:
        slope: numba, `SLOPE_SIGNATURE`; free: numba, `STEP_SIGNATURE`, while nothing sticks.
        constants: numba (theta) -> tuple, all that they need of the parameters.
        speed: index of each coordinate's velocity: dry friction acts on these.
    """

    slope: Any
    free: Any
    constants: Any
    speed: Ints

    @cached_property
    def addresses(self) -> tuple[int, int]:
        """Of `slope` and `free`."""
        return address_of(self.slope, SLOPE), address_of(self.free, STEP)

    def constants_at(self, theta: Floats) -> Floats:
        """What the dynamics need of the parameters: theta (q,) -> (c,)."""
        return np.array(self.constants(theta), dtype=np.float64)

    def derivative(self, x: Floats, u: Floats, theta: Floats, signs: Floats) -> Floats:
        """Xdot in motion: (nx,), (m,), (q,), the sign of each coordinate's velocity -> (nx,)."""
        out, stuck = np.empty(len(x)), np.zeros(len(self.speed), dtype=np.bool_)
        self.slope(x, u, self.constants_at(theta), signs, stuck, self.speed, out)
        return out


def compile_dynamics(
    plant: SymbolicModel, costly: Sequence[sp.Expr], gate: sp.Expr, theta: tuple[sp.Symbol, ...]
) -> Dynamics:
    """Compile xdot over (x, u, constants, signs): the sign of each coordinate's velocity is an argument of its own.

    Args:
        plant: xdot; costly: terms of it that are only evaluated while `gate`, an expression of theta, is not 0.
    """
    speeds = [symbol(c.velocity) for c in plant.coordinates]
    signs = [symbol(f"sign_{k}") for k in range(len(speeds))]
    swap = {sp.sign(v): s for v, s in zip(speeds, signs, strict=True)}
    swap |= {s: sp.Float(v) for s, v in plant.values().items()}
    nx = len(plant.states)
    split = [sp.sympify(e).xreplace(swap) for e in (*plant.xdot, *costly, gate)]
    exprs, names, inner = hoist(split[:-1], theta)
    groups = ([v.symbol for v in plant.states], [v.symbol for v in plant.inputs], [symbol("gate"), *names], signs)
    main, rest = compile_kernel(exprs[:nx], groups), compile_kernel(exprs[nx:], groups)
    constants = compile_kernel([split[-1], *inner], (theta,))
    index = np.array([plant.state_names.index(c.velocity) for c in plant.coordinates], dtype=np.int64)
    return Dynamics(_slope(main, rest, nx), _free(main, rest, nx), constants, index)


def _slope(main: Any, rest: Any, nx: int) -> Any:
    """Xdot with the signs of what sticks solved for: what they are without a grip, over what a whole one adds."""

    @cached_kernel_as(SLOPE_SIGNATURE)
    def slope(x: Any, u: Any, c: Any, s: Any, stuck: Any, speed: Any, out: Any) -> None:
        gate, count, free = c[0] != 0.0, 0, 0.0
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
                    grip = out[speed[j]] - free
                    s[j] = -free / grip if grip != 0.0 else 0.0
                else:
                    free = out[speed[j]]
        for j in range(speed.size):
            if stuck[j]:
                out[speed[j]] = 0.0

    return slope


def _free(main: Any, rest: Any, nx: int) -> Any:
    """Classical Runge-Kutta steps while nothing sticks, as nearly all of a search are: the dynamics are inlined."""

    @cached_kernel_as(STEP_SIGNATURE)
    def free(x: Any, u: Any, middle: Any, last: Any, c: Any, s: Any, h: Any, steps: Any, at: Any) -> None:
        gate = c[0] != 0.0
        for _ in range(steps):
            for i in range(nx):
                at[i] = x[i]
            for stage in range(4):
                weight = 2.0 if stage == 1 or stage == 2 else 1.0
                ahead = h if stage == 2 else 0.5 * h
                felt = u if stage == 0 else last if stage == 3 else middle
                derivative = main(at, felt, c, s)
                more = rest(at, felt, c, s) if gate else derivative
                for i in range(nx):
                    now = derivative[i] + more[i] if gate else derivative[i]
                    at[nx + i] = now if stage == 0 else at[nx + i] + weight * now
                    at[i] = x[i] + ahead * now
            for i in range(nx):
                x[i] += h / 6.0 * at[nx + i]

    return free


def hoist(
    exprs: Sequence[sp.Expr], parameters: Collection[sp.Symbol]
) -> tuple[list[sp.Expr], list[sp.Symbol], list[sp.Expr]]:
    """Split expressions into a part over new constants and the constants' own expressions over the parameters.

    Returns:
        the rewritten expressions, the constants' symbols, and what each constant is.
    """
    known: dict[sp.Expr, sp.Symbol] = {}
    inner = set(parameters)

    def constant(e: sp.Expr) -> sp.Symbol:
        return known.setdefault(e, symbol(f"hoisted_{len(known)}"))

    @cache
    def symbols(e: sp.Basic) -> set[sp.Basic]:
        return set().union(*map(symbols, e.args)) if e.args else set(e.free_symbols)

    @cache
    def walk(e: sp.Basic) -> sp.Basic:
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
