"""A push that is always there, under whichever name it was found."""

from __future__ import annotations

from collections.abc import Sequence

from simgap.effects.base import AppliedEffect, drives
from simgap.model.symbolic import SymbolicModel

_BEHIND = {"input_dead_zone", "input_saturation", "load_friction", "torque_speed_limit"}
"""What lies between a bias and the plant and makes another thing of it; a gain or a curve comes before, and a constant
passes a lag or a delay as it is."""
_MOTORS = {"joint_elasticity", "backlash", "elasticity_behind_encoder"}
"""A bias then acts on the motor, and a force on the link."""


def steady_biases(model: SymbolicModel, on: str, found: Sequence[AppliedEffect]) -> dict[int, float]:
    """Biases of inputs that reach a coordinate as the same constant force: place among those found -> force."""
    if any(a.name in _MOTORS and a.on == on for a in found):
        return {}
    changed = {a.on for a in found if a.name in _BEHIND}
    return {
        k: a.values["bias"]
        for k, a in enumerate(found)
        if a.name == "input_bias" and a.on not in changed and drives(model, a.on) == on
    }
