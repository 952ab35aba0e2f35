"""The nominal model of a case with its effects as a URDF, where a URDF can say them.

A URDF states a joint's viscous damping and dry friction, and a link's mass; the rest of the library it cannot say, and
a file without it would be another model, so it is refused.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree

from simgap import reading
from simgap.config.load import load_case
from simgap.effects import AppliedEffect
from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.io.mjcf_export import REMEDY, export_mjcf
from simgap.plants.plant_model import PlantModel


def export_model(case: Path | str, out: Path | str) -> None:
    """Write the URDF of a case with the effects that the case adds to its plant, such as those that a diagnosis found.

    A file that ends in `.xml` or `.mjcf` is a MuJoCo model (extra `mujoco`).

    Friction is written as the attribute `friction` of `<dynamics>`, which PyBullet and MuJoCo read and Drake does not;
    engines act it out each in their own way.

    Raises:
        UserError: a plant of equations, or an effect that the format cannot hold.
    """
    case, out = Path(case), Path(out)
    if out.suffix in (".xml", ".mjcf"):
        export_mjcf(case, out)
        return
    section = load_case(case)
    if section.plant.urdf is None:
        raise UserError("the plant is written in equations", file=case, key="plant.urdf", remedy=REMEDY)
    plant = PlantModel.of(section, case.parent)
    _ = plant.corrected  # refuses what does not fit the plant
    source = case.parent / section.plant.urdf
    robot = reading.read_xml(source)
    for k, effect in enumerate(plant.effects):
        write = _WRITERS.get(effect.name)
        if write is None or not write(robot, effect):
            raise UserError(
                f"a URDF cannot hold '{effect.name}' on '{effect.on}'", file=case, key=f"plant.effects.{k}",
                remedy=REMEDY,
            )  # fmt: skip
    for mesh in robot.iter("mesh"):
        name = mesh.get("filename", "")
        if name and "://" not in name and not Path(name).is_absolute():
            mesh.set("filename", Path(os.path.relpath(source.parent / name, out.parent)).as_posix())
    write_text(out, ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n")


def _dynamics(attribute: str, symbol: str) -> Callable[[ElementTree.Element, AppliedEffect], bool]:
    """Adds the value of a parameter to an attribute of the joint's `<dynamics>`."""

    def write(robot: ElementTree.Element, effect: AppliedEffect) -> bool:
        joint = next((j for j in robot.findall("joint") if j.get("name") == effect.on), None)
        if joint is None:
            return False
        place = joint.find("dynamics")
        place = ElementTree.SubElement(joint, "dynamics") if place is None else place
        place.set(attribute, repr(float(place.get(attribute, "0")) + float(effect.values[symbol])))
        return True

    return write


def _parameter(robot: ElementTree.Element, effect: AppliedEffect) -> bool:
    """A denser link of the same shape: its inertia scales along with its mass."""
    owner, _, quantity = effect.on.rpartition(".")
    link = next((e for e in robot.findall("link") if e.get("name") == owner), None)
    if quantity != "mass" or link is None:
        return False
    ratio = float(effect.values["ratio"])
    for tag, names in (("mass", ("value",)), ("inertia", ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))):
        place = link.find(f"inertial/{tag}")
        if place is None:
            return False
        for name in names:
            place.set(name, repr(float(place.get(name, "0")) * ratio))
    return True


_WRITERS: Mapping[str, Callable[[ElementTree.Element, AppliedEffect], bool]] = {
    "viscous_friction": _dynamics("damping", "b"),
    "coulomb_friction": _dynamics("friction", "F_c"),
    "parameter_error": _parameter,
}
