"""A base that does not stand upright."""

from __future__ import annotations

import math

from simgap.effects.base import PLANT, Effect, EffectParameter, Values
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class GravityTilt(Effect):
    """The whole plant is turned about a horizontal axis, so that gravity points elsewhere in its frame.

    The axis is the world's y axis, or x for a plant that moves in the y-z plane alone.
    """

    name = "gravity_tilt"
    short = "a base tilt"
    long = "a base tilted by {tilt:deg}"
    kind = "plant"
    needs = "gravity that the plant declares"
    formula = "g' = R(-tilt) g, R a rotation about the horizontal axis normal to the plane of motion"
    source = "Siciliano et al. (2009), Robotics, sec. 7.3 (gravity in the base frame)"
    rank = PLANT + 10
    excitation = "swing wider: their forces differ with the angle"
    parameters = (EffectParameter("tilt", "rad", "angle of the base", null=0.0, lower=-math.pi / 2, upper=math.pi / 2),)

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """The plant, if it declares gravity."""
        return ("plant",) if model.gravity is not None else ()

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Rotate the gravity vector in the base frame."""
        gravity = model.gravity or ("", "", "")  # a target was checked: it is declared
        x, y, z = (symbol(name) for name in gravity)
        c, s = sp.cos(values["tilt"]), sp.sin(values["tilt"])
        used = set().union(*(sp.sympify(e).free_symbols for e in model.xdot))
        if x in used or y not in used:  # about y
            return model.substitute({gravity[0]: c * x - s * z, gravity[2]: s * x + c * z})
        return model.substitute({gravity[1]: c * y + s * z, gravity[2]: -s * y + c * z})
