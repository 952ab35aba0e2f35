"""`simgap new`: a commented case for a robot that simgap has never seen, with numbers that are chosen to run.

Ranges, inputs and grids are round numbers near the model's equilibrium: a beginning to be edited, not a recommendation.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from simgap import reading
from simgap.config.load import load_case, parse_case, plain_content
from simgap.errors import UserError, excerpt, placed
from simgap.extras.wizard.driven_arm import Proposal, rounded, step_of
from simgap.extras.wizard.joints import SPEED, TAU, Axis, axes_of, drives, needed_inputs
from simgap.extras.wizard.model_file import Asked, NewModel, model_of_mjcf, model_of_urdf
from simgap.extras.wizard.proposal import SECONDS
from simgap.extras.wizard.propose import TIMES, cells_along, numbers, shown
from simgap.io.atomic import write_text
from simgap.io.pages import text
from simgap.plants.model_file import ModelFile, WheelPair, wheels_of
from simgap.plants.urdf import MOST_DERIVED
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
        model = model_of_urdf(urdf, asked, asked.note)
    else:
        assert mjcf is not None
        model = model_of_mjcf(mjcf, asked, asked.note)
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
