"""The plants of `rig/counts.py` as they are declared to the diagnosis, and their records."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from simgap.config.plant import PlantSection
from simgap.diagnosis.record.record import Record, Trace
from simgap.model.symbolic import SymbolicModel
from simgap.plants.plant_model import declared_model
from tests.undeclared.rig.counts import PLANTS, Counted, counted_runs, hidden_sizes

Truth = dict[tuple[str, str], dict[str, float]]


def _section(units: tuple[str, str, str, str], force: str, gain: str, **values: tuple[float, str]) -> dict[str, Any]:
    q, v, u, on = units
    return {
        "states": {"q": {"unit": q}, "v": {"unit": v}},
        "inputs": {"u": {"unit": u}},
        "symbolic": {
            "parameters": {n: {"value": x, "unit": unit} for n, (x, unit) in values.items()},
            "dynamics": {"q": "v", "v": f"({force})/({gain})"},
            "coordinates": {"axis": {"position": "q", "velocity": "v", "force_gain": f"1/({gain})", "force_unit": on}},
        },
    }


_EQUATIONS = {
    "ball": _section(("m", "m/s", "rad", "N"), "m*g*sin(u)", "1.4*m", m=(0.11, "kg"), g=(9.81, "m/s^2")),
    "motor": _section(("rad", "rad/s", "A", "N*m"), "K*u", "J", J=(2e-3, "kg*m^2"), K=(0.05, "N*m/A")),
    "spring": _section(("m", "m/s", "N", "N"), "u - d*v - k*q", "m", m=(1.5, "kg"), d=(0.4, "N*s/m"), k=(20.0, "N/m")),
}


@lru_cache(maxsize=8)
def counted_model(name: str) -> SymbolicModel:
    """The declared model of a plant."""
    return declared_model(PlantSection.model_validate(_EQUATIONS[name]), None)


def counted_record(name: str, hidden: str, count: float, seed: int, **more: Any) -> tuple[Record, Truth]:
    """A record by an encoder with steps of `count`, and what is hidden."""
    plant: Counted = PLANTS[name]
    runs = counted_runs(plant, hidden, count, seed, **more)
    told = hidden_sizes(plant, hidden, seed)
    names = {"viscous": ("viscous_friction", "b"), "dry": ("coulomb_friction", "F_c")}
    truth: Truth = {(names[n][0], "axis"): {names[n][1]: size} for n, size in told.items() if size > 0.0}
    traces = tuple(Trace(f"run{k + 1}", t, y, u) for k, (t, y, u) in enumerate(runs))
    return Record(traces, ("q",), ("u",)), truth
