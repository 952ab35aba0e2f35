"""Plants made of joints: where states and inputs stand, the forces that effects add, what engines over a URDF share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.plant import AddedEffect
from simgap.effects import StaticInputEffect, effect
from simgap.effects.base import CoordinateEffect, Effect
from simgap.effects.commands import DriveEffect, InputEffect
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.plants.urdf_checks import check_joint_units
from simgap.simulators.base import Engine, Simulator
from simgap.simulators.commands import check_lagged, command_after, with_commands

Forces = Callable[..., Sequence[float]]


@dataclass(frozen=True)
class JointPlant:
    """Joints of a model file and where their positions, velocities and torques stand in x and u.

    `inputs[k]` lists, for joint k, the indices of the inputs that drive it.
    """

    file: Path
    joints: tuple[str, ...]
    positions: tuple[int, ...]
    velocities: tuple[int, ...]
    inputs: tuple[tuple[int, ...], ...]
    input_names: tuple[str, ...]
    tau: float
    gravity: float = 9.81

    @property
    def nx(self) -> int:
        """Number of states."""
        return 2 * len(self.joints)

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return len(self.input_names)


def joint_plant(case: Case, folder: Path) -> JointPlant:
    """Joints of a case, and where its states and inputs stand.

    Raises:
        UserError: if the case has no model file for the engine, or no domain.
    """
    plant, section, domain = case.plant, case.simulator, case.domain
    own = (section.urdf, getattr(section, "mjcf", None)) if section is not None else ()
    file = next((name for name in own if name is not None), plant.urdf)
    if file is None or domain is None:
        raise UserError("the simulator needs a model file and a domain", key="simulator.urdf", remedy="Give both.")
    if reading.is_file(folder / file):  # else the engine says so
        check_joint_units(plant, folder / file)
    names = list(plant.states)
    joints = tuple(s.joint for s in plant.states.values() if s.quantity == "position" and s.joint)
    place = {(s.joint, s.quantity): names.index(n) for n, s in plant.states.items()}
    return JointPlant(
        file=folder / file,
        joints=joints,
        positions=tuple(place[j, "position"] for j in joints),
        velocities=tuple(place[j, "velocity"] for j in joints),
        inputs=tuple(tuple(k for k, i in enumerate(plant.inputs.values()) if i.joint == j) for j in joints),
        input_names=tuple(plant.inputs),
        tau=domain.tau,
        gravity=plant.gravity,
    )


def joint_forces(plant: JointPlant, effects: Sequence[AddedEffect]) -> Forces | None:
    """The force on each joint as a function of its position, velocity and the commands; None if nothing is declared.

    Signature: (q_0, ..., v_0, ..., u_0, ...) -> (force_0, ...).

    Raises:
        UserError: an effect that cannot be applied as a force at each engine step.
    """
    if not effects:
        return None
    q, v = ([sp.Symbol(f"{kind}{k}", real=True) for k in range(len(plant.joints))] for kind in "qv")
    u = [sp.Symbol(f"u{k}", real=True) for k in range(plant.nu)]
    applied = [command_after(effects, name, command) for name, command in zip(plant.input_names, u, strict=True)]
    extra: list[sp.Expr] = [sp.Integer(0)] * len(plant.joints)
    for number, added in enumerate(effects):
        kind = effect(added.name)
        kind.check_values(added.parameters)
        values = {name: sp.Float(value) for name, value in added.parameters.items()}
        if isinstance(kind, CoordinateEffect) and added.on in plant.joints:
            k = plant.joints.index(added.on)
            extra[k] += kind.force(q[k], v[k], values)
        elif not (isinstance(kind, StaticInputEffect | DriveEffect) and added.on in plant.input_names):
            problem = f"the simulator cannot apply '{added.name}' on '{added.on}' at each step"
            remedy = f"It takes forces on {list(plant.joints)} and changes of {list(plant.input_names)}."
            raise UserError(problem, key=f"simulator.effects.{number}.on", remedy=remedy)
    forces = []
    for k, drive in enumerate(plant.inputs):
        given = [command_after(effects, plant.input_names[i], applied[i], v[k]) for i in drive]
        forces.append(sp.Add(extra[k], *given))
    function: Any = sp.lambdify([*q, *v, *u], forces, modules="math", cse=True)
    return function


class JointEngine(Engine):
    """An engine whose whole state is the positions and velocities of its joints, of which a subclass has primitives."""

    @abstractmethod
    def __init__(self, plant: JointPlant, section: Any) -> None:
        """Load the plant with the settings of the case; a subclass does so after this."""
        self.nx, self.nu = plant.nx, plant.nu
        self._plant, self._substeps = plant, section.substeps
        self._places = [*plant.positions, *plant.velocities]
        self._forces = joint_forces(plant, section.effects)

    @abstractmethod
    def _read(self) -> tuple[Sequence[float] | Floats, Sequence[float] | Floats]:
        """Positions and velocities of the plant's joints."""

    @abstractmethod
    def _step(self, torques: Sequence[float]) -> None:
        """One engine step under a force on each joint."""

    def advance(self, u: Floats) -> Floats:
        """Hold u (nu,) for tau, effects evaluated at every engine step: -> (nx,)."""
        commands = u.tolist()
        torques: Sequence[float] = [sum(commands[i] for i in drive) for drive in self._plant.inputs]
        for _ in range(self._substeps):
            if self._forces is not None:
                q, v = self._read()
                torques = self._forces(*q, *v, *commands)
            self._step(torques)
        q, v = self._read()
        x = np.empty(self.nx)
        x[self._places] = *q, *v
        return x

    @classmethod
    def acts_out(cls, effect: Effect) -> bool:
        """Forces on coordinates, every change of a command, and what a drive makes of it at its speed."""

        return isinstance(effect, CoordinateEffect | InputEffect | DriveEffect)

    @classmethod
    def of_its_own(cls, case: Case) -> bool:
        """Another model file than the plant's may differ in anything."""
        section = case.simulator
        return section is not None and section.urdf is not None and section.urdf != case.plant.urdf

    @classmethod
    def build(cls, case: Case, folder: Path) -> Simulator:
        """The engine itself, or, where an input is delayed or lags, the engine a step at a time behind its commands.

        Raises:
            UserError: no model file, no domain, or a lagged state of the plant that does not lag in the simulator.
        """
        plant, section = joint_plant(case, folder), case.simulator
        check_lagged(case)
        if section is None or not any(effect(e.name).remembers for e in section.effects):
            return cls(plant, section)
        a_step = replace(plant, tau=plant.tau / section.substeps)
        return with_commands(
            case, lambda effects: cls(a_step, section.model_copy(update={"substeps": 1, "effects": effects}))
        )
