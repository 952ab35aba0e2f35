"""The plants of `rig/textbook.py` as they are declared to the diagnosis: equations of a case, or a URDF."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from simgap.config.plant import Input, PlantSection, State
from simgap.diagnosis.record.record import Record, Trace
from simgap.model.symbolic import SymbolicModel
from simgap.plants.plant_model import declared_model
from simgap.plants.urdf import load_urdf
from tests.undeclared.rig.textbook import Hidden, Textbook, runs

MODELS = Path(__file__).parents[2] / "configs" / "models"


def _states(units: dict[str, str]) -> dict[str, Any]:
    return {name: {"unit": unit} for name, unit in units.items()}


def _parameters(**values: tuple[float, str]) -> dict[str, Any]:
    return {name: {"value": value, "unit": unit} for name, (value, unit) in values.items()}


EQUATIONS: dict[str, dict[str, Any]] = {
    "dc_motor": {
        "states": _states({"q": "rad", "w": "rad/s", "i": "A"}), "inputs": _states({"V": "V"}),
        "symbolic": {
            "parameters": _parameters(
                J=(0.002, "kg*m^2"), K=(0.05, "N*m/A"), R=(1.0, "ohm"), L=(0.02, "H")
            ),
            "dynamics": {"q": "w", "w": "K*i/J", "i": "(V - R*i - K*w)/L"},
            "coordinates": {"shaft": {"position": "q", "velocity": "w", "force_gain": "1/J"}},
        },
    },
    "oscillator": {
        "states": _states({"q": "m", "v": "m/s"}), "inputs": _states({"u": "N"}),
        "symbolic": {
            "parameters": _parameters(m=(1.5, "kg"), d=(0.4, "N*s/m"), k=(20.0, "N/m")),
            "dynamics": {"q": "v", "v": "(u - d*v - k*q)/m"},
            "coordinates": {"slide": {"position": "q", "velocity": "v", "force_gain": "1/m", "force_unit": "N"}},
        },
    },
    "pendulum": {
        "states": _states({"angle": "rad", "rate": "rad/s"}), "inputs": _states({"torque": "N*m"}),
        "symbolic": {
            "parameters": _parameters(m=(1.0, "kg"), l=(0.5, "m"), I=(0.3, "kg*m^2"), g=(9.81, "m/s^2")),
            "dynamics": {"angle": "rate", "rate": "(torque - m*g*l*sin(angle))/I"},
            "coordinates": {"hinge": {"position": "angle", "velocity": "rate", "force_gain": "1/I"}},
        },
    },
    "cart_pole": {
        "states": _states({"x": "m", "q": "rad", "v": "m/s", "w": "rad/s"}), "inputs": _states({"u": "N"}),
        "symbolic": {
            "parameters": _parameters(M=(1.0, "kg"), m=(0.3, "kg"), l=(0.5, "m"), g=(9.81, "m/s^2")),
            "dynamics": {
                "x": "v", "q": "w",
                "v": "(u + m*sin(q)*(l*w^2 + g*cos(q)))/(M + m*sin(q)^2)",
                "w": "(-u*cos(q) - m*l*w^2*sin(q)*cos(q) - (M + m)*g*sin(q))/(l*(M + m*sin(q)^2))",
            },
            "mass_matrix": [["M + m", "m*l*cos(q)"], ["m*l*cos(q)", "m*l^2"]],
            "coordinates": {
                "cart": {"position": "x", "velocity": "v", "force_unit": "N"},
                "pole": {"position": "q", "velocity": "w"},
            },
        },
    },
    "vtol": {
        "states": _states(
            {"x": "m", "y": "m", "a": "rad", "vx": "m/s", "vy": "m/s", "w": "rad/s"}
        ),
        "inputs": _states({"T": "N", "M": "N*m"}),
        "symbolic": {
            "parameters": _parameters(m=(1.0, "kg"), I=(0.05, "kg*m^2"), g=(9.81, "m/s^2")),
            "dynamics": {
                "x": "vx", "y": "vy", "a": "w", "vx": "-T*sin(a)/m", "vy": "T*cos(a)/m - g", "w": "M/I",
            },
            "mass_matrix": [["m", "0", "0"], ["0", "m", "0"], ["0", "0", "I"]],
            "coordinates": {
                "x": {"position": "x", "velocity": "vx", "force_unit": "N"},
                "y": {"position": "y", "velocity": "vy", "force_unit": "N"},
                "a": {"position": "a", "velocity": "w"},
            },
        },
    },
    "wheeled": {
        "states": _states({"x": "m", "y": "m", "theta": "rad"}), "inputs": _states({"v": "m/s", "w": "rad/s"}),
        "symbolic": {
            "dynamics": {"x": "v*cos(theta)", "y": "v*sin(theta)", "theta": "w"},
            "wheels": {"x": "x", "y": "y", "heading": "theta", "linear": "v", "angular": "w", "track": 0.23},
        },
    },
}  # fmt: skip
URDFS = {
    "cart_pole_urdf": ("cart_pole.urdf", {"x": "rail", "a": "hinge"}, ("v", "w"), {"F": ("rail", "N")}),
    "two_link": (
        "double_pendulum.urdf", {"q1": "shoulder", "q2": "elbow"}, ("v1", "v2"),
        {"u1": ("shoulder", "N*m"), "u2": ("elbow", "N*m")},
    ),
}  # fmt: skip


@lru_cache(maxsize=16)
def nominal(name: str) -> SymbolicModel:
    """The declared model of a plant."""
    if name in EQUATIONS:
        return declared_model(PlantSection.model_validate(EQUATIONS[name]), None)
    file, joints, speeds, inputs = URDFS[name]
    units = {q: "m" if joint == "rail" else "rad" for q, joint in joints.items()}
    states = {q: State(joint=joint, quantity="position", unit=units[q]) for q, joint in joints.items()}
    states |= {
        v: State(joint=joint, quantity="velocity", unit=f"{units[q]}/s")
        for v, (q, joint) in zip(speeds, joints.items(), strict=True)
    }
    own = {u: Input(joint=joint, unit=unit) for u, (joint, unit) in inputs.items()}
    return load_urdf(MODELS / file, states, own)


def record(plant: Textbook, hidden: Hidden, seed: int, **more: float) -> Record:
    """A record of a plant with something hidden, as a recorder without faults writes it."""
    made = runs(plant, hidden, seed, **more)
    traces = tuple(Trace(f"run{k + 1}", t, np.ascontiguousarray(y), u) for k, (t, y, u) in enumerate(made))
    return Record(traces, plant.measured, plant.inputs)
