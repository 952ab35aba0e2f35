"""PyBullet over a URDF of joints: motors off, every damping explicit, inertia handling explicit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from simgap.arrays import Floats
from simgap.config.simulator import Damping, EngineSection
from simgap.errors import UserError, optional
from simgap.plants.model_file import Link, read_model_file
from simgap.plants.urdf_checks import check_urdf, loading
from simgap.simulators.base import FileTraits
from simgap.simulators.joints import JointEngine, JointPlant


class PyBulletSettings(EngineSection):
    """PyBullet over the plant's URDF: joints driven by torques, default motors off."""

    engine: Literal["pybullet"] = Field("pybullet", description="Which engine.")
    inertia: Literal["engine", "file"] = Field(
        description="engine: PyBullet's default, which ignores the URDF's inertia; file: the URDF's inertia."
    )
    damping: Damping = Field(Damping(), description="Damping that the engine adds on its own.")


class PyBulletJoints(JointEngine):
    """`f_hat` of a fixed-base plant; its whole state is (q, v), so a reset leaves nothing behind."""

    Settings = PyBulletSettings
    distributions = ("pybullet",)
    file_traits = FileTraits(stops=True, damps_links=True, fastest=100.0)

    def __init__(self, plant: JointPlant, section: PyBulletSettings) -> None:
        with optional("PyBullet", "pybullet"):
            import pybullet as p

        check_urdf(plant.file)
        super().__init__(plant, section)
        self.engine = f"pybullet {p.getAPIVersion()}"
        self._p: Any = p
        self._client = p.connect(p.DIRECT)
        self._body, self._joints = self._load(section)
        self._position, self._velocity = plant.positions, plant.velocities
        # A torque that nobody sets is 0 after each step anyway.
        self._driven = [k for k, drive in enumerate(plant.inputs) if drive or self._forces is not None]
        self._single = len(self._joints) == 1 and self._forces is None and plant.inputs == ((0,),)

    def _load(self, section: PyBulletSettings) -> tuple[int, tuple[int, ...]]:
        p, client, plant = self._p, self._client, self._plant
        p.setGravity(0, 0, -plant.gravity, physicsClientId=client)
        p.setTimeStep(plant.tau / section.substeps, physicsClientId=client)
        flags = p.URDF_USE_INERTIA_FROM_FILE if section.inertia == "file" else 0
        with loading("PyBullet", plant.file):
            body = p.loadURDF(str(plant.file), useFixedBase=True, flags=flags, physicsClientId=client)
        index: dict[str, int] = {}
        for j in range(-1, p.getNumJoints(body, physicsClientId=client)):
            d = section.damping
            p.changeDynamics(
                body, j, linearDamping=d.linear, angularDamping=d.angular, jointDamping=d.joint, physicsClientId=client
            )
            if j >= 0:
                index[p.getJointInfo(body, j, physicsClientId=client)[1].decode()] = j
                p.setJointMotorControl2(body, j, p.VELOCITY_CONTROL, force=0, physicsClientId=client)
        without_mass(p, client, body, plant.file)
        missing = [name for name in plant.joints if name not in index]
        if missing:
            raise UserError(f"no joint called {missing}", file=plant.file, remedy=f"It has {sorted(index)}.")
        return body, tuple(index[name] for name in plant.joints)

    def loaded(self) -> Mapping[str, Link]:
        """See `Simulator.loaded`."""
        return links_of(self._p, self._client, self._body)

    def reset(self, x: Floats) -> None:
        """Set every joint's position and velocity: x (nx,)."""
        for j, a, b in zip(self._joints, self._position, self._velocity, strict=True):
            self._p.resetJointState(self._body, j, x[a], x[b], physicsClientId=self._client)

    def advance(self, u: Floats) -> Floats:
        """See `JointEngine.advance`; one joint under one input without effects takes the same calls with no loop."""
        if not self._single:
            return super().advance(u)
        p, body, (j,), client, torque = self._p, self._body, self._joints, self._client, float(u[0])
        for _ in range(self._substeps):
            p.setJointMotorControl2(body, j, p.TORQUE_CONTROL, force=torque, physicsClientId=client)
            p.stepSimulation(client)
        q, v = p.getJointState(body, j, client)[:2]
        return np.array((q, v) if self._position == (0,) else (v, q))

    def _read(self) -> tuple[list[float], list[float]]:
        states = [self._p.getJointState(self._body, j, physicsClientId=self._client) for j in self._joints]
        return [s[0] for s in states], [s[1] for s in states]

    def _step(self, torques: Sequence[float]) -> None:
        p, client = self._p, self._client
        for k in self._driven:
            p.setJointMotorControl2(
                self._body, self._joints[k], p.TORQUE_CONTROL, force=torques[k], physicsClientId=client
            )
        p.stepSimulation(client)

    def rollouts(self, x: Floats, u: Floats) -> Floats:
        """One step from each state: (n, nx), (n, nu) -> (n, nx)."""
        if not self._single:
            return super().rollouts(x, u)
        p, body, (j,), client = self._p, self._body, self._joints, self._client
        (a,), (b,) = self._position, self._velocity
        reset, drive, step, read, mode = (
            p.resetJointState,
            p.setJointMotorControl2,
            p.stepSimulation,
            p.getJointState,
            p.TORQUE_CONTROL,
        )
        out = np.empty_like(x)
        again = range(self._substeps)
        rows = []
        for q, v, torque in zip(x[:, a].tolist(), x[:, b].tolist(), u[:, 0].tolist(), strict=True):
            reset(body, j, q, v, client)
            for _ in again:
                drive(body, j, mode, force=torque, physicsClientId=client)
                step(client)
            rows.append(read(body, j, client)[:2])
        out[:, [a, b]] = rows
        return out

    def close(self) -> None:
        """Disconnect from the engine."""
        self._p.disconnect(self._client)


def without_mass(p: Any, client: int, body: int, urdf: Path) -> None:
    """Take from links without `<inertial>` the 1 kg and 1, 1, 1 kg m^2 that PyBullet invents for them.

    Frames of sensors and tools on fixed joints are written like that; Drake gives them no mass. The root is left as it
    is: where it is welded to the world its inertia moves nothing, and where it floats one without is refused
    (`check_floating_root`).
    """
    bare = set(read_model_file(urdf).bare)
    for name, j in _numbers(p, client, body).items():
        if name in bare:
            p.changeDynamics(body, j, mass=0.0, localInertiaDiagonal=[0.0, 0.0, 0.0], physicsClientId=client)


def links_of(p: Any, client: int, body: int) -> Mapping[str, Link]:
    """Mass, principal moments and centre of mass of every link but the root, by name."""
    found = {}
    for name, j in _numbers(p, client, body).items():
        info = p.getDynamicsInfo(body, j, physicsClientId=client)
        found[name] = Link(float(info[0]), np.sort(info[2]), np.array(info[3]))
    return found


def _numbers(p: Any, client: int, body: int) -> dict[str, int]:
    """Link names and their numbers; a link has the number of the joint that it hangs on."""
    count = p.getNumJoints(body, physicsClientId=client)
    return {p.getJointInfo(body, j, physicsClientId=client)[12].decode(): j for j in range(count)}
