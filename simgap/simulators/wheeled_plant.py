"""Where the roles of a planar wheeled robot stand among the states and inputs of a case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from simgap.config.case import Case
from simgap.config.plant import AddedEffect
from simgap.effects import effect
from simgap.effects.base import WheelEffect
from simgap.errors import UserError


@dataclass(frozen=True)
class WheeledPlant:
    """Where pose and commands stand among the states and inputs, and the sampling time (s)."""

    urdf: Path
    tau: float
    gravity: float = 9.81
    pose: tuple[int, int, int] = (0, 1, 2)
    commands: tuple[int, int] = (0, 1)


def wheeled_plant(case: Case, folder: Path) -> WheeledPlant:
    """Where the roles of `plant.symbolic.wheels` stand in the case.

    Raises:
        UserError: a plant whose states and inputs are not those of a planar wheeled robot.
    """
    plant, section, domain = case.plant, case.simulator, case.domain
    wheels = plant.symbolic.wheels if plant.symbolic else None
    states, inputs = list(plant.states), list(plant.inputs)
    if wheels is None or domain is None or section is None or section.urdf is None:
        raise UserError(
            "a wheeled simulator needs plant.symbolic.wheels and a domain", key="plant.symbolic.wheels",
            remedy="Name the states x, y, heading and the inputs linear, angular.",
        )  # fmt: skip
    pose, commands = (wheels.x, wheels.y, wheels.heading), (wheels.linear, wheels.angular)
    if sorted(states) != sorted(pose) or sorted(inputs) != sorted(commands):
        raise UserError(
            f"wheels are {pose} and {commands}, the plant has {states} and {inputs}", key="plant.symbolic.wheels"
        )
    x, y, heading = (states.index(name) for name in pose)
    linear, angular = (inputs.index(name) for name in commands)
    return WheeledPlant(folder / section.urdf, domain.tau, plant.gravity, (x, y, heading), (linear, angular))


WheelPath = tuple[tuple[WheelEffect, Mapping[str, float]], ...]
"""Effects on the wheels' speeds with their values, the nearest to the command first."""


def wheel_path(effects: Sequence[AddedEffect]) -> WheelPath:
    """Those of the effects that act on the wheels; those on the commands change none of their speeds.

    Raises:
        UserError: missing or unphysical values.
    """
    own = []
    for added in sorted(effects, key=lambda a: -effect(a.name).rank):
        kind = effect(added.name)
        kind.check_values(added.parameters)
        if isinstance(kind, WheelEffect):
            own.append((kind, added.parameters))
    return tuple(own)
