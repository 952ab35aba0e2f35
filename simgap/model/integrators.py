"""The sampled map `x+ = f(x, u)` of `dx/dt = F(x, u)` over one sampling time, u held, and the path in between."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol

Exprs: TypeAlias = "tuple[sp.Expr, ...]"


def rk4_exprs(x: Sequence[sp.Symbol], xdot: Exprs, h: sp.Expr) -> Exprs:
    """The step written out, one expression a state; its size grows with the fourth power of that of `xdot`."""

    def slope(at: Sequence[sp.Expr]) -> Exprs:
        values = dict(zip(x, at, strict=True))
        return tuple(sp.sympify(e).xreplace(values) for e in xdot)

    k1 = xdot
    k2 = slope([a + h / 2 * k for a, k in zip(x, k1, strict=True)])
    k3 = slope([a + h / 2 * k for a, k in zip(x, k2, strict=True)])
    k4 = slope([a + h * k for a, k in zip(x, k3, strict=True)])
    return tuple(a + h / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True))


def discretise(model: SymbolicModel, tau: float, integrator: str) -> Exprs:
    """The sampled map f, one expression a state over the symbols of states and inputs; parameters are numbers.

    Args:
        model: continuous dynamics.
        tau: sampling time, s.
        integrator: a key of `INTEGRATORS`.

    Raises:
        UserError: unknown integrator, or one that does not fit this plant.
    """
    if integrator not in INTEGRATORS:
        raise UserError(f"no integrator '{integrator}'", remedy=f"Known: {', '.join(INTEGRATORS)}.")
    return INTEGRATORS[integrator](model, model.numeric(), sp.Float(tau))


def explicit_euler(model: SymbolicModel, xdot: Exprs, h: sp.Expr) -> Exprs:
    """x+ = x + h F(x, u): the paper's choice."""
    return tuple(v.symbol + h * f for v, f in zip(model.states, xdot, strict=True))


def semi_implicit_euler(model: SymbolicModel, xdot: Exprs, h: sp.Expr) -> Exprs:
    """Velocities first, positions with the new velocities: PyBullet's own step."""
    if not model.coordinates:
        raise UserError("semi_implicit_euler needs coordinates with velocities", remedy="Use explicit_euler or rk4.")
    rate = {c.position: c.velocity for c in model.coordinates}
    new = {v.name: v.symbol + h * f for v, f in zip(model.states, xdot, strict=True) if v.name not in rate}
    velocities = {symbol(name): new[name] for name in rate.values()}
    moved = {
        v.name: v.symbol + h * f.subs(velocities) for v, f in zip(model.states, xdot, strict=True) if v.name in rate
    }
    return tuple(moved.get(v.name, new.get(v.name)) for v in model.states)


def rk4(model: SymbolicModel, xdot: Exprs, h: sp.Expr) -> Exprs:
    """The classical fourth-order Runge-Kutta step."""
    return rk4_exprs([v.symbol for v in model.states], xdot, h)


def exact_arc(model: SymbolicModel, xdot: Exprs, h: sp.Expr) -> Exprs:
    """The exact solution of a unicycle: an arc of length v h turning by w h (the chord leaves at w h / 2)."""
    wheels = model.wheels
    if wheels is None:
        raise UserError("exact_arc is for a planar wheeled robot", remedy="Declare `plant.wheels` or use rk4.")
    rows = dict(zip(model.state_names, xdot, strict=True))
    heading = symbol(wheels.heading)
    turn = rows[wheels.heading]
    speed = sp.simplify(rows[wheels.x] * sp.cos(heading) + rows[wheels.y] * sp.sin(heading))
    states = {v.symbol for v in model.states}
    slip = sp.simplify(rows[wheels.y] * sp.cos(heading) - rows[wheels.x] * sp.sin(heading))
    if slip != 0 or (speed.free_symbols | turn.free_symbols) & states or len(rows) != 3:
        raise UserError("exact_arc needs x' = v cos(heading), y' = v sin(heading), heading' = w", remedy="Use rk4.")
    chord, bearing = speed * h * sp.sinc(turn * h / 2), heading + turn * h / 2
    new = {
        wheels.x: symbol(wheels.x) + chord * sp.cos(bearing),
        wheels.y: symbol(wheels.y) + chord * sp.sin(bearing),
        wheels.heading: heading + turn * h,
    }
    return tuple(new[name] for name in model.state_names)


INTEGRATORS: Mapping[str, Callable[[SymbolicModel, Exprs, sp.Expr], Exprs]] = {
    "explicit_euler": explicit_euler,
    "semi_implicit_euler": semi_implicit_euler,
    "rk4": rk4,
    "exact_arc": exact_arc,
}


def nominal_paths(
    model: SymbolicModel, integrator: str, tau: float, start: Floats, inputs: Floats, poses: int
) -> tuple[Floats, float]:
    """States after 1/poses, 2/poses, ..., all of tau from one state under each input held.

    Args:
        start: (nx,); inputs: (M, nu).

    Returns:
        (M, poses, nx), and how far the path between two of them may bulge out of the line through them, in state units:
        an eighth of the largest second difference, a tenth more for what second differences miss.
    """
    symbols = [v.symbol for v in (*model.states, *model.inputs)]
    columns = [*start, *inputs.T]
    out = np.empty((len(inputs), poses, len(start)))
    for k in range(poses):
        f = sp.lambdify(symbols, discretise(model, tau * (k + 1) / poses, integrator), "numpy")
        for i, values in enumerate(f(*columns)):
            out[:, k, i] = values
    path = np.concatenate([np.broadcast_to(start, (len(inputs), 1, len(start))), out], axis=1)
    bulge = np.abs(np.diff(path, n=2, axis=1)).max() / 8.0 if poses > 1 else np.abs(np.diff(path, axis=1)).max()
    return out, 1.1 * float(bulge)
