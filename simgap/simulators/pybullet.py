"""PyBullet over a URDF: joints, and a robot on two driven wheels.

Joints have their motors off; every damping and the handling of inertia are explicit. The robot's wheels are in
frictional contact with a floor and driven by torque-limited velocity motors. Contacts and motors are solved directly
(Dantzig's pivoting): sequential impulses, PyBullet's default, need some 200 iterations a step to forget in which order
and along which axes of the world they work. Where the direct solver finds no solution Bullet takes them instead.

The robot's state in the engine is larger than the pose: wheel and body velocities, contact caches. `reset` restores a
saved state of the robot at rest before it moves the robot, so that nothing of an earlier roll-out is left; `responses`
restores the saved state that a history of inputs leaves behind. The same arguments give the same bits in any order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from simgap.arrays import Floats
from simgap.config.simulator import Damping, EngineSection
from simgap.errors import UserError, optional
from simgap.plants.model_file import Link, read_model_file
from simgap.plants.urdf_checks import check_urdf, loading
from simgap.simulators.base import FileTraits
from simgap.simulators.commands import CommandPath
from simgap.simulators.joints import JointEngine, JointPlant
from simgap.simulators.wheeled import WheeledEngine, WheeledPlant, WheeledSettings


class PyBulletSettings(EngineSection):
    """PyBullet over the plant's URDF: joints driven by torques, default motors off."""

    engine: Literal["pybullet"] = "pybullet"
    """Name of the engine."""
    inertia: Literal["engine", "file"]
    """engine: PyBullet's default, which ignores the URDF's inertia; file: the URDF's inertia."""
    damping: Damping = Damping()
    """Damping that the engine adds on its own."""


class PyBulletJoints(JointEngine):
    """`f_hat` of a fixed-base plant; its whole state is (q, v), so a reset leaves nothing behind."""

    Settings = PyBulletSettings
    distributions = ("pybullet",)
    file_traits = FileTraits(stops=True, damps_links=True, fastest=100.0)

    def __init__(self, plant: JointPlant, section: PyBulletSettings) -> None:
        self._native, self._p = _connected()
        check_urdf(plant.file)
        super().__init__(plant, section)
        self.engine = f"pybullet {self._native.getAPIVersion()}"
        self._client = self._p._client
        self._body, self._joints = self._load(section)
        # A torque that nobody sets is 0 after each step anyway.
        self._driven = [k for k, drive in enumerate(plant.inputs) if drive or self._forces is not None]
        self._single = len(self._joints) == 1 and self._forces is None and plant.inputs == ((0,),)

    def _load(self, section: PyBulletSettings) -> tuple[int, tuple[int, ...]]:
        p, plant, d = self._p, self._plant, section.damping
        p.setGravity(0, 0, -plant.gravity)
        p.setTimeStep(plant.tau / section.substeps)
        flags = p.URDF_USE_INERTIA_FROM_FILE if section.inertia == "file" else 0
        with loading("PyBullet", plant.file):
            body = p.loadURDF(str(plant.file), useFixedBase=True, flags=flags)
        index = _numbers(p, body, JOINT)
        for j in (-1, *index.values()):
            p.changeDynamics(body, j, linearDamping=d.linear, angularDamping=d.angular, jointDamping=d.joint)
        for j in index.values():
            p.setJointMotorControl2(body, j, p.VELOCITY_CONTROL, force=0)
        without_mass(p, body, plant.file)
        return body, tuple(index[name] for name in plant.joints)

    def loaded(self) -> Mapping[str, Link]:
        """See `Simulator.loaded`."""
        return links_of(self._p, self._body)

    def reset(self, x: Floats) -> None:
        """Set every joint's position and velocity: x (nx,)."""
        place, body, client, values = self._native.resetJointState, self._body, self._client, x.tolist()
        for j, a, b in zip(self._joints, self._plant.positions, self._plant.velocities, strict=True):
            place(body, j, values[a], values[b], client)

    def _read(self) -> tuple[list[float], list[float]]:
        states = [self._native.getJointState(self._body, j, self._client) for j in self._joints]
        return [s[0] for s in states], [s[1] for s in states]

    def _step(self, torques: Sequence[float]) -> None:
        p, body, client = self._native, self._body, self._client
        for k in self._driven:
            j, torque = self._joints[k], torques[k]
            p.setJointMotorControl2(body, j, p.TORQUE_CONTROL, force=torque, physicsClientId=client)
        p.stepSimulation(client)

    def rollouts(self, x: Floats, u: Floats) -> Floats:
        """One step from each state: (n, nx), (n, nu) -> (n, nx); of one joint without effects in half the time."""
        if not self._single:
            return super().rollouts(x, u)
        p, body, (j,), client = self._native, self._body, self._joints, self._client
        place, drive, step, read = p.resetJointState, p.setJointMotorControl2, p.stepSimulation, p.getJointState
        mode, again, rows = p.TORQUE_CONTROL, range(self._substeps), []
        for (q, v), torque in zip(x[:, self._places].tolist(), u[:, 0].tolist(), strict=True):
            place(body, j, q, v, client)
            for _ in again:
                drive(body, j, mode, force=torque, physicsClientId=client)
                step(client)
            rows.append(read(body, j, client)[:2])
        out = np.empty_like(x)
        out[:, self._places] = rows
        return out

    def close(self) -> None:
        """Disconnect from the engine."""
        self._p.disconnect()


def _connected() -> tuple[Any, Any]:
    """PyBullet's module, and a client; this looks every function up anew, which costs more than a step or a pose does.

    Raises:
        UserError: PyBullet is not installed.
    """
    with optional("PyBullet", "pybullet"):
        import pybullet
        from pybullet_utils.bullet_client import BulletClient  # type: ignore[import-untyped]
    return pybullet, BulletClient(pybullet.DIRECT)


def without_mass(p: Any, body: int, urdf: Path) -> None:
    """Take from links without `<inertial>` the 1 kg and 1, 1, 1 kg m^2 that PyBullet invents for them.

    Frames of sensors and tools on fixed joints are written like that; Drake gives them no mass. The root is left as it
    is: where it is welded to the world its inertia moves nothing, and where it floats one without is refused
    (`check_floating_root`).
    """
    bare = set(read_model_file(urdf).bare)
    for name, j in _numbers(p, body, LINK).items():
        if name in bare:
            p.changeDynamics(body, j, mass=0.0, localInertiaDiagonal=[0.0, 0.0, 0.0])


def links_of(p: Any, body: int) -> Mapping[str, Link]:
    """Mass, principal moments and centre of mass of every link but the root, by name."""
    told = {name: p.getDynamicsInfo(body, j) for name, j in _numbers(p, body, LINK).items()}
    return {name: Link(float(own[0]), np.sort(own[2]), np.array(own[3])) for name, own in told.items()}


JOINT, LINK = 1, 12  # places of their names in what PyBullet tells of a joint


def _numbers(p: Any, body: int, place: int) -> dict[str, int]:
    """Names of joints or links and their numbers; a link has the number of the joint that it hangs on."""
    return {p.getJointInfo(body, j)[place].decode(): j for j in range(p.getNumJoints(body))}


CONTACT_BREAKING = 0.2
"""Distance at which a contact point is dropped, as a share of a shape's radius (so Bullet reads it): 7.6 mm for a wheel
of 38 mm. Below a few mm a wheel that hops by a fraction of a millimetre loses its contact, falls freely for an engine
step and turns the robot by up to some hundredths of a radian, at some headings and not at others."""
SOFTNESS = 1e-8
"""Constraint force mixing: the velocity, m/s, by which a contact gives way to an impulse of 1 N s, times the time of an
engine step. Two wheels on an axle both hold the robot against sliding along it, so that without it the direct solver
meets a singular matrix seven times in ten; with it the impulse that carries the robot moves a contact by 1e-6 m/s."""
SETTLED = 1e-8
"""Sum of squares of the velocity changes, (m/s)^2, at which an iteration of the contact solver is the last."""


class PyBulletWheeled(WheeledEngine):
    """`f_hat` of the robot: states x, y, heading (not wrapped); inputs linear and angular velocity."""

    Settings = WheeledSettings
    distributions = ("pybullet",)

    def __init__(self, plant: WheeledPlant, section: WheeledSettings, paths: Sequence[CommandPath] = ()) -> None:
        self._native, self._p = _connected()
        super().__init__(plant, section, paths)
        self._poses: list[Any] = [None] * section.poses
        self.engine = f"pybullet {self._native.getAPIVersion()}"
        self._body, self._wheels = self._load()
        # Bullet's body frame is at the centre of mass, along the principal axes of inertia: seen from the root
        place, self._axes = self._p.getDynamicsInfo(self._body, -1)[3:5]
        self._offset = np.array(place)
        self._from_axes = np.array(self._native.getMatrixFromQuaternion(self._axes)).reshape(3, 3).T
        self._aligned = bool(np.array_equal(self._from_axes, np.eye(3)))
        self._height = self._settled_height()
        self._rest = self._kept()

    def _load(self) -> tuple[int, tuple[int, int]]:
        p, s = self._p, self._section
        p.setGravity(0, 0, -self._plant.gravity)
        p.setPhysicsEngineParameter(
            fixedTimeStep=self._plant.tau / s.poses,
            numSubSteps=s.substeps // s.poses,
            deterministicOverlappingPairs=1,
            enableConeFriction=1,
            contactBreakingThreshold=CONTACT_BREAKING,
            constraintSolverType=p.CONSTRAINT_SOLVER_LCP_DANTZIG,
            globalCFM=SOFTNESS,
            numSolverIterations=s.solver_iterations,
            solverResidualThreshold=SETTLED,
        )
        floor = p.createMultiBody(0, p.createCollisionShape(p.GEOM_PLANE))
        p.changeDynamics(floor, -1, lateralFriction=s.floor_friction, restitution=0)
        urdf, place = self._plant.urdf, [0, 0, s.wheel_radius]
        with loading("PyBullet", urdf):
            body = p.loadURDF(str(urdf), place, flags=p.URDF_USE_INERTIA_FROM_FILE)
        index = _numbers(p, body, JOINT)
        for link in (-1, *index.values()):
            p.changeDynamics(
                body, link, linearDamping=0, angularDamping=0, jointDamping=0, rollingFriction=0, spinningFriction=0,
                restitution=0, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
            )  # fmt: skip
        without_mass(p, body, self._plant.urdf)
        grip = max(p.getDynamicsInfo(body, link)[1] for link in (-1, *index.values()))
        if grip > 1.0:  # how far a path may stray between poses counts on the floor's friction alone
            problem = f"a link has the lateral friction {grip:g}; what the floor gives is multiplied by it"
            remedy = "State at most 1 there and the rest in simulator.floor_friction."
            raise UserError(problem, file=self._plant.urdf, key="<lateral_friction>", remedy=remedy)
        p.setCollisionFilterPair(body, floor, -1, -1, 0)  # the body hangs clear of the floor; asking costs a third
        if s.payload:
            mass, _, inertia = p.getDynamicsInfo(body, -1)[:3]
            scale = 1.0 + s.payload / mass
            p.changeDynamics(body, -1, mass=mass * scale, localInertiaDiagonal=[scale * i for i in inertia])
        return body, (index[s.left], index[s.right])

    def loaded(self) -> Mapping[str, Link]:
        """See `Simulator.loaded`."""
        return links_of(self._p, self._body)

    def _settled_height(self) -> float:
        """Let the robot stand until its contacts carry it: height of its centre of mass, m."""
        self._command(0.0, 0.0)
        for _ in range(int(np.ceil(self._section.settle * self._section.poses / self._plant.tau))):
            self._p.stepSimulation()
        return float(self._p.getBasePositionAndOrientation(self._body)[0][2])

    def _command(self, linear: float, angular: float) -> None:
        s = self._section
        # PyBullet limits a motor's impulse by force times the outer time step whatever the number of sub-steps
        force = s.torque / (s.substeps // s.poses)
        rates, mode = self.wheel_rates(linear, angular), self._p.VELOCITY_CONTROL
        drive = self._p.setJointMotorControlArray
        drive(self._body, self._wheels, mode, targetVelocities=rates, forces=[force, force])

    def _place(self, x: float, y: float, heading: float) -> None:
        p = self._p
        quaternion = p.getQuaternionFromEuler([0, 0, heading])
        if not self._aligned:
            quaternion = p.multiplyTransforms([0, 0, 0], quaternion, [0, 0, 0], self._axes)[1]
        cos, sin = np.cos(heading), np.sin(heading)
        a, b, _ = self._offset
        place = [x + cos * a - sin * b, y + sin * a + cos * b, self._height]
        p.resetBasePositionAndOrientation(self._body, place, quaternion)
        p.resetBaseVelocity(self._body, [0, 0, 0], [0, 0, 0])
        for wheel in self._wheels:
            p.resetJointState(self._body, wheel, 0.0, 0.0)

    def _step_to_pose(self, n: int) -> None:
        client = self._p._client
        self._native.stepSimulation(physicsClientId=client)
        self._poses[n] = self._native.getBasePositionAndOrientation(self._body, physicsClientId=client)

    def _complete_path(self, u: Floats) -> None:
        """From positions and quaternions of the centre of mass to poses of the root frame."""
        turn = self._native.getMatrixFromQuaternion
        place = np.array([position for position, _ in self._poses])
        m = np.array([turn(quaternion) for _, quaternion in self._poses])
        if not self._aligned:
            m = (m.reshape(-1, 3, 3) @ self._from_axes).reshape(-1, 9)
        a, b, c = self._offset
        x = place[:, 0] - (m[:, 0] * a + m[:, 1] * b + m[:, 2] * c)
        y = place[:, 1] - (m[:, 3] * a + m[:, 4] * b + m[:, 5] * c)
        for n, heading in enumerate(np.arctan2(m[:, 3], m[:, 0]).tolist()):
            self._record(n, x[n], y[n], heading)

    def turning(self) -> tuple[float, float]:
        """See `WheeledEngine.turning`."""
        left, right = (float(self._p.getJointState(self._body, wheel)[1]) for wheel in self._wheels)
        return left, right

    def standing(self) -> tuple[float, float]:
        """See `WheeledEngine.standing`."""
        place, quaternion = self._p.getBasePositionAndOrientation(self._body)
        turned = np.array(self._native.getMatrixFromQuaternion(quaternion)).reshape(3, 3) @ self._from_axes
        return float(place[2] - turned[2] @ self._offset), float(np.arccos(np.clip(turned[2, 2], -1.0, 1.0)))

    def _kept(self) -> int:
        """The number of a saved state, contacts included."""
        return int(self._p.saveState())

    def _return_to(self, kept: int) -> None:
        self._p.restoreState(kept)

    def _forget(self, kept: int) -> None:
        self._p.removeState(kept)

    def close(self) -> None:
        """Disconnect from the engine."""
        self._p.disconnect()
