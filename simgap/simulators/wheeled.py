"""Planar wheeled robots: roles of states and inputs, chains of inputs, paths seen from where an input began."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.plant import AddedEffect
from simgap.config.simulator import EngineSection
from simgap.effects import effect
from simgap.effects.base import Effect, WheelEffect
from simgap.effects.commands import InputEffect
from simgap.errors import UserError
from simgap.plants.urdf_checks import check_floating_root, check_urdf, check_wheels
from simgap.simulators.base import Engine, FileTraits, PathSimulator
from simgap.simulators.body_samples import to_body
from simgap.simulators.commands import CommandMemory, CommandPath, case_command_paths


@dataclass(frozen=True)
class WheeledPlant:
    """Places of pose and commands among the states and inputs, and the sampling time (s)."""

    urdf: Path
    tau: float
    gravity: float = 9.81
    pose: tuple[int, int, int] = (0, 1, 2)
    commands: tuple[int, int] = (0, 1)


def wheeled_plant(case: Case, folder: Path) -> WheeledPlant:
    """Places of the roles of `plant.symbolic.wheels` in the case.

    Raises:
        UserError: a plant whose states and inputs are not those of a planar wheeled robot.
    """
    plant, section, domain = case.plant, case.simulator, case.domain
    wheels = plant.symbolic.wheels if plant.symbolic else None
    states, inputs = list(plant.states), list(plant.inputs)
    if wheels is None or domain is None or section is None or section.urdf is None:
        problem = "a wheeled simulator needs plant.symbolic.wheels and a domain"
        remedy = "Name the states x, y, heading and the inputs linear, angular."
        raise UserError(problem, key="plant.symbolic.wheels", remedy=remedy)
    pose, commands = (wheels.x, wheels.y, wheels.heading), (wheels.linear, wheels.angular)
    if sorted(states) != sorted(pose) or sorted(inputs) != sorted(commands):
        raise UserError(
            f"wheels are {pose} and {commands}, the plant has {states} and {inputs}", key="plant.symbolic.wheels"
        )
    x, y, heading = (states.index(name) for name in pose)
    linear, angular = (inputs.index(name) for name in commands)
    return WheeledPlant(folder / section.urdf, domain.tau, plant.gravity, (x, y, heading), (linear, angular))


WheelPath = tuple[tuple[WheelEffect, Mapping[str, float]], ...]
"""Effects on the wheels' speeds with their values, the nearest to the command first."""


def wheel_path(effects: Sequence[AddedEffect]) -> WheelPath:
    """Effects that act on the wheels; those on the commands change none of their speeds.

    Raises:
        UserError: missing or unphysical values.
    """
    own = []
    for added in sorted(effects, key=lambda a: -effect(a.name).rank):
        kind = effect(added.name)
        kind.check_values(added.parameters)
        if isinstance(kind, WheelEffect):
            own.append((kind, added.parameters))
    return tuple(own)


class WheeledSettings(EngineSection):
    """PyBullet over a differential-drive URDF: wheels in contact with a floor, torque-limited velocity motors."""

    engine: Literal["pybullet_wheeled"] = "pybullet_wheeled"
    """Name of the engine."""
    urdf: str
    """Model file, relative to the case file; its root, midway between the wheels, has mass and inertia."""
    left: str = "left_wheel"
    """Joint of the left wheel."""
    right: str = "right_wheel"
    """Joint of the right wheel."""
    wheel_radius: float = Field(gt=0)
    """Radius that turns speeds into wheel speeds, m."""
    track: float = Field(gt=0)
    """Distance between the wheels that turns turning rates into wheel speeds, m."""
    torque: float = Field(gt=0)
    """Largest torque of a wheel motor, N m."""
    floor_friction: float = Field(gt=0)
    """Friction coefficient of the floor (times that of the tyre)."""
    payload: float = Field(0.0, ge=0)
    """Mass added to the base, kg; its inertia is scaled in proportion."""
    substeps: int = Field(100, ge=1)
    """Engine steps within tau."""
    poses: int = Field(20, ge=1)
    """Poses recorded within tau, evenly spaced; divides substeps."""
    solver_iterations: int = Field(100, ge=1)
    """Most iterations of the contact solver in an engine step (in PyBullet, if its direct solver finds no solution).
    With too few, turns differ between headings: friction is solved along the axes of the world."""
    settle: float = Field(0.5, ge=0)
    """Time at rest after loading, before the rest state is saved, s."""
    effects: tuple[AddedEffect, ...] = ()
    """Effects on the commands, delay and lag among them, and on the wheels' speeds."""

    def between_poses(self, tau: float, gravity: float) -> float:
        """a t^2 / 8 for the largest acceleration that the tyres can give, over the time between two poses."""
        return float(self.floor_friction * gravity * (tau / self.poses) ** 2 / 8.0)


class WheeledEngine(Engine, PathSimulator):
    """`f_hat` of the robot: states x, y, heading (not wrapped); inputs linear and angular velocity.

    `path` (poses, 3) holds the poses of the last step, headings continued.
    """

    file_traits = FileTraits(stops=True)
    path: Floats
    _section: WheeledSettings
    _rest: Any

    @classmethod
    def acts_out(cls, effect: Effect) -> bool:
        """Changes of the commands, and of the wheels' speeds."""

        return isinstance(effect, InputEffect | WheelEffect)

    @classmethod
    def of_its_own(cls, case: Case) -> bool:
        """A unicycle has no model file: the robot's is what stands for it."""
        return False

    @classmethod
    def build(cls, case: Case, folder: Path) -> WheeledEngine:
        """The robot of a case with `plant.symbolic.wheels`."""

        section: Any = case.simulator
        return cls(wheeled_plant(case, folder), section, case_command_paths(case) if section.effects else ())

    def __init__(self, plant: WheeledPlant, section: WheeledSettings, paths: Sequence[CommandPath] = ()) -> None:

        self._section = section
        check_urdf(plant.urdf)
        check_floating_root(plant.urdf)
        check_wheels(plant.urdf, section.left, section.right)
        if section.substeps % section.poses:
            problem = f"{section.poses} poses do not divide {section.substeps} sub-steps"
            raise UserError(problem, key="simulator.poses", remedy="Let substeps be a multiple of poses.")
        self.nx, self.nu, self.pose, self.commands = 3, 2, plant.pose, plant.commands
        self._plant, self._wheel_path = plant, wheel_path(section.effects)
        self._memory = [CommandMemory(path, plant.tau) for path in paths]
        self.path, self._turned = np.zeros((section.poses, 3)), 0.0

    def reset(self, x: Floats) -> None:
        """Put the robot at rest at a pose: x (nx,), m and rad."""
        place_x, place_y, heading = (float(x[axis]) for axis in self.pose)
        self._return_to(self._rest)
        self._place(place_x, place_y, heading)
        self._turned = heading
        for memory in self._memory:
            memory.rest(0.0)

    def advance(self, u: Floats) -> Floats:
        """Hold (linear, angular) for tau: -> pose, the heading continued not wrapped; `path` holds the poses on it."""
        a, b = self.commands
        self._command(float(u[a]), float(u[b]))
        poses = self._section.poses
        felt = [m.step(float(c), poses) for m, c in zip(self._memory, u, strict=False)]
        for n in range(poses):
            if felt:
                self._command(float(felt[a][n]), float(felt[b][n]))
            self._step_to_pose(n)
        self._complete_path(u)
        return self.path[-1].copy()

    def _record(self, n: int, x: float, y: float, heading: float) -> None:
        """Pose n of the path, the heading continued and not wrapped."""
        self._turned += (heading - self._turned + np.pi) % (2.0 * np.pi) - np.pi
        i, j, k = self.pose
        self.path[n, i], self.path[n, j], self.path[n, k] = x, y, self._turned

    @abstractmethod
    def _place(self, x: float, y: float, heading: float) -> None:
        """Move the robot, at rest, to a pose."""

    @abstractmethod
    def _command(self, linear: float, angular: float) -> None:
        """Tell the motors the rates of `wheel_rates`."""

    @abstractmethod
    def _step_to_pose(self, n: int) -> None:
        """Run the engine to pose n of the sampling time."""

    @abstractmethod
    def _complete_path(self, u: Floats) -> None:
        """Look at what the engine did under u: `path` holds all poses afterwards."""

    def wheel_rates(self, linear: float, angular: float) -> tuple[float, float]:
        """Rates that the left and the right motor are told, rad/s: the commands as effects on the wheels leave them."""
        half, radius = 0.5 * self._section.track * angular, self._section.wheel_radius
        left, right = linear - half, linear + half
        for kind, values in self._wheel_path:
            left, right = kind.turned(left, right, values)
        return left / radius, right / radius

    @abstractmethod
    def turning(self) -> tuple[float, float]:
        """Rates of the left and the right wheel's joint, rad/s."""

    @abstractmethod
    def standing(self) -> tuple[float, float]:
        """Height of the root above the floor, m, and how far it leans from upright, rad."""

    @abstractmethod
    def _kept(self) -> Any:
        """All of the engine's state that the next step depends on."""

    @abstractmethod
    def _return_to(self, kept: Any) -> None:
        """Put the engine into a kept state."""

    def _forget(self, kept: Any) -> None:
        """Free a kept state."""

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
        return to_body(self.path - origin, origin[self.pose[2]], self.pose)

    def responses(self, history: Floats, inputs: Floats, heading: float = 0.0) -> Floats:
        """Paths in the body frame of the pose that a history of inputs (k, nu) leads to, from rest.

        -> (M, poses, 3), one for each of the inputs (M, nu).
        """
        here = np.zeros(3)
        here[self.pose[2]] = heading
        self.reset(here)
        for u in history:
            here = self.advance(u)
        if len(inputs) == 1:  # keeping a state costs as much as a step
            self.advance(inputs[0])
            return self._in_body_frame(here)[None]
        out = np.empty((len(inputs), *self.path.shape))
        kept, remembered, turned = self._kept(), copy.deepcopy(self._memory), self._turned
        for m, u in enumerate(inputs):
            self._return_to(kept)
            self._turned, self._memory = turned, copy.deepcopy(remembered)
            self.advance(u)
            out[m] = self._in_body_frame(here)
        self._forget(kept)
        return out
