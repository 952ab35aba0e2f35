"""The plants of `drive_library.py`: as they are declared, records of them, and where their parts are to be found."""

from __future__ import annotations

import numpy as np
from drive_kinds import ROBOTS

from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.model.symbolic import SymbolicModel
from tests.effects.plants import unicycle
from tests.undeclared import nominals
from tests.undeclared.joints import joint, record
from tests.undeclared.plant import pendulum
from tests.undeclared.rig import drives, robot
from tests.undeclared.rig.textbook import PLANTS as TEXTBOOK
from tests.undeclared.rig.textbook import Hidden

FREE = {"two_link": "elbow", "cart_pole": "pole", "cart_pole_urdf": "hinge"}
"""Plants of two coordinates, and the one on which something is hidden."""
PLANTS = ("arm", "motor", "oscillator", "slide", "rod", *FREE, *ROBOTS)
_PLACES = {
    "rod": {"parameter_error": ""},
    "two_link": {"payload": "lower", "parameter_error": "lower.mass"},
}
_ON_COORDINATES = ("constant_force", "viscous_friction", "reflected_inertia")
Made = tuple[SymbolicModel, Record, DiagnosisSettings]


def made_on(plant: str, told: dict[str, float], seed: int) -> Made:
    """The plant as declared, a record of it, and how long its windows are."""
    if plant in ROBOTS:
        return _driven(told, seed, plant == "robot")
    if plant in FREE:
        made = nominals.record(TEXTBOOK[plant](), _hidden(told, FREE[plant]), seed)
        return nominals.nominal(plant), made, DiagnosisSettings()
    if plant == "rod":
        return pendulum(), _rod(told, seed), DiagnosisSettings()
    return joint(plant), record(plant, told, seed), DiagnosisSettings()


def label(plant: str, name: str, on: str) -> str:
    """An effect by its name, with the place where that is not the one at which it is hidden."""
    places = _PLACES.get(plant, {})
    if plant in FREE:
        places = places | dict.fromkeys(_ON_COORDINATES, FREE[plant])
    return name if places.get(name, on) == on else f"{name} on {on}"


def _driven(told: dict[str, float], seed: int, heading: bool) -> Made:
    runs = robot.record(told, np.random.default_rng([seed, 83]), heading)
    traces = tuple(Trace(f"run{k}", *run) for k, run in enumerate(runs))
    measured = ("px", "py", "heading") if heading else ("px", "py")
    settings = DiagnosisSettings(window_s=2.0, horizon_s=2.0)
    return unicycle(robot.TRACK), Record(traces, measured, ("speed", "turn")), settings


def _rod(told: dict[str, float], seed: int) -> Record:
    """The rod of the URDF, 1 kg and 1 m, with what it may carry."""
    told = dict(told)
    mass, place = told.pop("payload", 0.0), told.pop("place", 0.0)
    data = drives.record(1.0 / 3.0 + mass * place**2, 9.81 * (0.5 + mass * place), told, seed)
    return Record(tuple(Trace(f"run{k}", *run) for k, run in enumerate(data)), ("angle",), ("torque",))


def _hidden(told: dict[str, float], on: str) -> Hidden:
    """As the rig of textbook plants is told it."""
    push = told.get("push", 0.0)
    return Hidden(
        viscous={on: told.get("viscous", 0.0)},
        factors={n: told[n] for n in ("payload", "m2", "armature") if n in told},
        more={on: lambda q, v: push},
    )
