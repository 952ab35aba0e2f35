"""Joints that X takes to the end stops of a model file, where a simulator brakes them and a nominal model does not."""

from __future__ import annotations

from collections.abc import Sequence

from simgap.config.context import Context
from simgap.plants.stops import joint_stops
from simgap.simulators.surprises import to_stop


def reached_stops(context: Context, states: Sequence[str]) -> list[str]:
    """Which of the states come within a step's travel of a stop, each with its joint and the stops, in words."""
    plant, simulator, domain = context.case.plant, context.case.simulator, context.domain
    places = {s.joint: name for name, s in plant.states.items() if s.quantity == "position" and s.joint}
    files = {f for f in (plant.urdf, simulator.urdf if simulator is not None else None) if f}
    return [
        f"joint '{joint}' ({name} in [{domain.X[name][0]:g}, {domain.X[name][1]:g}], stops at "
        f"{' and '.join(f'{end:g}' for end in ends)})"
        for file in sorted(files)
        for joint, ends in joint_stops(context.folder / file, list(places)).items()
        if (name := places[joint]) in states and any(to_stop(context.case, name, end) for end in ends)
    ]
