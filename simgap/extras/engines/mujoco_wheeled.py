"""A robot on wheels in MuJoCo (optional extra `mujoco`).

MuJoCo's import of a URDF knows nothing of `<lateral_friction>`, welds the root to the world and has no floor and no
motors. They are added here: the URDF on a free joint, wheels on a floor, torque-limited velocity motors. What touches
the floor are the links other than the root; one without friction slides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from simgap import reading
from simgap.arrays import Floats
from simgap.errors import UserError, excerpt
from simgap.plants.model_file import Link
from simgap.plants.urdf_checks import attributes, loading, number_of, root_link
from simgap.simulators.commands import CommandPath
from simgap.simulators.mjcf import MuJoCoModel, require_mujoco
from simgap.simulators.wheeled import WheeledEngine, WheeledPlant, WheeledSettings

IMPRATIO = 10.0
"""Stiffness of friction over that of contact: tyres of MuJoCo's default, 1, creep under load (its documentation)."""


class MuJoCoWheeledSettings(WheeledSettings):
    """MuJoCo over a differential-drive URDF (optional extra `simgap[mujoco]`)."""

    engine: Literal["mujoco_wheeled"] = "mujoco_wheeled"  # type: ignore[assignment]
    """Name of the engine."""
    gain: float = Field(2.0, gt=0)
    """Gain of the wheels' velocity loops, N m s/rad; their torque is limited to `torque`."""


class MuJoCoWheeled(WheeledEngine):
    """`f_hat` of the robot: states x, y, heading (not wrapped); inputs linear and angular velocity."""

    Settings = MuJoCoWheeledSettings
    distributions = ("mujoco",)

    def __init__(self, plant: WheeledPlant, section: MuJoCoWheeledSettings, paths: Sequence[CommandPath] = ()) -> None:
        super().__init__(plant, section, paths)
        self._run = MuJoCoModel(model_of(plant, section))
        self.engine = self._run.engine
        joints = [self._run.model.joint(name) for name in (section.left, section.right)]
        self._turning = [int(j.qposadr[0]) for j in joints]
        self._rates = [int(j.dofadr[0]) for j in joints]
        self._settle()
        self._rest = self._kept()

    def _settle(self) -> None:
        """Let the robot stand until its contacts carry it."""
        self._run.data.qpos[2] = self._section.wheel_radius
        for _ in range(int(np.ceil(self._section.settle / self._run.model.opt.timestep))):
            self._run.step()

    def _kept(self) -> Floats:
        """All that the next step depends on, the solver's warm start included."""
        mujoco, model = self._run.mujoco, self._run.model
        state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(model, self._run.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        return state

    def _return_to(self, state: Floats) -> None:
        mujoco, run = self._run.mujoco, self._run
        run.reset()
        mujoco.mj_setState(run.model, run.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)

    def loaded(self) -> Mapping[str, Link]:
        """See `Simulator.loaded`; every link but the root."""
        return self._run.links(2)

    def _place(self, x: float, y: float, heading: float) -> None:
        data, turned = self._run.data, np.empty(4)
        yaw = np.array([np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)])
        self._run.mujoco.mju_mulQuat(turned, yaw, np.array(data.qpos[3:7]))
        data.qpos[0], data.qpos[1], data.qpos[3:7] = x, y, turned
        data.qpos[self._turning], data.qvel[:] = 0.0, 0.0

    def turning(self) -> tuple[float, float]:
        """See `WheeledEngine.turning`."""
        left, right = self._run.data.qvel[self._rates].tolist()
        return left, right

    def standing(self) -> tuple[float, float]:
        """See `WheeledEngine.standing`."""
        qx, qy = self._run.data.qpos[4:6].tolist()
        lean = np.arccos(np.clip(1.0 - 2.0 * (qx * qx + qy * qy), -1.0, 1.0))
        return float(self._run.data.qpos[2]), float(lean)

    def _command(self, linear: float, angular: float) -> None:
        self._run.data.ctrl[:] = self.wheel_rates(linear, angular)

    def _step_to_pose(self, n: int) -> None:
        self._run.step(self._section.substeps // self._section.poses)
        x, y, _, qw, qx, qy, qz = self._run.data.qpos[:7].tolist()
        heading = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        self._record(n, x, y, heading)

    def _complete_path(self, u: Floats) -> None:
        if self._run.has_diverged:
            raise self._run.diverged("mujoco_wheeled", zip(("linear", "angular"), u, strict=True))


def model_of(plant: WheeledPlant, section: MuJoCoWheeledSettings) -> Any:
    """MuJoCo's model of the URDF: on a free joint, with a floor that all links but the root touch, and two motors.

    Raises:
        UserError: wheels that are not there, or a link that touches the floor and states no friction, or too much.
    """
    mujoco = require_mujoco()
    with loading("MuJoCo", plant.urdf):
        spec = mujoco.MjSpec.from_file(str(plant.urdf))
    spec.compiler.fusestatic = False
    option = spec.option
    option.timestep, option.iterations = plant.tau / section.substeps, section.solver_iterations
    option.gravity = [0.0, 0.0, -plant.gravity]
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, IMPRATIO
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    root = root_link(plant.urdf)
    _stand(spec, mujoco, root, friction_of(plant.urdf, root), section.floor_friction)
    for joint in spec.joints:
        joint.frictionloss, joint.damping = 0.0, np.zeros_like(joint.damping)
    spec.body(root).add_freejoint()
    for name in (section.left, section.right):
        motor = spec.add_actuator()
        motor.target, motor.trntype, motor.biastype = name, mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtBias.mjBIAS_AFFINE
        motor.gainprm[0], motor.biasprm[2] = section.gain, -section.gain
        motor.forcelimited, motor.forcerange = True, [-section.torque, section.torque]
    with loading("MuJoCo", plant.urdf):
        model = spec.compile()
    if section.payload:
        body = model.body(root).id
        scale = 1.0 + section.payload / float(model.body_mass[body])
        model.body_mass[body] *= scale
        model.body_inertia[body] *= scale
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def friction_of(urdf: Path, root: str) -> dict[str, float]:
    """`<lateral_friction>` of every link but the root that can touch something.

    Raises:
        UserError: a link that states none (engines would assume different ones), or more than 1.
    """
    found = {}
    for link in reading.read_xml(urdf).findall("link"):
        name, text = str(link.get("name")), attributes(link, "contact/lateral_friction").get("value")
        if name == root or link.find("collision") is None:
            continue
        value = number_of(text or "")
        if not 0.0 <= value <= 1.0:
            what = "states no friction" if text is None else f"has the lateral friction {excerpt(text, 40)}"
            problem = f"it touches the floor and {what}"
            remedy = 'Give <contact><lateral_friction value="..."/></contact>, 0 to 1; 0 for a caster that slides.'
            raise UserError(problem, file=urdf, key=f"link '{name}': <lateral_friction>", remedy=remedy)
        found[name] = value
    return found


def _stand(spec: Any, mujoco: Any, root: str, friction: Mapping[str, float], floor_friction: float) -> None:
    """A floor, and which links it carries; nothing else touches anything. The larger friction of two shapes counts."""
    for body in spec.bodies:
        for geom in body.geoms:
            mu = friction.get(body.name, 0.0) * floor_friction
            geom.contype, geom.conaffinity = 0, int(body.name in friction)
            geom.condim, geom.friction = (3 if mu > 0.0 else 1), [mu, 0.0, 0.0]
    floor = spec.worldbody.add_geom()
    floor.type, floor.size = mujoco.mjtGeom.mjGEOM_PLANE, [0.0, 0.0, 1.0]
    floor.contype, floor.conaffinity, floor.condim, floor.friction = 1, 0, 1, [0.0, 0.0, 0.0]
