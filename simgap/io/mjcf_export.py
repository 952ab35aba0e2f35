"""The nominal model of a case with its effects as MJCF, where MuJoCo's format can say them.

MJCF states damping, dry friction, armature and stiffness of a joint, masses of bodies, the gear of a motor. The rest of
the library it cannot say, and a file without it would be another model, so it is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.config.load import load_case
from simgap.effects import EFFECTS, AppliedEffect
from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.plants.plant_model import PlantModel
from simgap.plants.urdf_checks import loading

REMEDY = "Use the case itself, or simgap.load_plant(case).drake_system(), which hold every effect."


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
            motor = spec.add_actuator(name=name, target=given.joint, trntype=_mujoco().mjtTrn.mjTRN_JOINT)
            motor.set_to_motor()
    for k, effect in enumerate(plant.effects):
        if not _is_written(spec, effect):
            raise UserError(
                f"MJCF cannot hold '{effect.name}' on '{effect.on}'", file=case, key=f"plant.effects.{k}", remedy=REMEDY
            )
    spec.compile()
    write_text(out, spec.to_xml())


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError:
        raise UserError("MuJoCo is not installed", key="--out", remedy="Install the extra: simgap[mujoco].") from None
    return mujoco


def _from_urdf(path: Path) -> Any:
    """The URDF as MuJoCo reads it, meshes by their whole paths.

    Raises:
        UserError: a file that MuJoCo does not take.
    """
    mujoco = _mujoco()
    with loading("MuJoCo", path):
        return mujoco.MjSpec.from_file(str(reading.real(path)))


def _is_written(spec: Any, given: AppliedEffect) -> bool:
    """Whether the effect is in the model now; an older MuJoCo has the first coefficient of a polynomial alone."""
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
