"""The library of physical effects: one a file, all in `EFFECTS`."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from simgap.effects.base import (
    CoordinateEffect,
    Effect,
    EffectParameter,
    InputEffect,
    StaticInputEffect,
)
from simgap.effects.coulomb_friction import CoulombFriction
from simgap.effects.viscous_friction import ViscousFriction
from simgap.errors import UserError

__all__ = [
    "EFFECTS",
    "CoordinateEffect",
    "Effect",
    "EffectParameter",
    "InputEffect",
    "StaticInputEffect",
    "effect",
]

_ALL: tuple[Effect, ...] = (ViscousFriction(), CoulombFriction())
EFFECTS: Mapping[str, Effect] = MappingProxyType({e.name: e for e in _ALL})


def effect(name: str) -> Effect:
    """The effect of that name.

    Raises:
        UserError: an unknown name, with the known ones.
    """
    if name not in EFFECTS:
        raise UserError(f"no effect is called '{name}'", remedy=f"Known: {', '.join(EFFECTS)}.")
    return EFFECTS[name]
