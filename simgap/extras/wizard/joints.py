"""The joints of a URDF as a new case names them: which are driven, how far they go, what their inputs must do."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.plants.drake_check import accelerations
from simgap.plants.model_file import FileJoint, ModelFile
from simgap.plants.urdf import multibody_plant

REACH, SPEED = 0.25, 0.5
"""Half-widths of X: rad or m, and the same a second. Judgement: small enough for a first run of a minute."""
AUTHORITY = 2.0
"""Times the accelerations that stop SPEED within REACH, beyond what holds the plant in place. Judgement."""
MOST_CORNERS = 729
"""Of X at which the model is asked what its inputs must do: all of them up to three joints."""
TAU = 0.01


@dataclass(frozen=True)
class Axis:
    """A moving joint as the case names it: symbols of position, velocity and input, units, its interval of X.

    `centre` is the position around which to work; `driven` whether it has an input.
    """

    joint: str
    position: str
    velocity: str
    drive: str
    unit: str
    force: str
    range: tuple[float, float]
    centre: float
    driven: bool = True

    @property
    def reach(self) -> float:
        """Half the width of its interval."""
        return (self.range[1] - self.range[0]) / 2


def drives(file: ModelFile, named: Sequence[str] | None) -> tuple[tuple[str, ...], str]:
    """The joints that have a drive, in the order of the file, and what says so.

    Raises:
        UserError: a name that is no moving joint, or a file that does not say which of its joints are driven.
    """
    joints = file.joints
    if named is not None:
        return named_joints(named, joints, "--inputs"), "as asked"
    if file.driven is not None:
        return file.driven, f"the file has a drive for {'it' if len(file.driven) == 1 else 'them'}"
    stated = tuple(n for n, joint in joints.items() if joint.effort)
    if stated and len(stated) < len(joints):
        return stated, "the URDF states an effort for no other joint"
    if stated or len(joints) == 1:
        return tuple(joints), "the URDF states an effort for each" if stated else "assumed of the only joint"
    raise UserError(
        "does not say which joints have a drive", key="<transmission>",
        remedy=f"Name them: --inputs {next(iter(joints))}, or --inputs {','.join(joints)} for all.",
    )  # fmt: skip


def named_joints(names: Collection[str], joints: Collection[str], key: str) -> tuple[str, ...]:
    """The moving joints of these names, in the order of the file.

    Raises:
        UserError: no name, or one that is no moving joint's.
    """
    unknown = [n for n in names if n not in joints]
    if unknown or not names:
        raise UserError(
            f"there is no moving joint {', '.join(map(repr, unknown))}" if unknown else "no joint is named",
            key=key, remedy=f"Moving joints: {', '.join(joints)}.",
        )  # fmt: skip
    return tuple(n for n in joints if n in names)


def axes_of(joints: Mapping[str, FileJoint], at: Mapping[str, float]) -> list[Axis]:
    """The moving joints in the order of the file, around the positions `at`, 0 where none is given.

    Raises:
        UserError: a joint of another kind or without room, a name that is none of them, a position that the joint does
            not reach.
    """
    check_positions(joints, at)
    axes = []
    for k, (name, joint) in enumerate(joints.items()):
        if joint.kind not in ("revolute", "continuous", "prismatic"):
            raise UserError(
                f"the joint '{name}' is {joint.kind}",
                remedy="Joints that turn about or slide along one axis can be taken; write equations for the others.",
            )  # fmt: skip
        slides = joint.kind == "prismatic"
        end = "" if len(joints) == 1 else str(k + 1)
        units = ("m", "N") if slides else ("rad", "N*m")
        centre = at.get(name, centre_of(joint))
        interval = _interval(name, joint, centre)
        axes.append(Axis(name, f"q{end}", f"v{end}", f"u{end}", *units, interval, centre))
    return axes


def check_positions(joints: Mapping[str, FileJoint], at: Mapping[str, float]) -> None:
    """Refuse a name that is no moving joint's, and a position that the joint does not reach.

    Raises:
        UserError: either.
    """
    if at:
        named_joints(at, joints, "--at")
    for name, position in at.items():
        lower, upper = joints[name].range or (-math.inf, math.inf)
        if not lower <= position <= upper:
            raise UserError(
                f"{name}={position:g} is beyond a stop: the joint goes from {lower:g} to {upper:g}", key="--at",
                remedy="Give a posture within its limits, or correct <limit> in the URDF.",
            )  # fmt: skip


def centre_of(joint: FileJoint) -> float:
    """Position at which a joint is looked at unless given: 0, or the middle of a range that has no room about 0."""
    if joint.range is None or joint.range[0] + SPEED * TAU < 0.0 < joint.range[1] - SPEED * TAU:
        return 0.0
    return 0.5 * (joint.range[0] + joint.range[1])


def _interval(name: str, joint: FileJoint, at: float) -> tuple[float, float]:
    """Interval of the position, around `at` or as near to it as the joint goes, with room for a step before its stops.

    Raises:
        UserError: a range that leaves no room.
    """
    lower, upper = joint.range or (-math.inf, math.inf)
    room = SPEED * TAU
    lower, upper = lower + room, upper - room
    if not lower < upper:
        raise UserError(
            f"the joint '{name}' has no room between its limits", key="<limit> lower, upper",
            remedy="Correct them, or make it `fixed` if it does not move.",
        )  # fmt: skip
    centre = min(max(at, lower + REACH), upper - REACH) if upper - lower > 2 * REACH else (lower + upper) / 2
    low, high = max(lower, centre - REACH), min(upper, centre + REACH)
    digits = 2 - math.floor(math.log10(high - low))  # of a hundredth of its width, inward
    return _inward(low, digits, math.ceil), _inward(high, digits, math.floor)


def _inward(value: float, digits: int, rounding: Callable[[float], int]) -> float:
    """A number of so many decimals, rounding of a number that has no more aside."""
    return round(rounding(round(value * 10.0**digits, 6)) / 10.0**digits, max(digits, 0))


def needed_inputs(urdf: Path, axes: Sequence[Axis], gravity: float) -> Floats:
    """For each driven joint the largest magnitude of its input over X, by Drake's dynamics of the model file.

    With `dv/dt = a_0(q, v) + G(q) u` and the driven joints D, the inputs of a motion of these are
    `u = G_DD^-1 (a - a_0)_D`: those that hold them against gravity and speed, and `|G_DD^-1| A` more for any
    accelerations up to A, here those that stop SPEED within half of X, times AUTHORITY. What a joint's `effort` allows
    of it is decided elsewhere. `gravity` is along -z, m/s^2.
    """
    plant, joints = multibody_plant(urdf, (0.0, 0.0, -gravity))
    order, on = [joints.index(a.joint) for a in axes], [k for k, a in enumerate(axes) if a.driven]
    n, reach = len(axes), np.array([a.reach for a in axes])
    x = _corners(2 * n) * np.concatenate([reach, np.full(n, SPEED)])
    x[:, :n] += [(a.range[0] + a.range[1]) / 2 for a in axes]

    def acceleration(u: Floats) -> Floats:
        return accelerations(plant, order, x[:, :n], x[:, n:], np.repeat(u[None], len(x), axis=0))

    free = acceleration(np.zeros(n))
    gains = np.stack([acceleration(unit) - free for unit in np.eye(n)], axis=2)  # (points, of joint, by input)
    masses = np.linalg.inv(gains[:, on][:, :, on])
    held = np.abs(np.einsum("kij,kj->ki", masses, free[:, on]))
    stops = AUTHORITY * SPEED**2 / (2 * reach[on])
    return np.asarray((held + np.abs(masses) @ stops).max(axis=0))


def _corners(n: int) -> Floats:
    """Ends and middles of a box, (k, n) of -1, 0, 1: all of them, or where they are many a seeded choice."""
    if 3**n <= MOST_CORNERS:
        return np.stack(np.meshgrid(*([-1.0, 0.0, 1.0],) * n, indexing="ij"), axis=-1).reshape(-1, n)
    return np.random.default_rng(0).integers(-1, 2, (MOST_CORNERS, n)).astype(np.float64)
