"""What the joints of two models feel, as numbers that no name or frame of a body enters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simgap.arrays import Floats
from simgap.simulators import mjcf

if TYPE_CHECKING:
    from simgap.config.case import Case


@dataclass(frozen=True)
class Felt:
    """What a joint feels: mass that it moves, kg; inertia at 0, kg m^2 or kg; gravity's pull at states, N m or N."""

    mass: float
    inertia: float
    gravity: Floats


def of_file(case: Case, model: Any) -> Mapping[str, Felt]:
    """What each joint of MuJoCo's model feels, by name; gravity at the states of `mjcf.samples`."""
    mujoco = mjcf.installed()
    nv, pulls = model.nv, []
    for x in mjcf.samples(case):
        data = mjcf.placed(case, model, x)
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        pulls.append(np.array(data.qfrc_gravcomp) - np.array(data.qfrc_bias))
    data, inertia = mujoco.MjData(model), np.empty(nv)
    data.qpos[:] = 0.0
    mujoco.mj_forward(model, data)
    bias = np.empty(nv)
    mujoco.mj_rne(model, data, 0, bias)
    for k in range(nv):  # a column of the mass matrix, without armature
        data.qacc[:] = np.eye(nv)[k]
        column = np.empty(nv)
        mujoco.mj_rne(model, data, 1, column)
        inertia[k] = column[k] - bias[k]
    return {
        model.joint(j).name: Felt(
            float(model.body_subtreemass[model.jnt_bodyid[j]]),
            float(inertia[k := int(model.jnt_dofadr[j])]),
            np.array([pull[k] for pull in pulls]),
        )
        for j in range(model.njnt)
    }


def of_nominal(case: Case, urdf: Path) -> Mapping[str, Felt]:
    """The same of the plant's URDF, by Drake."""
    from simgap.plants.urdf import multibody_plant

    plant, names = multibody_plant(urdf, (0.0, 0.0, -case.plant.gravity))
    context = plant.CreateDefaultContext()
    joints = [plant.GetJointByName(name) for name in names]
    plant.SetPositions(context, np.zeros(plant.num_positions()))
    mass, pulls = plant.CalcMassMatrix(context), []
    place = {s.joint: n for n, s in case.plant.states.items() if s.quantity == "position"}
    for x in mjcf.samples(case):
        q = np.zeros(plant.num_positions())
        for joint in joints:
            q[joint.position_start()] = x[place[joint.name()]]
        plant.SetPositions(context, q)
        pulls.append(plant.CalcGravityGeneralizedForces(context))
    moved = [[plant.get_body(b) for b in plant.GetBodiesKinematicallyAffectedBy([joint.index()])] for joint in joints]
    return {
        joint.name(): Felt(
            sum(float(body.default_mass()) for body in bodies),
            float(mass[k := joint.velocity_start(), k]),
            np.array([pull[k] for pull in pulls]),
        )
        for joint, bodies in zip(joints, moved, strict=True)
    }
