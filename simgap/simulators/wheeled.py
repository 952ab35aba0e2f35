"""A differential-drive robot in PyBullet: wheels in frictional contact with a floor, torque-limited velocity motors.

The engine's state is larger than the pose: wheel and body velocities, contact caches. `reset` restores a saved state of
the robot at rest before it moves the robot, so that nothing of an earlier roll-out is left; `responses` restores the
saved state that a history of inputs leaves behind. The same arguments give the same bits in any order.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap.config.case import Case
from simgap.config.plant import AddedEffect
from simgap.config.wheeled import WheeledSection
from simgap.effects import effect
from simgap.effects.base import InputEffect
from simgap.errors import UserError
from simgap.geometry import Floats
from simgap.plants.urdf_checks import check_urdf
from simgap.simulators.base import Simulator
from simgap.simulators.commands import CommandMemory, CommandPath

CONTACT_BREAKING = 1e-3  # m; the default of 0.02 keeps stale contact points of a rolling wheel


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
    if wheels is None or domain is None or not isinstance(section, WheeledSection):
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


def wheel_ratios(effects: Sequence[AddedEffect]) -> tuple[float, float]:
    """Factors on the speeds of the left and right wheel by which effects are acted out.

    Raises:
        UserError: an effect that neither the wheels nor the path of the commands can act out.
    """
    left, right = 1.0, 1.0
    for added in effects:
        kind = effect(added.name)
        kind.check_values(added.parameters)
        ratios = kind.wheel_ratios(added.parameters)
        if ratios is None and not isinstance(kind, InputEffect):
            raise UserError(
                f"the simulator cannot act out '{added.name}'", key="simulator.effects",
                remedy="It takes changes of the commands and of the wheels' speeds. Without it gamma does not cover "
                "hardware that has the effect.",
            )  # fmt: skip
        left, right = (left * ratios[0], right * ratios[1]) if ratios is not None else (left, right)
    return left, right


class PyBulletWheeled(Simulator):
    """`f_hat` of the robot: states x, y, heading (not wrapped); inputs linear and angular velocity."""

    def __init__(self, plant: WheeledPlant, section: WheeledSection, paths: Sequence[CommandPath] = ()) -> None:
        import pybullet as p
        from pybullet_utils.bullet_client import BulletClient  # type: ignore[import-untyped]

        check_urdf(plant.urdf)
        if section.substeps % section.poses:
            raise UserError(
                f"{section.poses} poses do not divide {section.substeps} sub-steps", key="simulator.poses",
                remedy="Let substeps be a multiple of poses.",
            )  # fmt: skip
        self._ratios = wheel_ratios(section.effects)
        self.nx, self.nu = 3, 2
        self.engine = f"pybullet {p.getAPIVersion()}"
        self._p: Any = BulletClient(p.DIRECT)
        self.pose = plant.pose
        self._plant, self._section = plant, section
        self._body, self._wheels = self._load()
        self._offset = np.array(self._p.getDynamicsInfo(self._body, -1)[3])  # of the centre of mass from the root
        self._height = self._settled_height()
        self._rest: int = self._p.saveState()
        self._memory = [CommandMemory(path, plant.tau) for path in paths]
        self.path = np.zeros((section.poses, 3))
        self._turned = 0.0

    def _load(self) -> tuple[int, tuple[int, int]]:
        p, s = self._p, self._section
        p.setGravity(0, 0, -self._plant.gravity)
        p.setPhysicsEngineParameter(
            fixedTimeStep=self._plant.tau / s.poses,
            numSubSteps=s.substeps // s.poses,
            deterministicOverlappingPairs=1,
            enableConeFriction=1,
            contactBreakingThreshold=CONTACT_BREAKING,
        )
        floor = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))
        p.changeDynamics(floor, -1, lateralFriction=s.floor_friction, restitution=0)
        body = p.loadURDF(str(self._plant.urdf), [0, 0, s.wheel_radius], flags=p.URDF_USE_INERTIA_FROM_FILE)
        index = {p.getJointInfo(body, j)[1].decode(): j for j in range(p.getNumJoints(body))}
        missing = [name for name in (s.left, s.right) if name not in index]
        if missing:
            raise UserError(f"no joint called {missing}", file=self._plant.urdf, remedy=f"It has {sorted(index)}.")
        for link in range(-1, p.getNumJoints(body)):
            p.changeDynamics(
                body, link, linearDamping=0, angularDamping=0, jointDamping=0, rollingFriction=0, spinningFriction=0,
                restitution=0, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
            )  # fmt: skip
        p.setCollisionFilterPair(body, floor, -1, -1, 0)  # the body hangs clear of the floor; asking costs a third
        if s.payload:
            mass, _, inertia = p.getDynamicsInfo(body, -1)[:3]
            scale = 1.0 + s.payload / mass
            p.changeDynamics(body, -1, mass=mass * scale, localInertiaDiagonal=[scale * i for i in inertia])
        return body, (index[s.left], index[s.right])

    def _settled_height(self) -> float:
        """Let the robot stand until its contacts carry it: height of its centre of mass, m."""
        self._command(0.0, 0.0)
        for _ in range(int(np.ceil(self._section.settle * self._section.poses / self._plant.tau))):
            self._p.stepSimulation()
        return float(self._p.getBasePositionAndOrientation(self._body)[0][2])

    def _command(self, linear: float, angular: float) -> None:
        s = self._section
        half, (left, right) = 0.5 * s.track * angular, self._ratios
        # PyBullet limits a motor's impulse by force times the outer time step whatever the number of sub-steps
        force = s.torque / (s.substeps // s.poses)
        self._p.setJointMotorControlArray(
            self._body, self._wheels, self._p.VELOCITY_CONTROL,
            targetVelocities=[left * (linear - half) / s.wheel_radius, right * (linear + half) / s.wheel_radius],
            forces=[force, force],
        )  # fmt: skip

    def _pose(self) -> tuple[float, float, float]:
        """Pose of the root frame; heading in (-pi, pi]."""
        position, quaternion = self._p.getBasePositionAndOrientation(self._body)
        m = self._p.getMatrixFromQuaternion(quaternion)
        a, b, c = self._offset
        x = position[0] - (m[0] * a + m[1] * b + m[2] * c)
        y = position[1] - (m[3] * a + m[4] * b + m[5] * c)
        return x, y, float(np.arctan2(m[3], m[0]))

    def reset(self, x: Floats) -> None:
        """Put the robot at rest at a pose."""
        i, j, k = self._plant.pose
        heading = float(x[k])
        p = self._p
        p.restoreState(self._rest)
        quaternion = p.getQuaternionFromEuler([0, 0, heading])
        cos, sin = np.cos(heading), np.sin(heading)
        a, b, _ = self._offset
        place = [float(x[i]) + cos * a - sin * b, float(x[j]) + sin * a + cos * b, self._height]
        p.resetBasePositionAndOrientation(self._body, place, quaternion)
        p.resetBaseVelocity(self._body, [0, 0, 0], [0, 0, 0])
        for wheel in self._wheels:
            p.resetJointState(self._body, wheel, 0.0, 0.0)
        self._turned = heading
        for memory in self._memory:
            memory.rest(0.0)

    def advance(self, u: Floats) -> Floats:
        """Hold (linear, angular) for tau: -> pose, the heading continued without wrapping; `path` holds the way."""
        a, b = self._plant.commands
        self._command(float(u[a]), float(u[b]))
        felt = [m.step(float(c), self._section.poses) for m, c in zip(self._memory, u, strict=False)]
        order = list(self._plant.pose)
        for n in range(self._section.poses):
            if felt:
                self._command(float(felt[a][n]), float(felt[b][n]))
            self._p.stepSimulation()
            x, y, heading = self._pose()
            self._turned += float(np.remainder(heading - self._turned + np.pi, 2.0 * np.pi) - np.pi)
            self.path[n, order] = x, y, self._turned
        return self.path[-1].copy()

    def responses(self, history: Floats, inputs: Floats, heading: float = 0.0) -> Floats:
        """Paths in the body frame of the pose that a history of inputs (k, nu) leads to, from rest.

        -> (M, poses, 3), one for each of the inputs (M, nu).
        """
        start = np.zeros(3)
        start[self._plant.pose[2]] = heading
        self.reset(start)
        here = start
        for u in history:
            here = self.advance(u)
        kept, remembered = self._p.saveState(), copy.deepcopy(self._memory)
        turned = self._turned
        out = np.empty((len(inputs), *self.path.shape))
        for m, u in enumerate(inputs):
            self._p.restoreState(kept)
            self._turned, self._memory = turned, copy.deepcopy(remembered)
            self.advance(u)
            out[m] = self._in_body_frame(here)
        self._p.removeState(kept)
        return out

    def chain(self, start: Floats, inputs: Floats) -> tuple[Floats, Floats]:
        """Run inputs (k, nu) one after the other from rest: -> poses (k + 1, 3), paths (k, poses, 3) in body frames."""
        self.reset(start)
        poses = np.empty((len(inputs) + 1, 3))
        poses[0] = start
        paths = np.empty((len(inputs), *self.path.shape))
        for n, u in enumerate(inputs):
            poses[n + 1] = self.advance(u)
            paths[n] = self._in_body_frame(poses[n])
        return poses, paths

    def _in_body_frame(self, origin: Floats) -> Floats:
        i, j, k = self._plant.pose
        cos, sin = np.cos(origin[k]), np.sin(origin[k])
        d = self.path - origin
        out = np.empty_like(d)
        out[:, i] = cos * d[:, i] + sin * d[:, j]
        out[:, j] = -sin * d[:, i] + cos * d[:, j]
        out[:, k] = d[:, k]
        return out

    def close(self) -> None:
        """Disconnect from the engine."""
        self._p.disconnect()
