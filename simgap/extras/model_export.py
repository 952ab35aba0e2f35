"""The nominal model of a case with its effects as a URDF or MJCF, where that can say them.

A URDF states a joint's viscous damping and dry friction, and a link's mass. MJCF states damping, dry friction, armature
and stiffness of a joint, masses of bodies, the gear of a motor. The rest of the library neither can say, and a file
without it would be another model, so it is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from simgap import reading
from simgap.config.case import Case
from simgap.config.load import load_case
from simgap.effects import EFFECTS, AppliedEffect
from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.io.urdf_file import MOMENTS, move_meshes
from simgap.plants.plant_model import PlantModel
from simgap.plants.urdf_checks import loading
from simgap.simulators.mjcf import require_mujoco

REMEDY = "Use the case itself, or simgap.load_plant(case).drake_system(), which hold every effect."
_DYNAMICS = {"damping": "damping", "frictionloss": "friction"}
"""Attribute of a joint in MJCF -> that of its `<dynamics>` in a URDF."""


def export_model(case: Path | str, out: Path | str) -> None:
    """Write the model of a case with the effects that the case adds to its plant, such as those that a diagnosis found.

    A file that ends in `.xml` or `.mjcf` is a MuJoCo model (extra `mujoco`): its URDF, and a motor for each input.
    Joint friction of the URDF is left out there, as the nominal model leaves it out, and numbers have the six digits
    that MuJoCo writes. Any other is a URDF.

    Friction is written as the attribute `friction` of `<dynamics>`, which PyBullet and MuJoCo read and Drake does not;
    engines act it out each in their own way.

    Raises:
        UserError: a plant of equations, an effect that the format cannot hold, or MuJoCo is not installed.
    """
    case, out = Path(case), Path(out)
    if out.suffix in (".h", ".py"):
        remedy = "Give its controller.npz for a controller, or a name that ends in .urdf or .xml for the model."
        raise UserError("a case file is exported as a model, and not as a controller", key=str(out), remedy=remedy)
    section = load_case(case)
    if section.plant.urdf is None:
        raise UserError("the plant is written in equations", file=case, key="plant.urdf", remedy=REMEDY)
    plant, source = PlantModel.of(section, case.parent), case.parent / section.plant.urdf
    _ = plant.corrected  # refuses what does not fit the plant
    in_mjcf = out.suffix in (".xml", ".mjcf")
    form, is_written = ("MJCF", _is_in_mjcf) if in_mjcf else ("a URDF", _is_in_urdf)
    model: Any = _mjcf_of(section, source) if in_mjcf else reading.read_xml(source)
    for k, effect in enumerate(plant.effects):
        if not is_written(model, effect):
            problem = f"{form} cannot hold '{effect.name}' on '{effect.on}'"
            raise UserError(problem, file=case, key=f"plant.effects.{k}", remedy=REMEDY)
    if in_mjcf:
        model.compile()
        write_text(out, model.to_xml())
    else:
        move_meshes(model, source.parent, out.parent)
        write_text(out, ElementTree.tostring(model, encoding="unicode", xml_declaration=True) + "\n")


def _mjcf_of(case: Case, urdf: Path) -> Any:
    """The URDF as MuJoCo reads it, meshes by their whole paths, with the motors, gravity and step of a case.

    Raises:
        UserError: a file that MuJoCo does not take, or MuJoCo is not installed.
    """
    mujoco = require_mujoco("--out")
    with loading("MuJoCo", urdf):
        spec = mujoco.MjSpec.from_file(str(reading.real(urdf)))
    spec.option.gravity = (0.0, 0.0, -case.plant.gravity)
    if case.domain is not None:
        spec.option.timestep = case.domain.tau
    for joint in spec.joints:
        joint.frictionloss = 0.0
    for name, given in case.plant.inputs.items():
        if given.joint is not None:
            motor = spec.add_actuator(name=name, target=given.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.set_to_motor()
    return spec


def _is_in_mjcf(spec: Any, given: AppliedEffect) -> bool:
    """True if the effect is in the model now; an older MuJoCo has the first coefficient of a polynomial alone."""
    effect = EFFECTS[given.name]
    place = effect.mjcf
    if place is None:
        return False
    owner, _, quantity = given.on.rpartition(".") if place.quantity else (given.on, "", "")
    element = getattr(spec, place.of)(owner) if owner and quantity == place.quantity else None
    if element is None or (place.of == "body" and not element.explicitinertial):
        return False
    (parameter,) = effect.parameters
    number = float(given.values[parameter.symbol])
    for attribute in place.attributes:
        value = np.array(getattr(element, attribute), dtype=float)
        if parameter.null == 1.0:
            value *= number
        elif place.power < value.size:
            value.flat[place.power] += number
        else:
            return False
        setattr(element, attribute, value if value.ndim else float(value))
    return True


def _is_in_urdf(robot: ElementTree.Element, given: AppliedEffect) -> bool:
    """True if the effect is in the tree now: on `<dynamics>` of a joint, or as a denser link of the same shape."""
    place = EFFECTS[given.name].mjcf
    if place is None:
        return False
    if place.of == "body":
        return _is_denser(robot, given)
    joint = next((j for j in robot.findall("joint") if j.get("name") == given.on), None)
    attribute = _DYNAMICS.get(place.attributes[0])
    if joint is None or attribute is None or place.power > 0:
        return False
    own = joint.find("dynamics")
    own = ElementTree.SubElement(joint, "dynamics") if own is None else own
    (value,) = given.values.values()
    own.set(attribute, repr(float(own.get(attribute, "0")) + float(value)))
    return True


def _is_denser(robot: ElementTree.Element, given: AppliedEffect) -> bool:
    """True if the inertia of the link was scaled along with its mass."""
    owner, _, quantity = given.on.rpartition(".")
    link = next((e for e in robot.findall("link") if e.get("name") == owner), None)
    if quantity != "mass" or link is None:
        return False
    ratio = float(given.values["ratio"])
    for tag, names in (("mass", ("value",)), ("inertia", MOMENTS)):
        own = link.find(f"inertial/{tag}")
        if own is None:
            return False
        for name in names:
            own.set(name, repr(float(own.get(name, "0")) * ratio))
    return True
