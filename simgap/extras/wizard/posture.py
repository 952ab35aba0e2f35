"""A plant around a posture: what rests there, the linear model, and natural sizes of states and inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel

STILL = 1e-6
"""Rate of change that is rest, against the natural size of the state a second."""
PACE = 2.0
"""Rate of a plant whose linear model has none, nothing but masses, 1/s: any pace is as good as another."""
GRAVITY = 9.81


@dataclass(frozen=True, eq=False)
class Posture:
    """Around x0 and u0 with F(x0, u0) = 0: dx/dt = a (x - x0) + b (u - u0).

    Attributes:
        x, u: (n,), (m,). a, b: (n, n), (n, m).
        rate: the fastest of the linear model, 1/s.
        scale: (n,) natural sizes: 1 rad, the length of a pendulum of that rate, and both times the rate for velocities.
        strength: (m,) the inputs that move a state of size `scale` within 1 / rate.
        free: states on which the motion does not depend.
    """

    x: Floats
    u: Floats
    a: Floats
    b: Floats
    rate: float
    scale: Floats
    strength: Floats
    free: tuple[str, ...]


def posture_of(model: SymbolicModel, at: Mapping[str, float]) -> Posture:
    """The posture at which the states have the values `at`, 0 where none is given, with the inputs that hold it.

    Raises:
        UserError: a name that is no state, or a posture that no input holds.
    """
    names, xdot = model.state_names, model.numeric()
    unknown = sorted(set(at) - set(names))
    if unknown:
        raise UserError(f"{unknown} are no states", key="--at", remedy=f"States: {', '.join(names)}.")
    states, inputs = [v.symbol for v in model.states], [v.symbol for v in model.inputs]
    x = np.array([float(at.get(n, 0.0)) for n in names])
    here = dict(zip(states, x, strict=True))
    b = _numbers([[sp.diff(e, s) for s in inputs] for e in xdot], here | dict.fromkeys(inputs, 0.0))
    drift = _numbers([[e] for e in xdot], here | dict.fromkeys(inputs, 0.0))[:, 0]
    u = -np.linalg.lstsq(b, drift, rcond=None)[0] if inputs else np.zeros(0)
    u = np.asarray(np.where(np.abs(u) < STILL, 0.0, u), dtype=np.float64)
    held = here | dict(zip(inputs, u, strict=True))
    a = _numbers([[sp.diff(e, s) for s in states] for e in xdot], held)
    left = _numbers([[e] for e in xdot], held)[:, 0]
    rates = np.abs(np.linalg.eigvals(a))
    rate = float(rates.max()) if rates.max() > STILL else PACE
    scale = _scale(model, rate)
    worst = int(np.argmax(np.abs(left) / scale))
    if abs(left[worst]) > 1e-3 * rate * scale[worst]:
        raise UserError(
            f"no input holds the posture {', '.join(f'{n}={v:g}' for n, v in zip(names, x, strict=True))}: "
            f"{names[worst]} changes by {left[worst]:.3g} {model.states[worst].unit}/s", key="--at",
            remedy="Name one that rests, such as --at q2=3.14159.",
        )  # fmt: skip
    read = set().union(*(sp.sympify(e).free_symbols for e in xdot))
    free = tuple(n for n, s in zip(names, states, strict=True) if s not in read)
    size = np.abs(b / scale[:, None]).max(axis=0)
    return Posture(x, u, a, b, rate, scale, rate / np.where(size > 0, size, 1.0), free)


def _scale(model: SymbolicModel, rate: float) -> Floats:
    units = {v.name: v.unit for v in model.states}
    length = GRAVITY / rate**2
    scale = {n: length if unit in ("m", "m/s") else 1.0 for n, unit in units.items()}
    for c in model.coordinates:
        scale[c.velocity] = scale[c.position] * rate
    return np.array([scale[n] for n in model.state_names])


def _numbers(rows: list[list[sp.Expr]], at: Mapping[sp.Symbol, float]) -> Floats:
    """The expressions there.

    Raises:
        UserError: one that is no finite number there.
    """
    try:
        found = np.array([[float(sp.sympify(e).subs(at)) for e in row] for row in rows], dtype=np.float64)
    except TypeError:
        found = np.array([[np.nan]])
    if not np.isfinite(found).all():
        raise UserError("the model is no finite number at this posture", key="--at", remedy="Name another one.")
    return found.reshape(len(rows), -1)
