"""A short drive and a short turn of a wheeled robot in its engine: does it go where its wheels should take it?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simgap.config.case import Case
from simgap.simulators.wheeled_engine import WheeledEngine

LONG = 2.0
"""How long a command is held, s: motors of the shipped robots need up to half a second, and with a twentieth of their
torque they come to a third of their speed in this time."""


@dataclass(frozen=True)
class Drive:
    """What a command, held from rest, came to in the last sampling time of it.

    Attributes:
        straight: whether to go straight on was the aim, or to turn.
        told: linear and angular velocity, m/s, rad/s.
        moved: forwards, sideways and about the vertical, m/s, m/s, rad/s.
        asked, turning: rates that the wheels' motors were asked for, and have, left and right, rad/s.
        height: of the root above the floor, m; leans: from upright, rad.
    """

    straight: bool
    told: tuple[float, float]
    moved: tuple[float, float, float]
    asked: tuple[float, float]
    turning: tuple[float, float]
    height: float
    leans: float


def drives(case: Case, folder: Path) -> list[Drive]:
    """Straight on at the largest speed of U, then turning at the largest rate; without the effects of the simulator.

    To be called in the engine's process. Empty for an engine of anything but wheeled robots.

    Raises:
        UserError: as the engine's own.
    """
    from simgap.simulators.build import make_simulator

    if case.plant.symbolic is None or case.plant.symbolic.wheels is None:
        return []  # of no wheeled robot: not even built
    plain = case.simulator.model_copy(update={"effects": ()}) if case.simulator is not None else None
    robot = make_simulator(case.model_copy(update={"simulator": plain}), folder)
    try:
        return [_drive(robot, case, *told) for told in _commands(case)] if isinstance(robot, WheeledEngine) else []
    finally:
        robot.close()


def _commands(case: Case) -> list[tuple[bool, float, float]]:
    """The largest speed with the least turning, and the other way round; none that would not move."""
    wheels = case.plant.symbolic.wheels if case.plant.symbolic else None
    if wheels is None or case.domain is None:
        return []
    linear, angular = (case.domain.U[name].list() for name in (wheels.linear, wheels.angular))
    straight = max(linear, key=lambda v: (abs(v), v)), min(angular, key=abs)
    turn = min(linear, key=abs), max(angular, key=lambda w: (abs(w), w))
    return [told for told, own in (((True, *straight), straight[0]), ((False, *turn), turn[1])) if own != 0.0]


def _drive(robot: WheeledEngine, case: Case, straight: bool, linear: float, angular: float) -> Drive:
    tau = case.domain.tau if case.domain is not None else 1.0
    a, b = robot.commands
    u = np.zeros(2)
    u[a], u[b] = linear, angular
    _, paths = robot.chain(np.zeros(3), np.tile(u, (max(2, int(np.ceil(LONG / tau))), 1)))
    x, y, turn = (float(paths[-1, -1, k]) for k in robot.pose)
    forwards, sideways = _in_the_body(x / tau, y / tau, turn)
    height, leans = robot.standing()
    return Drive(
        straight,
        (linear, angular),
        (forwards, sideways, turn / tau),
        robot.wheel_rates(linear, angular),
        robot.turning(),
        height,
        leans,
    )


def _in_the_body(x: float, y: float, turn: float) -> tuple[float, float]:
    """Mean speeds along and across a body that turns evenly, from those of its chord as it stood at the beginning.

    A chord of an arc leaves at half of its angle, and is shorter than it by sin(h)/h.
    """
    h = 0.5 * turn
    along, across = np.cos(h) * x + np.sin(h) * y, np.cos(h) * y - np.sin(h) * x
    short = max(float(np.sinc(h / np.pi)), 0.1)  # near a whole turn there is no chord to be lengthened
    return float(along) / short, float(across) / short
