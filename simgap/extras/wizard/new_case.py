"""`simgap new`: a commented case for a robot that simgap has never seen, with numbers that are chosen to run.

Ranges, inputs and grids are round numbers near the model's equilibrium: a beginning to be edited, not a recommendation.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.config.load import load_case, parse_case, plain_content
from simgap.errors import UserError, excerpt, placed
from simgap.extras.wizard.driven_arm import Proposal, rounded, step_of
from simgap.extras.wizard.mjcf_as_urdf import model_of_mjcf
from simgap.extras.wizard.model_file import (
    SPEED,
    TAU,
    Asked,
    NewModel,
    centre_of,
    check_positions,
    model_of_urdf,
    named_joints,
)
from simgap.extras.wizard.proposal import SECONDS
from simgap.extras.wizard.propose import TIMES, cells_along, numbers, shown
from simgap.io.atomic import write_text
from simgap.io.pages import text
from simgap.plants.drake_check import accelerations
from simgap.plants.model_file import FileJoint, ModelFile, WheelPair, wheels_of
from simgap.plants.urdf import MOST_DERIVED, multibody_plant
from simgap.plants.urdf_checks import check_structure, check_urdf, root_link
from simgap.reading import relative

ENGINE_STEPS = 240
"""PyBullet's usual steps a second."""
RUBBING_STEPS, MOST_STEPS, BLUR = 16, 64, 1 / 300
"""Of the engine within tau where joints rub: a step of it blurs the gap by what the friction does in it, and that is to
be no more than BLUR of what the inputs do within tau. A cart with a pole and a tenth of its force as friction won
nothing with 23 steps and .43 with 60; more than MOST_STEPS make roll-outs dear."""
STATES, CELLS = 2500, 40_000
"""Of the first grid of samples, and cells of the first controller. Judgement: a run of a minute or two."""


def run(
    name: str,
    urdf: Path | None,
    out: Path,
    inputs: Sequence[str] | None = None,
    at: Mapping[str, float] | None = None,
    tell: Callable[[str], None] = lambda words: None,
    note: Callable[[str], None] = lambda words: None,
    seconds: float = SECONDS,
    mjcf: Path | None = None,
    joints: Sequence[str] | None = None,
    base: str | None = None,
) -> Path:
    """Write `NAME.yaml` to the folder `out`: for a URDF, an MJCF file, or equations to be replaced by one's own.

    Where the case holds less than the file, its model file `NAME_model.urdf` (for MJCF also `.xml`) stands beside it.

    Args:
        inputs: joints that have a drive; those that the file says if not given.
        at: positions of joints around which to work, 0 where none is given.
        joints: those that the case has, the others locked; all if not given. base: one of `new_model.BASES`.
        tell: hears what is being done. note: hears what a person should know of what was written.
        seconds: of CPU time for all of this; the search of a plant of several joints has what is left of it.

    Raises:
        UserError: a name that is none, a file that is there already, or a model file that simgap cannot take.
    """
    path, until = out / f"{name}.yaml", time.process_time() + seconds
    if path.exists():
        raise UserError("already exists and is left unchanged", file=path, remedy="Give another name, or move it.")
    content = text("new_equations.yaml.j2", name=name)
    parse_case(plain_content(content), path)  # refuses the name before anything is written
    asked = Asked(joints, at or {}, base, out / name, inputs, until, tell, note)
    try:
        if mjcf is not None or urdf is not None:
            content = _of_file(urdf, mjcf, asked)
        parse_case(plain_content(content), path)
        write_text(path, content)
        load_case(path)
    except BaseException:
        for file in asked.made:
            file.unlink(missing_ok=True)
        raise
    return path


def _of_file(urdf: Path | None, mjcf: Path | None, asked: Asked) -> str:
    """The case of a model file."""
    if urdf is not None:
        check_structure(urdf)
        if asked.base != "fixed" and (wheels := wheels_of(urdf)) is not None:
            return _of_wheels(urdf, wheels, asked)
        model = model_of_urdf(urdf, asked)
    else:
        assert mjcf is not None
        model = model_of_mjcf(mjcf, asked)
    with placed(file=urdf or mjcf):  # what is beside the case goes with it
        content = _of_joints(model, asked)
    if (root := root_link(model.file.path)) != "world":
        asked.note(f"Its base, link '{excerpt(root, 40)}', is assumed to be bolted to the world.")
    return content


SPEEDS_UP, LIGHTEST, BEYOND = 1.4, 0.1, 0.05
"""Acceleration that two wheels give the robot, m/s^2 (that of the Pioneer of configs/cases), the mass of one whose file
states none, kg, and what is beyond its wheels, m. Judgement."""


def _of_wheels(urdf: Path, wheels: WheelPair, asked: Asked) -> str:
    """A case for that robot: its wheels as the file says, a floor with one obstacle, commands of a slow robot."""
    for key, given in (("--inputs", asked.inputs), ("--joints", asked.joints), ("--at", asked.at)):
        if given:
            raise UserError(
                f"belongs to joints, and this robot stands on two wheels, '{wheels.left}' and '{wheels.right}'",
                key=key, remedy="With --base fixed its wheels are joints like others.",
            )  # fmt: skip
    check_urdf(urdf)
    asked.note(
        f"A robot on two driven wheels, '{wheels.left}' and '{wheels.right}': edit floor, obstacle, speeds and "
        "clearance. With --base fixed the wheels are taken as joints."
    )
    robot = reading.read_xml(urdf)
    mass = sum(float(m.get("value", "0")) for m in robot.iterfind("link/inertial/mass"))
    limits = [j.find("limit") for j in robot.findall("joint") if j.get("name") in (wheels.left, wheels.right)]
    efforts = [float(own.get("effort", "0")) for own in limits if own is not None]
    wanted = 0.5 * SPEEDS_UP * max(mass, LIGHTEST) * wheels.radius
    torque = min([wanted, *(e for e in efforts if e > 0)])
    return text(
        "new_wheels.yaml.j2", name=asked.place.name, urdf=relative(urdf, asked.place.parent), left=wheels.left,
        right=wheels.right, radius=f"{wheels.radius:.6g}", track=f"{wheels.track:.6g}", mass=f"{mass:.3g}",
        torque=f"{torque:.2g}", limited=torque < wanted,
        clearance=f"{0.5 * wheels.track + wheels.radius + BEYOND:.2g}",
    )  # fmt: skip


def _of_joints(model: NewModel, asked: Asked) -> str:
    file, urdf, out = model.file, model.file.path, asked.place.parent
    axes = axes_of(file.joints, {n: q for n, q in asked.at.items() if n in file.joints})
    driven, why = drives(file, asked.inputs)
    axes = [replace(a, driven=a.joint in driven) for a in axes]
    others = " --inputs JOINT,JOINT names others." * (len(axes) > 1)
    asked.note(f"Inputs on {', '.join(driven)}: {why}.{others}")
    least, damped = _damping({a.joint: file.joints[a.joint].damping for a in axes})
    about: dict[str, Any] = {
        "name": asked.place.name,
        "urdf": relative(urdf, out),
        "mjcf": relative(model.mjcf, out) if model.mjcf is not None else None,
        "added": model.effects,
        "gravity": model.gravity,
        "axes": axes,
        "why": why,
        "derived": len(axes) <= MOST_DERIVED,
        "most": MOST_DERIVED,
        "single": len(axes) == 1,
        "damping": least,
        "damped": damped,
        "rubs": {a.joint: file.joints[a.joint].friction for a in axes if file.joints[a.joint].friction > 0.0},
    }
    if about["rubs"]:
        asked.note(
            f"The file states dry friction for {', '.join(about['rubs'])}: the simulator has it and the model does "
            "not. The bound is a table of blocks, wide only where the friction reverses."
        )
    content = about | _plain(urdf, file, axes, about) | {"proposal": None, "refused": None}
    content["substeps"] = RUBBING_STEPS if about["rubs"] else _usual_steps(TAU)
    if 1 < len(axes) <= MOST_DERIVED:
        content |= _proposed(about, file, asked)
    if model.step is not None:
        content["substeps"] = max(1, round(content["tau"] / model.step))
    return text("new_urdf.yaml.j2", **content)


def _damping(stated: Mapping[str, float]) -> tuple[float, dict[str, float]]:
    """Least damping, the engine's one number, and what joints have beyond it, which is an effect each."""
    least = min(stated.values())
    more = {joint: float(f"{own - least:.12g}") for joint, own in stated.items()}  # without the digits of rounding
    return least, {joint: own for joint, own in more.items() if own > 0.0}


def _plain(urdf: Path, file: ModelFile, axes: list[Axis], about: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers near the posture that need no search."""
    driven = [a for a in axes if a.driven]
    efforts = {a.drive: file.joints[a.joint].effort or None for a in axes}
    needed = {}
    for a, u in zip(driven, needed_inputs(urdf, axes, about["gravity"]), strict=True):
        rubs = about["rubs"].get(a.joint, 0.0)
        needed[a.drive] = rounded(max(float(u) + rubs, TIMES * rubs))
    nx = 2 * len(axes)
    volume = math.prod(2 * a.reach * 2 * SPEED for a in axes)
    values = 11 if len(axes) == 1 else 3
    steps = {n: step_of(u, values, efforts[n] or math.inf, math.ceil) for n, u in needed.items()}  # 0 is among them
    return {
        "ranges": {a.joint: a.range for a in axes},
        "speed": SPEED,
        "limits": {n: round(step * (values - 1) / 2, 12) for n, step in steps.items()},
        "steps": steps,
        "efforts": efforts,
        "weak": {n: u for n, u in needed.items() if u > (efforts[n] or math.inf)},
        "tau": TAU,
        "eps": rounded(0.5 * math.sqrt(nx) * (volume / STATES) ** (1.0 / nx)),
        "cells": [max(2, round(CELLS ** (1.0 / nx)))] * nx,
        "along": _along(axes, about["rubs"]),
    }


def _along(axes: Sequence[Axis], rubs: Mapping[str, float]) -> dict[str, tuple[float, int]]:
    """Half-widths and number of the cells of samples by state, where no numbers were proposed; none of them for one
    joint that does not rub, whose balls cover X."""
    if len(axes) == 1 and not rubs:
        return {}
    reach = {a.position: a.reach for a in axes} | {a.velocity: SPEED for a in axes}
    along = cells_along(list(reach), {a.velocity for a in axes if a.joint in rubs})
    return {n: (rounded(reach[n] / count), count) for n, count in along.items()}


def _proposed(about: Mapping[str, Any], file: ModelFile, asked: Asked) -> dict[str, Any]:
    """Sections with which the nominal model wins something, or why there are none."""
    axes: list[Axis] = about["axes"]
    plant = text("new_plant.yaml.j2", **about)
    case = parse_case(plain_content(plant), asked.place.with_name(f"{about['name']}.yaml"))
    joints = {a: file.joints[a.joint] for a in axes}
    limits = {a.drive: j.effort for a, j in joints.items() if a.driven and j.effort}
    room = {a.position: j.range for a, j in joints.items() if j.range is not None}
    room |= {a.velocity: (-j.velocity, j.velocity) for a, j in joints.items() if j.velocity}
    at = {a.position: a.centre for a in axes}
    try:
        found = numbers(case, asked.place.parent, at, limits, room, asked.tell, asked.until, about["rubs"])
    except UserError as error:
        asked.note(f"The case has no controller yet; a run ends with the bound: {error.problem}. {error.remedy}")
        return {"refused": f"{error.problem}. {error.remedy}"}
    own = found.proposal
    cells = " x ".join(map(str, own.cells))
    asked.note(f"At tau = {own.tau} s, {found.wins}; the case uses {cells} cells.")
    asked.note("X is " + ", ".join(f"[{lo:g}, {hi:g}] of {n}" for n, (lo, hi) in shown(own.X).items()) + ".")
    for doubt in filter(None, (found.small, found.doubtful)):
        asked.note(doubt)
    return {"proposal": found.block(), "tau": own.tau, "substeps": _substeps(own, axes, about["rubs"])}


def _substeps(found: Proposal, axes: Sequence[Axis], rubs: Mapping[str, float]) -> int:
    """Engine's substeps within tau: as usual, or so many that a step of the friction is small beside the inputs."""
    usual = _usual_steps(found.tau)
    if not rubs:
        return usual
    most = {a.joint: max(map(abs, found.U[a.drive][:2])) for a in axes if a.drive in found.U}
    share = max((force / most[joint] for joint, force in rubs.items() if most.get(joint)), default=0.0)
    return max(usual, min(MOST_STEPS, max(RUBBING_STEPS, math.ceil(2.0 * share / BLUR))))


def _usual_steps(tau: float) -> int:
    return max(1, round(ENGINE_STEPS * tau))


REACH = 0.25
"""Half-width of X for a position, rad or m. Judgement, as that of a velocity."""
AUTHORITY = 2.0
"""Times the accelerations that stop SPEED within REACH, beyond what holds the plant in place. Judgement."""
MOST_CORNERS = 729
"""Of X at which the model is asked what its inputs must do: all of them up to three joints."""


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
