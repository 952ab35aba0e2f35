"""Small plants with solutions known by hand."""

from __future__ import annotations

import numpy as np
import sympy as sp

from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.simulation.problem import Problem, build_problem
from simgap.diagnosis.simulation.supermodel import SuperModel, cached_supermodel
from simgap.model.symbolic import Coordinate, NamedParameter, Parameter, SymbolicModel, Variable, symbol


def block(mass: float = 2.0) -> SymbolicModel:
    """A mass on a plane: m a = u."""
    m = symbol("m")
    return SymbolicModel(
        states=(Variable("q", "m"), Variable("v", "m/s")),
        inputs=(Variable("u", "N"),),
        parameters={"m": Parameter(mass, "kg")},
        xdot=(symbol("v"), symbol("u") / m),
        coordinates=(Coordinate("slide", "q", "v", "N"),),
        force_map={"slide": (sp.Integer(0), 1 / m)},
        named_parameters={"mass": NamedParameter("mass", mass, "kg", {"m": m * symbol("ratio")})},
    )


def point_pendulum(mass: float, length: float, inertia: float) -> SymbolicModel:
    """I a = u - m g l sin(q), for a measured pendulum whose angle is 0 when it hangs."""
    names = {"m": (mass, "kg"), "l": (length, "m"), "I": (inertia, "kg*m^2"), "gx": (0.0, "m/s^2")}
    names |= {"gy": (0.0, "m/s^2"), "gz": (-9.81, "m/s^2")}
    q, ratio = symbol("angle"), symbol("ratio")
    m, length_, inertia_, gx, gz = (symbol(n) for n in ("m", "l", "I", "gx", "gz"))
    torque = symbol("torque") + m * length_ * (gz * sp.sin(q) - gx * sp.cos(q))
    return SymbolicModel(
        states=(Variable("angle", "rad"), Variable("rate", "rad/s")),
        inputs=(Variable("torque", "N*m"),),
        parameters={n: Parameter(v, unit) for n, (v, unit) in names.items()},
        xdot=(symbol("rate"), torque / inertia_),
        coordinates=(Coordinate("hinge", "angle", "rate"),),
        force_map={"hinge": (sp.Integer(0), 1 / inertia_)},
        named_parameters={
            "arm.mass": NamedParameter("arm.mass", mass, "kg", {"m": m * ratio, "I": inertia_ * ratio}),
            "arm.com": NamedParameter("arm.com", length, "m", {"l": length_ * ratio}),
            "arm.inertia": NamedParameter("arm.inertia", inertia, "kg*m^2", {"I": inertia_ * ratio}),
        },
        gravity=("gx", "gy", "gz"),
    )


def one_window(
    model: SymbolicModel,
    t: np.ndarray,
    u: np.ndarray,
    h_max: float = 0.01,
    measured: tuple[str, ...] | None = None,
    effects: tuple[str, ...] = (),
) -> tuple[Problem, SuperModel]:
    """A problem whose only window is the whole of a record without noise."""
    measured = measured or model.state_names
    compiled = cached_supermodel(model, measured, effects)
    trace = Trace("only", t, np.zeros((len(t), len(measured))), np.reshape(u, (len(t), -1)))
    windows = Windows(*(np.array([k], dtype=np.int64) for k in (0, len(t), 0)))
    record = Record((trace,), measured, model.input_names)
    return build_problem(compiled, record, windows, np.ones(len(measured))), compiled


def with_effect(compiled: SuperModel, name: str, on: str, **values: float) -> np.ndarray:
    """Theta with one effect switched on."""
    theta, c = compiled.null.copy(), compiled.find(name, on)
    for p, k in zip(c.effect.parameters, c.slots, strict=True):
        theta[k] = values.get(p.symbol, p.null)
    return theta


def stopping(v0: float, friction: float, mass: float, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and speed of a block that slides to rest under dry friction."""
    a = friction / mass
    stop = v0 / a
    s = np.minimum(t, stop)
    return v0 * s - 0.5 * a * s**2, np.maximum(v0 - a * t, 0.0)
