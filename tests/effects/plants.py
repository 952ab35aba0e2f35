"""A wheeled robot on the plane."""

from __future__ import annotations

import sympy as sp

from simgap.model.symbolic import PlanarWheels, SymbolicModel, Variable, symbol


def unicycle(track: float = 0.3) -> SymbolicModel:
    v, w, heading = symbol("speed"), symbol("turn"), symbol("heading")
    return SymbolicModel(
        states=(Variable("px", "m"), Variable("py", "m"), Variable("heading", "rad")),
        inputs=(Variable("speed", "m/s"), Variable("turn", "rad/s")),
        parameters={},
        xdot=(v * sp.cos(heading), v * sp.sin(heading), w),
        wheels=PlanarWheels("px", "py", "heading", "speed", "turn", track),
    )
