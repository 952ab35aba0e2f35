"""What a joint may lack, as columns: the torque that a measured motion takes beyond the rigid bodies, for a parameter
of 1. Names and symbols are those of the library of effects, which has formula, source and limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats

Column = Callable[[Floats, Floats, Floats], Floats]


@dataclass(frozen=True)
class Term:
    """An effect with one number that enters linearly.

    Attributes:
        effect, symbol: as in the library; of_input: whether it is on the joint's input, else on the joint.
        column: (velocity, direction, acceleration), (N,) each -> (N,) torque for a parameter of 1; direction is the
            sign of the velocity, and between -1 and 1 at rest.
    """

    effect: str
    symbol: str
    of_input: bool
    column: Column


TERMS: Mapping[str, Term] = {
    t.effect: t
    for t in (
        Term("viscous_friction", "b", False, lambda v, way, a: v),
        Term("coulomb_friction", "F_c", False, lambda v, way, a: way),
        Term("quadratic_drag", "c", False, lambda v, way, a: v * np.abs(v)),
        Term("reflected_inertia", "I", False, lambda v, way, a: a),
        Term("input_bias", "bias", True, lambda v, way, a: -np.ones_like(v)),
    )
}
