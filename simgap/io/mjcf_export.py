"""The nominal model of a case with its effects as MJCF, where MuJoCo's format can say them.

MJCF states damping, dry friction, armature and stiffness of a joint, masses of bodies, the gear of a motor. The rest of
the library it cannot say, and a file without it would be another model, so it is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.config.load import load_case
from simgap.effects import AppliedEffect
from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.plants.plant_model import PlantModel
from simgap.plants.urdf_checks import loading
from simgap.simulators.mjcf import require_mujoco

REMEDY = "Use the case itself, or simgap.load_plant(case).drake_system(), which hold every effect."
Write = Callable[[Any, AppliedEffect], bool]


def export_mjcf(case: Path, out: Path) -> None:
    """Write a MuJoCo model of a case: its URDF, a motor for each input, and the effects that the case adds.

    Joint friction of the URDF is left out, as the nominal model leaves it out; `coulomb_friction` is written.
    Numbers have the six digits that MuJoCo writes.

    Raises:
        UserError: a plant of equations, an effect that MJCF cannot hold, or MuJoCo is not installed.
    """
    section = load_case(case)
    if section.plant.urdf is None:
        raise UserError("the plant is written in equations", file=case, key="plant.urdf", remedy=REMEDY)
    plant = PlantModel.of(section, case.parent)
    _ = plant.corrected  # refuses what does not fit the plant
    spec = _from_urdf(case.parent / section.plant.urdf)
    spec.option.gravity = (0.0, 0.0, -section.plant.gravity)
    if section.domain is not None:
        spec.option.timestep = section.domain.tau
    for joint in spec.joints:
        joint.frictionloss = 0.0
    for name, given in section.plant.inputs.items():
        if given.joint is not None:
            motor = spec.add_actuator(name=name, target=given.joint, trntype=require_mujoco().mjtTrn.mjTRN_JOINT)
            motor.set_to_motor()
    for k, effect in enumerate(plant.effects):
        write = _WRITERS.get(effect.name)
        if write is None or not write(spec, effect):
            raise UserError(
                f"MJCF cannot hold '{effect.name}' on '{effect.on}'", file=case, key=f"plant.effects.{k}", remedy=REMEDY
            )
    spec.compile()
    write_text(out, spec.to_xml())


def _from_urdf(path: Path) -> Any:
    """The URDF as MuJoCo reads it, meshes by their whole paths.

    Raises:
        UserError: a file that MuJoCo does not take.
    """
    mujoco = require_mujoco()
    with loading("MuJoCo", path):
        return mujoco.MjSpec.from_file(str(reading.real(path)))


def _on_joint(attribute: str, symbol: str, power: int = 0) -> Write:
    """Adds the value of a parameter to an attribute of the joint, a number or the coefficients of a polynomial.

    Coefficient k of a damping is of v |v|^k, of a stiffness of q^(k + 1); an older MuJoCo has the first alone.
    """

    def write(spec: Any, effect: AppliedEffect) -> bool:
        joint = spec.joint(effect.on)
        value = np.array(getattr(joint, attribute), dtype=float) if joint is not None else np.empty(0)
        if value.size <= power:
            return False
        value.flat[power] += float(effect.values[symbol])
        setattr(joint, attribute, value if value.ndim else float(value))
        return True

    return write


def _denser(spec: Any, effect: AppliedEffect) -> bool:
    """A denser link of the same shape: its inertia scales along with its mass."""
    owner, _, quantity = effect.on.rpartition(".")
    body = spec.body(owner) if owner else None
    if quantity != "mass" or body is None or not body.explicitinertial:
        return False
    ratio = float(effect.values["ratio"])
    body.mass *= ratio
    body.inertia = np.asarray(body.inertia) * ratio
    body.fullinertia = np.asarray(body.fullinertia) * ratio
    return True


def _gain(spec: Any, effect: AppliedEffect) -> bool:
    motor = spec.actuator(effect.on)
    if motor is None:
        return False
    gear = np.array(motor.gear)
    gear[0] *= float(effect.values["ratio"])
    motor.gear = gear
    return True


_WRITERS: Mapping[str, Write] = {
    "viscous_friction": _on_joint("damping", "b"),
    "coulomb_friction": _on_joint("frictionloss", "F_c"),
    "reflected_inertia": _on_joint("armature", "I"),
    "spring": _on_joint("stiffness", "k"),
    "quadratic_drag": _on_joint("damping", "c", 1),
    "cubic_spring": _on_joint("stiffness", "k3", 2),
    "parameter_error": _denser,
    "input_gain": _gain,
}
