"""Queries of `check` to the engine, in a process of its own: how it read the file, how fast it steps, how it drives.

A wheeled robot is driven in a short trial; where it does not drive as commanded, the finding says why.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap import plugins, reading
from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.named_files import places_of
from simgap.errors import Finding, UserError
from simgap.plants.context import Context
from simgap.plants.model_file import (
    Link,
    ModelFile,
    axle,
    base_of,
    numbers,
    placed_at,
    read_model_file,
    wheels_of,
)
from simgap.plants.urdf_checks import ends
from simgap.simulators.base import Engine
from simgap.simulators.findings import model_file_findings
from simgap.simulators.process import run_in_processes
from simgap.simulators.wheeled import WheeledEngine

SAID, REFUSED = 0.02, 1.5
"""Share by which a size may differ from the file's unsaid (a worn tyre, calibrated), and the factor beyond which it is
a slip of the pen. Judgement."""


def find_bolted_base(context: Context) -> Iterator[Finding]:
    """A robot on legs or wheels, or with a free base, whose plant holds its base still."""
    urdf = context.case.plant.urdf
    if urdf is not None and (base := base_of(reading.read_xml(context.folder / urdf))).kind != "fixed":
        yield Finding(
            "plant.urdf", f"{base.words}, and here its base is bolted to the world, in the model and in the engine",
            "Leave it for a robot on a stand; one that stands or drives needs equations of its own.",
        )  # fmt: skip


def find_other_wheel_sizes(context: Context) -> Iterator[Finding]:
    """Sizes that differ from the file's, where it has two wheels that are the case's.

    Raises:
        UserError: one that is another by more than half.
    """
    section: Any = context.case.simulator
    if not hasattr(section, "wheel_radius"):
        return
    urdf = context.folder / section.urdf
    found = wheels_of(urdf)
    if found is None or {section.left, section.right} != {found.left, found.right}:
        return
    sizes = ("wheel_radius", section.wheel_radius, found.radius), ("track", section.track, found.track)
    for key, own, stated in sizes:
        differs = f"{own:g} m, where the wheels of {urdf.name} have {stated:g} m"
        if max(own / stated, stated / own) > REFUSED:
            raise UserError(differs, key=f"simulator.{key}", remedy=f"Set it to {stated:g}, or correct the URDF.")
        if abs(own / stated - 1.0) > SAID:
            remedy = "Leave it, if it was calibrated: the robot then drives as these numbers say, the model as its own"
            yield Finding(f"simulator.{key}", differs, remedy)


TIPS, STANDS, OFF, ALIGNED, PULL = 0.2, 0.2, 0.15, 0.1, 0.05
"""Lean at which a robot has tipped over or sunk to one side, rad; share of what it was told below which it stands
still, and deviation from it that is said. Both shipped robots lean by .004 at most in both engines and off by .09 at
most; those spoilt on purpose (`tests/stages/test_drive.py`) lean by .36 or more, stand with .13 or less, or are off by
.17 or more; a motor with a twentieth of its torque comes to .32. Beyond ALIGNED two directions differ: judgement."""


def driven_as_told(context: Context, driven: list[Drive]) -> Iterator[Finding]:
    """Findings where the robot is slower, faster or turns wider than told; none for an engine without wheels.

    Raises:
        UserError: a robot that tips over, sinks, stands still or goes another way.
    """
    for drive in driven:
        section: Any = context.case.simulator
        _refuse_another_way(drive, section, context.folder / section.urdf)
        yield from _off(drive, section)


def _refuse_another_way(drive: Drive, section: Any, urdf: Path) -> None:
    forwards, sideways, turned = drive.moved
    linear, angular = drive.told
    straight = drive.straight
    share = forwards / linear if straight else turned / angular
    tips = drive.leans > TIPS or drive.height < -section.wheel_radius
    both = f"joints '{section.left}' and '{section.right}'"
    fault = wheel_fault(urdf, section.left) or wheel_fault(urdf, section.right)
    leans = f"it leans by {drive.leans:.2g} rad, its root {drive.height:.2g} m above the floor"
    look = "Look at its centre of mass, its casters, and the <collision> shapes of its wheels."
    turns_itself = straight and abs(turned - angular) * section.track / 2 > 0.5 * abs(linear)
    standing, why_standing = _standing(drive, fault)
    ways = (  # does it, what it does, where to look, what to do
        (tips, "tips over or sinks" + (" into the floor" if fault else f": {leans}"), *(fault or (both, look))),
        (turns_itself, f"turns by {turned:.2g} rad/s", both,
         "The <axis> of one wheel points the other way: make both 0 1 0."),
        (straight and abs(sideways) > 0.5 * abs(linear), f"drives sideways, {sideways:.2g} m/s", both,
         "Its root has to look along x and its wheels to turn about y: <axis> 0 1 0."),
        (straight and share < -STANDS, "drives backwards", both,
         "Reverse the <axis> of both wheels: 0 1 0 drives along x."),
        (not straight and share < -STANDS, "turns the other way", "simulator.left",
         f"Exchange them: left: {section.right}, right: {section.left}."),
        (share < STANDS, f"hardly moves{standing}", *(fault or (both, why_standing))),
    )  # fmt: skip
    for does, problem, key, remedy in ways:
        if does:
            told = f"commanded {linear:g} m/s and {angular:g} rad/s for two seconds, the robot"
            raise UserError(f"{told} {problem}", file=urdf, key=key, remedy=remedy)


def _standing(drive: Drive, fault: tuple[str, str] | None) -> tuple[str, str]:
    """What the wheels of a robot do that hardly moves, and the remedy where its file shows none."""
    if fault is not None:
        return "", ""
    rates = f"its wheels turn at {drive.turning[0]:.2g} and {drive.turning[1]:.2g} rad/s"
    asked = f"instead of {drive.asked[0]:.2g} and {drive.asked[1]:.2g}"
    turns = max(abs(own) / abs(aim) for own, aim in zip(drive.turning, drive.asked, strict=True) if aim != 0.0) > 0.5
    return f"; {rates} {asked}", (
        "They do not touch the floor, or slip on it: compare places and radii of their <collision> shapes with "
        "those of casters and body, and give them <lateral_friction>." if turns else
        "Raise simulator.torque, or look for what rubs on the floor: a caster with friction, the body, a wheel's "
        "<collision> shape that lies another way."
    )  # fmt: skip


def _off(drive: Drive, section: Any) -> Iterator[Finding]:
    """Speeds that are not those of the command, with the key that would explain it."""
    main, key = (0, "wheel_radius") if drive.straight else (2, "track")
    told, moved = (drive.told[0] if drive.straight else drive.told[1]), drive.moved[main]
    share, pull = moved / told, drive.moved[2] - drive.told[1]
    if drive.straight and PULL * abs(told) < abs(pull) * section.track / 2:
        yield Finding(
            "simulator.urdf", f"commanded {told:g} m/s and {drive.told[1]:g} rad/s, the robot turns by "
            f"{drive.moved[2]:.2g} rad/s in its engine: it pulls to one side",
            "Compare the radii and places of both wheels, and what rubs on one side; the gap covers what it does",
        )  # fmt: skip
        return
    if abs(share - 1.0) <= OFF:
        return
    unit, verb = ("m/s", "drives") if drive.straight else ("rad/s", "turns")
    problem = f"commanded {told:g} {unit} for two seconds, the robot {verb} at {moved:.3g} {unit} in its engine"
    reached = min(own / aim for own, aim in zip(drive.turning, drive.asked, strict=True) if aim != 0.0)
    if reached < 1.0 - OFF:
        problem += f", its wheels at {reached:.0%} of the commanded rate"
        yield Finding("simulator.torque", problem, "Raise it if the motors are stronger; the gap covers what they do")
        return
    yield Finding(
        f"simulator.{key}", problem,
        "Compare it with the URDF, and the wheels' <collision> shapes with the floor: the edges of a cylinder "
        "scrub where a sphere touches in one point; the gap covers what the engine does",
    )  # fmt: skip


def wheel_fault(urdf: Path, joint: str) -> tuple[str, str] | None:
    """Key and remedy of what keeps a wheel from rolling along x, by its file; None if nothing is seen."""
    robot = reading.read_xml(urdf)
    own = next(part for part in robot.findall("joint") if part.get("name") == joint)
    _, axis = axle(own)
    if abs(axis[1]) < 1.0 - ALIGNED:
        pointing = ", ".join(f"{v:.2g}" for v in axis)
        return f"joint '{joint}': <axis>", f"It points along {pointing} of the robot; a wheel turns about its y: 0 1 0."
    name = ends(own)[1]
    link = next(part for part in robot.findall("link") if part.get("name") == name)
    shape = link.find("collision/geometry/*")
    if shape is None:
        return f"link '{name}': <collision>", "The wheel has none, so that nothing carries the robot: give it a sphere."
    along = placed_at(link, "collision/origin")[1].apply([0.0, 0.0, 1.0])
    turning = numbers(own, "axis", "xyz", "1 0 0")
    if shape.tag == "cylinder" and abs(float(np.asarray(along) @ turning)) < 1.0 - ALIGNED:
        return (
            f"link '{name}': <collision><origin> rpy",
            'Its cylinder lies the wrong way, its axis is not the joint\'s: rpy="1.5707963 0 0" for axis 0 1 0.',
        )
    if numbers(link, "contact/lateral_friction", "value", "1")[0] == 0.0:
        return f"link '{name}': <lateral_friction>", "A wheel without friction slips: give it 1, and casters 0."
    return None


LONG = 2.0
"""How long a command is held, s: motors of the shipped robots need up to half a second, and with a twentieth of their
torque they come to a third of their speed in this time."""


@dataclass(frozen=True)
class Drive:
    """Motion that a command, held from rest, came to in its last sampling time.

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
    from simgap.simulators.rollouts import make_simulator

    wheels = case.plant.symbolic.wheels if case.plant.symbolic is not None else None
    if wheels is None or case.domain is None or case.simulator is None:
        return []  # of no wheeled robot: not even built
    tau, told = case.domain.tau, _commands(*(case.domain.U[name].list() for name in (wheels.linear, wheels.angular)))
    plain = case.simulator.model_copy(update={"effects": ()})
    with make_simulator(case.model_copy(update={"simulator": plain}), folder) as robot:
        return [_drive(robot, tau, *each) for each in told] if isinstance(robot, WheeledEngine) else []


def _commands(linear: Floats, angular: Floats) -> list[tuple[bool, float, float]]:
    """The largest speed with the least turning, and the other way round; none that would not move."""
    straight = max(linear, key=lambda v: (abs(v), v)), min(angular, key=abs)
    turn = min(linear, key=abs), max(angular, key=lambda w: (abs(w), w))
    return [told for told, own in (((True, *straight), straight[0]), ((False, *turn), turn[1])) if own != 0.0]


def _drive(robot: WheeledEngine, tau: float, straight: bool, linear: float, angular: float) -> Drive:
    a, b = robot.commands
    u = np.zeros(2)
    u[a], u[b] = linear, angular
    _, paths = robot.chain(np.zeros(3), np.tile(u, (max(2, int(np.ceil(LONG / tau))), 1)))
    x, y, turn = (float(paths[-1, -1, k]) for k in robot.pose)
    forwards, sideways = _in_the_body(x / tau, y / tau, turn)
    told, moved = (linear, angular), (forwards, sideways, turn / tau)
    return Drive(straight, told, moved, robot.wheel_rates(*told), robot.turning(), *robot.standing())


def _in_the_body(x: float, y: float, turn: float) -> tuple[float, float]:
    """Mean speeds along and across a body that turns evenly, from those of its chord as it stood at the beginning.

    A chord of an arc leaves at half of its angle, and is shorter than it by sin(h)/h.
    """
    h = 0.5 * turn
    along, across = np.cos(h) * x + np.sin(h) * y, np.cos(h) * y - np.sin(h) * x
    short = max(float(np.sinc(h / np.pi)), 0.1)  # near a whole turn there is no chord to be lengthened
    return float(along) / short, float(across) / short


TRIED, FEWEST, TOGETHER = 0.2, 15, 10_000
"""Seconds for which the engine is timed, how many roll-outs it makes, unless they take ten times as long, and how many
of them it is asked for at once, as the stages ask."""


def of_engine(
    context: Context, file: ModelFile | None, engine_log: Path | None = None
) -> tuple[list[Finding] | None, float | None]:
    """Findings about the model file, None where no engine loads one, and the seconds of a roll-out."""
    case = context.case
    if case.simulator is None or case.domain is None:
        return None, None
    kind = plugins.find("engines", case.simulator.engine, context.folder)
    rng = np.random.default_rng(0)
    x = context.box.sample(rng, 100)
    values = [case.domain.U[name].list() for name in context.inputs]
    u = np.stack([rng.choice(own, len(x)) for own in values], axis=1) if values else np.zeros((len(x), 0))
    ((loaded, seconds, own, driven),) = run_in_processes(_query_engine, [(case, context.folder, x, u)], log=engine_log)
    if own is not None:
        return own, seconds
    traits = kind.file_traits if issubclass(kind, Engine) else None
    if file is None or traits is None:
        return None, seconds
    return [*model_file_findings(case, traits, file, loaded), *driven_as_told(context, driven)], seconds


def _query_engine(
    case: Case, folder: Path, x: Any, u: Any
) -> tuple[Mapping[str, Link], float, list[Finding] | None, list[Drive]]:
    """Result of `ask_engine`, findings about a file in the engine's own format, and how a wheeled robot drives."""
    from simgap.simulators.rollouts import engine_of

    findings = engine_of(case, folder).findings(case, folder)
    return *ask_engine(case, folder, x, u), findings, drives(case, folder)


def ask_engine(case: Case, folder: Path, x: Any, u: Any) -> tuple[Mapping[str, Link], float]:
    """In the engine's process: its links, and the seconds of a roll-out from states (n, nx) under inputs (n, nu)."""
    from simgap.simulators.rollouts import make_simulator

    with make_simulator(case, folder) as simulator:
        simulator.rollouts(x[:1], u[:1])  # at the first of them a person's code is tried, which takes longer
        count, size, passed, used, least = 0, 1, 0.0, 0.0, math.inf
        while passed < TRIED or (count < FEWEST and passed < 10 * TRIED):
            rows = np.arange(count, count + size) % len(x)
            own, began, cpu = (x[rows], u[rows]), time.perf_counter(), time.process_time()
            if case.is_random:
                simulator.draws = size
                simulator.spread(own[0][:1], own[1][:1])
            else:
                simulator.rollouts(*own)
            cpu, took = time.process_time() - cpu, time.perf_counter() - began
            count, passed, used, least = count + size, passed + took, used + cpu, min(least, took / size)
            size = min(2 * size, TOGETHER) if took < TRIED / 10 else size
        # CPU time on a busy machine is much less than the time that passes; an engine may also wait for something.
        return simulator.loaded(), max(used / count, least)


def model_file(context: Context) -> ModelFile | None:
    """The file that the simulator loads, its meshes there; the nominal model's where there is no simulator."""
    section, own = context.case.simulator, context.case.plant.urdf
    files = [name for name in (own, section.urdf if section is not None else None) if name is not None]
    read = [read_model_file(context.folder / name) for name in files]
    for file in read:
        for mesh in file.meshes:
            if mesh.startswith("package://"):
                continue  # found through the paths of a ROS installation, if at all
            if not any(map(reading.is_file, places_of(file.path, mesh))):
                remedy = "Correct its path."
                raise UserError("the mesh does not exist", file=file.path, key=f"mesh '{mesh}'", remedy=remedy)
    return read[-1] if read else None
