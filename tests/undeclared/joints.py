"""Joints with one drive as they are declared to the diagnosis, for the rig of `rig/drives.py`."""

from __future__ import annotations

import sympy as sp

from simgap.diagnosis.record.record import Record, Trace
from simgap.model.symbolic import Coordinate, Parameter, SymbolicModel, Variable, symbol
from tests.undeclared.rig import drives

JOINTS = {"arm": (0.25, 1.5, 0.0), "slide": (2.0, 0.0, 0.0), "motor": (0.15, 0.0, 0.0), "oscillator": (1.0, 0.0, 15.0)}
"""Inertia, weight times lever, stiffness of a spring."""


def joint(name: str) -> SymbolicModel:
    """As declared: J a = u - w sin(q) - s q, no friction; no named parameters, so that no other effect is the same."""
    declared = dict(zip(("J", "w", "s"), JOINTS[name], strict=True))
    units = {"J": "kg*m^2", "w": "N*m", "s": "N*m/rad"}
    q, u = symbol("q"), symbol("u")
    pull = sp.Add(*(symbol(n) * f for n, f in (("w", sp.sin(q)), ("s", q)) if declared[n] > 0.0))
    return SymbolicModel(
        states=(Variable("q", "rad"), Variable("v", "rad/s")),
        inputs=(Variable("u", "N*m"),),
        parameters={n: Parameter(v, units[n]) for n, v in declared.items() if v > 0.0},
        xdot=(symbol("v"), (u - pull) / symbol("J")),
        coordinates=(Coordinate("axis", "q", "v"),),
        force_map={"axis": (sp.Integer(0), 1 / symbol("J"))},
    )


def record(name: str, hidden: dict[str, float], seed: int, **more: float) -> Record:
    """A record of the joint with something hidden, its position alone."""
    inertia, weight, stiffness = JOINTS[name]
    data = drives.record(inertia, weight, hidden, seed, stiffness=stiffness, **more)
    return Record(tuple(Trace(f"run{k}", *run) for k, run in enumerate(data)), ("q",), ("u",))
