"""The joints of a case: they are in the file and move, and their units are the ones computed in (SI, radians)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from simgap import reading
from simgap.config.plant import PlantSection
from simgap.errors import UserError
from simgap.units import require_unit

_TURNS, _SLIDES = ("rad", "rad/s", "N*m"), ("m", "m/s", "N")


def check_joint_units(section: PlantSection, urdf: Path) -> None:
    """Refuse states and inputs that stand for no moving joint of the file, or in a unit other than the joint's.

    Their numbers go to the engine as they are: a state in deg would be labelled deg and hold radians.

    Raises:
        UserError: naming the key and the joints there are, or the unit that is wanted.
    """
    robot = reading.read_xml(urdf)
    if robot.tag != "robot":
        return
    check_units(section, {str(j.get("name")): str(j.get("type")) for j in robot.findall("joint")}, urdf.name)


def check_units(section: PlantSection, types: Mapping[str, str], file: str) -> None:
    """The same for the joints of any model file, by name: prismatic, fixed, or one that turns.

    Raises:
        UserError: as `check_joint_units`.
    """
    for group, owners in (("states", section.states), ("inputs", section.inputs)):
        for name, owner in owners.items():
            if owner.joint is not None and types.get(owner.joint, "fixed") == "fixed":
                moving = ", ".join(n for n, kind in types.items() if kind != "fixed") or "none"
                raise UserError(
                    f"{file} has no moving joint '{owner.joint}'", key=f"plant.{group}.{name}.joint",
                    remedy=f"Moving joints: {moving}.",
                )  # fmt: skip
    units = {name: _SLIDES if kind == "prismatic" else _TURNS for name, kind in types.items()}
    for name, state in section.states.items():
        if state.joint in units and state.quantity is not None:
            position, velocity, _ = units[state.joint]
            wanted = position if state.quantity == "position" else velocity
            require_unit(state.unit, wanted, f"plant.states.{name}.unit")
    for name, drive in section.inputs.items():
        if drive.joint in units:
            require_unit(drive.unit, units[drive.joint][2], f"plant.inputs.{name}.unit")
