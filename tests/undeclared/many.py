"""The plants of `rig/many.py` as they are declared to the diagnosis, and their records."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from simgap.config.plant import PlantSection
from simgap.diagnosis.record.record import Record, Trace
from simgap.model.symbolic import SymbolicModel
from simgap.plants.plant_model import declared_model
from tests.undeclared.counted import Truth, counted_model
from tests.undeclared.nominals import nominal
from tests.undeclared.rig.many import hidden_sizes, many_run

_STAGE: dict[str, Any] = {
    "states": {"q": {"unit": "m"}, "v": {"unit": "m/s"}},
    "inputs": {"u": {"unit": "V"}},
    "symbolic": {
        "parameters": {
            "m": {"value": 1.5, "unit": "kg"}, "k": {"value": 3.937, "unit": "N/V"},
            "d": {"value": 18.6, "unit": "N*s/m"},
        },
        "dynamics": {"q": "v", "v": "(k*u - d*v)/m"},
        "coordinates": {"axis": {"position": "q", "velocity": "v", "force_gain": "1/m", "force_unit": "N"}},
    },
}  # fmt: skip
_NAMES = {
    "viscous": ("viscous_friction", "b"), "dry": ("coulomb_friction", "F_c"), "gain": ("input_gain", "ratio"),
    "bias": ("input_bias", "bias"), "delay": ("input_delay", "delay"), "lag": ("input_lag", "T"),
}  # fmt: skip


@lru_cache(maxsize=8)
def many_model(name: str) -> SymbolicModel:
    """The declared model of a plant."""
    if name == "stage":
        return declared_model(PlantSection.model_validate(_STAGE), None)
    return nominal(name) if name == "cart_pole" else counted_model(name)


def many_record(name: str, hidden: tuple[str, ...], seed: int, seconds: float = 20.0) -> tuple[Record, Truth]:
    """A record with several effects hidden, and what they are."""
    t, y, u = many_run(name, hidden, seed, seconds)
    model = many_model(name)
    on = {True: model.coordinates[0].name, False: model.input_names[0]}
    truth: Truth = {
        (_NAMES[k][0], on[k in ("viscous", "dry")]): {_NAMES[k][1]: size}
        for k, size in hidden_sizes(name, hidden, seed).items()
    }
    measured = tuple(c.position for c in model.coordinates)
    return Record((Trace("run", t, y[:, : len(measured)].copy(), u),), measured, model.input_names), truth
