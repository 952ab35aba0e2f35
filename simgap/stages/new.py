"""`simgap new`: a commented case for a robot that simgap has never seen, with numbers that are chosen to run.

Ranges, inputs and grids are round numbers near the model's equilibrium: a beginning to be edited, not a recommendation.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from simgap.config.load import load_case, parse_case
from simgap.errors import UserError
from simgap.geometry import Floats
from simgap.io.atomic import write_text
from simgap.io.pages import text
from simgap.plants.drake_check import accelerations
from simgap.plants.model_file import FileJoint, read_model_file
from simgap.plants.numeric_terms import MOST_DERIVED
from simgap.plants.urdf import multibody_plant

TAU = 0.01
REACH, SPEED = 0.25, 0.5
"""Half-widths of X: rad or m, and the same a second. Judgement: small enough for a first run of a minute."""
AUTHORITY = 2.0
"""Times the accelerations that stop SPEED within REACH, beyond what holds the plant in place. Judgement."""
MOST_CORNERS = 729
"""Of X at which the model is asked what its inputs must do: all of them up to three joints."""
GRAVITY = 9.81
STATES, CELLS = 2500, 40_000
"""Of the first grid of samples, and cells of the first controller. Judgement: a run of a minute or two."""


@dataclass(frozen=True)
class Axis:
    """A moving joint as the case names it: symbols of position, velocity and input, units, its interval of X."""

    joint: str
    position: str
    velocity: str
    drive: str
    unit: str
    force: str
    range: tuple[float, float]

    @property
    def reach(self) -> float:
        """Half the width of its interval."""
        return (self.range[1] - self.range[0]) / 2


def run(name: str, urdf: Path | None, out: Path) -> Path:
    """Write `NAME.yaml` to the folder `out`: for a URDF, or equations to be replaced by one's own.

    Raises:
        UserError: a name that is none, a file that is there already, or a model file that simgap cannot take.
    """
    path = out / f"{name}.yaml"
    if path.exists():
        raise UserError("is there already, and stays as it is", file=path, remedy="Give another name, or move it.")
    content = text("new_equations.yaml.j2", name=name) if urdf is None else _of_urdf(name, urdf, out)
    parse_case(yaml.safe_load(content), path)
    write_text(path, content)
    load_case(path)
    return path


def _of_urdf(name: str, urdf: Path, out: Path) -> str:
    file = read_model_file(urdf)
    axes = _axes(urdf, file.joints)
    place = Path(os.path.relpath(urdf.resolve(), out.resolve())).as_posix()
    needed, efforts = _inputs(urdf, axes), {a.drive: file.joints[a.joint].effort or None for a in axes}
    nx = 2 * len(axes)
    volume = math.prod(2 * a.reach * 2 * SPEED for a in axes)
    eps = 0.5 * math.sqrt(nx) * (volume / STATES) ** (1.0 / nx)
    values = 11 if len(axes) == 1 else 3
    steps = {n: _step(u, efforts[n], values) for n, u in needed.items()}  # 0 is among the values
    ranges = {a.joint: a.range for a in axes}
    return text(
        "new_urdf.yaml.j2",
        name=name,
        urdf=place,
        axes=axes,
        ranges=ranges,
        speed=SPEED,
        limits={n: round(step * (values - 1) / 2, 12) for n, step in steps.items()},
        steps=steps,
        efforts=efforts,
        weak={n: u for n, u in needed.items() if u > (efforts[n] or math.inf)},
        tau=TAU,
        eps=_round(eps),
        cells=[max(2, round(CELLS ** (1.0 / nx)))] * nx,
        single=len(axes) == 1,
        derived=len(axes) <= MOST_DERIVED,
        most=MOST_DERIVED,
    )


def _axes(urdf: Path, joints: Mapping[str, FileJoint]) -> list[Axis]:
    if not joints:
        raise UserError("has no moving joint", file=urdf, remedy="Give the URDF of a robot that moves.")
    axes = []
    for k, (name, joint) in enumerate(joints.items()):
        if joint.kind not in ("revolute", "continuous", "prismatic"):
            raise UserError(
                f"the joint '{name}' is {joint.kind}", file=urdf,
                remedy="Joints that turn about or slide along one axis can be taken; write equations for the others.",
            )  # fmt: skip
        slides = joint.kind == "prismatic"
        end = "" if len(joints) == 1 else str(k + 1)
        units = ("m", "N") if slides else ("rad", "N*m")
        axes.append(Axis(name, f"q{end}", f"v{end}", f"u{end}", *units, _interval(urdf, name, joint)))
    return axes


def _interval(urdf: Path, name: str, joint: FileJoint) -> tuple[float, float]:
    """Of the position, around 0 or as near to it as the joint goes, with room for a step before its stops.

    Raises:
        UserError: a range that leaves no room.
    """
    lower, upper = joint.range or (-math.inf, math.inf)
    room = SPEED * TAU
    lower, upper = lower + room, upper - room
    if not lower < upper:
        raise UserError(
            f"the joint '{name}' has no room between its limits", file=urdf, key="<limit> lower, upper",
            remedy="Correct them, or make it `fixed` if it does not move.",
        )  # fmt: skip
    centre = min(max(0.0, lower + REACH), upper - REACH) if upper - lower > 2 * REACH else (lower + upper) / 2
    low, high = max(lower, centre - REACH), min(upper, centre + REACH)
    digits = 2 - math.floor(math.log10(high - low))  # of a hundredth of its width, inward
    return _inward(low, digits, math.ceil), _inward(high, digits, math.floor)


def _inward(value: float, digits: int, rounding: Callable[[float], int]) -> float:
    """A number of so many decimals, rounding of a number that has no more aside."""
    return round(rounding(round(value * 10.0**digits, 6)) / 10.0**digits, max(digits, 0))


def _inputs(urdf: Path, axes: list[Axis]) -> dict[str, float]:
    """For each input the largest magnitude that the case starts with, by Drake's dynamics of the model file.

    With `dv/dt = a_0(q, v) + G(q) u` the torques of a motion are `u = G^-1 (a - a_0)`: those that hold the plant
    against gravity and speed, and `|G^-1| A` more for any accelerations up to A, here those that stop SPEED within
    REACH, times AUTHORITY. The largest over X is taken; what a joint's `effort` allows of it is decided elsewhere.
    """
    plant, joints = multibody_plant(urdf, (0.0, 0.0, -GRAVITY))
    order = [joints.index(a.joint) for a in axes]
    n = len(axes)
    x = _corners(2 * n) * np.array([a.reach for a in axes] + [SPEED] * n)
    x[:, :n] += [(a.range[0] + a.range[1]) / 2 for a in axes]

    def acceleration(u: Floats) -> Floats:
        return accelerations(plant, order, x[:, :n], x[:, n:], np.repeat(u[None], len(x), axis=0))

    free = acceleration(np.zeros(n))
    gains = np.stack([acceleration(unit) - free for unit in np.eye(n)], axis=2)  # (points, of joint, by input)
    masses = np.linalg.inv(gains)
    held = np.abs(np.einsum("kij,kj->ki", masses, free))
    needed = (held + AUTHORITY * SPEED**2 / (2 * REACH) * np.abs(masses).sum(axis=2)).max(axis=0)
    return {a.drive: _round(float(value)) for a, value in zip(axes, needed, strict=True)}


def _corners(n: int) -> Floats:
    """Ends and middles of a box, (k, n) of -1, 0, 1: all of them, or where they are many a seeded choice."""
    if 3**n <= MOST_CORNERS:
        return np.stack(np.meshgrid(*([-1.0, 0.0, 1.0],) * n, indexing="ij"), axis=-1).reshape(-1, n)
    return np.random.default_rng(0).integers(-1, 2, (MOST_CORNERS, n)).astype(np.float64)


def _step(needed: float, effort: float | None, values: int) -> float:
    """Between neighbours of so many values from minus to plus what is needed, or what the joint's effort allows."""
    step = _round_up(2 * needed / (values - 1))
    if effort is None or step * (values - 1) / 2 <= effort:
        return step
    most = 2 * effort / (values - 1)
    rounded = _round(most)
    return rounded if rounded <= most else _round(rounded - 10.0 ** (math.floor(math.log10(most)) - 1))


def _round_up(value: float) -> float:
    """At least the value, in two digits."""
    rounded = _round(value)
    return rounded if rounded >= value else _round(rounded + 10.0 ** (math.floor(math.log10(value)) - 1))


def _round(value: float) -> float:
    """Two significant digits, as a person would write them."""
    return float(f"{value:.2g}")
