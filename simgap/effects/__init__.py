"""The library of physical effects: one a file, all in `EFFECTS`.

Several effects enter a model in the order of their ranks: plant, forces, sensors, and then the path of a command from
the plant backwards, so that a command is delayed, amplified, shifted, loses its dead zone, is cut and then lags.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from simgap.effects.base import (
    CoordinateEffect,
    Effect,
    EffectParameter,
    InputEffect,
    MemoryInputEffect,
    StaticInputEffect,
)
from simgap.effects.cogging import Cogging
from simgap.effects.coulomb_friction import CoulombFriction
from simgap.effects.cubic_spring import CubicSpring
from simgap.effects.gravity_tilt import GravityTilt
from simgap.effects.input_bias import InputBias
from simgap.effects.input_dead_zone import InputDeadZone
from simgap.effects.input_delay import InputDelay
from simgap.effects.input_gain import InputGain
from simgap.effects.input_lag import InputLag
from simgap.effects.input_saturation import InputSaturation
from simgap.effects.lateral_slip import LateralSlip
from simgap.effects.parameter_error import ParameterError
from simgap.effects.quadratic_drag import QuadraticDrag
from simgap.effects.sensor_offset import SensorOffset
from simgap.effects.spring import Spring
from simgap.effects.stribeck_friction import StribeckFriction
from simgap.effects.viscous_friction import ViscousFriction
from simgap.effects.wheel_mismatch import WheelMismatch
from simgap.errors import UserError
from simgap.model.symbolic import SymbolicModel

__all__ = [
    "EFFECTS",
    "AppliedEffect",
    "CoordinateEffect",
    "Effect",
    "EffectParameter",
    "InputEffect",
    "MemoryInputEffect",
    "StaticInputEffect",
    "apply_effects",
    "effect",
]

_REGISTRY: dict[str, Effect] = {
    e.name: e
    for e in (
        ParameterError(),
        GravityTilt(),
        WheelMismatch(),
        LateralSlip(),
        ViscousFriction(),
        CoulombFriction(),
        StribeckFriction(),
        QuadraticDrag(),
        Spring(),
        CubicSpring(),
        Cogging(),
        SensorOffset(),
        InputLag(),
        InputSaturation(),
        InputDeadZone(),
        InputBias(),
        InputGain(),
        InputDelay(),
    )
}
EFFECTS: Mapping[str, Effect] = MappingProxyType(_REGISTRY)


def effect(name: str) -> Effect:
    """The effect of that name.

    Raises:
        UserError: an unknown name, with the known ones.
    """
    if name not in EFFECTS:
        raise UserError(f"no effect is called '{name}'", remedy=f"Known: {', '.join(EFFECTS)}.")
    return EFFECTS[name]


@dataclass(frozen=True)
class AppliedEffect:
    """An effect with its target and the values of its parameters."""

    name: str
    on: str
    values: Mapping[str, float]


def apply_effects(model: SymbolicModel, applied: Iterable[AppliedEffect]) -> SymbolicModel:
    """The model with several effects, inserted in the order of their ranks, then of the registry.

    Raises:
        UserError: unknown effect or target, missing or unphysical value.
    """
    place = {name: k for k, name in enumerate(EFFECTS)}
    for item in sorted(applied, key=lambda a: (effect(a.name).rank, place[a.name], a.on)):
        model = effect(item.name).apply(model, item.on, item.values)
    return model
