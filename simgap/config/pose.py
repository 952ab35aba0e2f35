"""Where the pose of a planar robot stands among the states of its case."""

from __future__ import annotations

from simgap.config.context import Context


def pose_axes(context: Context) -> tuple[int, int, int]:
    """Which states are x, y and heading."""
    symbolic = context.need(context.case.plant.symbolic, "plant.symbolic")
    wheels = context.need(symbolic.wheels, "plant.symbolic.wheels")
    x, y, heading = (context.states.index(name) for name in (wheels.x, wheels.y, wheels.heading))
    return x, y, heading
