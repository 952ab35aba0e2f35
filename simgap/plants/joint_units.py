"""The units in which an engine and Drake compute a joint: SI, an angle in radians."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from simgap.config.plant import PlantSection
from simgap.units import require_unit

_TURNS, _SLIDES = ("rad", "rad/s", "N*m"), ("m", "m/s", "N")


def check_joint_units(section: PlantSection, urdf: Path) -> None:
    """Refuse states and inputs that stand for a joint of the file in a unit other than the joint's.

    Their numbers go to the engine as they are: a state in deg would be labelled deg and hold radians.

    Raises:
        UserError: naming the key and the unit that is wanted.
    """
    types = {j.get("name"): j.get("type") for j in ElementTree.parse(urdf).getroot().findall("joint")}
    units = {name: _SLIDES if kind == "prismatic" else _TURNS for name, kind in types.items()}
    for name, state in section.states.items():
        if state.joint in units and state.quantity is not None:
            position, velocity, _ = units[state.joint]
            wanted = position if state.quantity == "position" else velocity
            require_unit(state.unit, wanted, f"plant.states.{name}.unit")
    for name, drive in section.inputs.items():
        if drive.joint in units:
            require_unit(drive.unit, units[drive.joint][2], f"plant.inputs.{name}.unit")
