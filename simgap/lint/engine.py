"""Queries of `check` to the engine, in a process of its own: how it read the file, how fast it steps.

Of a wheeled robot the file alone is read: sizes, axes and shapes of its wheels.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from simgap import plugins, reading
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


ALIGNED = 0.9
"""Cosine from which on two directions are one. Judgement."""


def find_wheel_faults(context: Context) -> Iterator[Finding]:
    """Wheels that by their file do not roll along x, or are each on the other's side."""
    section: Any = context.case.simulator
    if not hasattr(section, "wheel_radius"):
        return
    robot = reading.read_xml(context.folder / section.urdf)
    joints = {part.get("name"): part for part in robot.findall("joint")}
    wheels = [joints[name] for name in (section.left, section.right) if name in joints]
    for wheel in wheels:
        if fault := _wheel_fault(robot, wheel):
            yield Finding(fault[0], f"the wheel of joint '{wheel.get('name')}' does not roll along x", fault[1])
    places = [axle(wheel)[0][1] for wheel in wheels]
    if len(places) == 2 and places[0] < places[1]:
        remedy = f"Exchange them: left: {section.right}, right: {section.left}"
        yield Finding("simulator.left", "the left wheel is on the right side, so the robot turns the other way", remedy)


def _wheel_fault(robot: ElementTree.Element, joint: ElementTree.Element) -> tuple[str, str] | None:
    """Key and remedy of what keeps a wheel from rolling along x; None if nothing is seen."""
    _, axis = axle(joint)
    if axis[1] < ALIGNED:
        pointing = ", ".join(f"{v:.2g}" for v in axis)
        return f"joint '{joint.get('name')}': <axis>", f"It points along {pointing}; a wheel turns about its y: 0 1 0"
    name = ends(joint)[1]
    link = next(part for part in robot.findall("link") if part.get("name") == name)
    shape = link.find("collision/geometry/*")
    if shape is None:
        return f"link '{name}': <collision>", "The wheel has none, so that nothing carries the robot: give it a sphere"
    along = placed_at(link, "collision/origin")[1].apply([0.0, 0.0, 1.0])
    turning = numbers(joint, "axis", "xyz", "1 0 0")
    if shape.tag == "cylinder" and abs(float(np.asarray(along) @ turning)) < ALIGNED:
        remedy = 'Its cylinder lies the wrong way, its axis is not the joint\'s: rpy="1.5707963 0 0" for axis 0 1 0'
        return f"link '{name}': <collision><origin> rpy", remedy
    if numbers(link, "contact/lateral_friction", "value", "1")[0] == 0.0:
        return f"link '{name}': <lateral_friction>", "A wheel without friction slips: give it 1, and casters 0"
    return None


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
    ((loaded, seconds, own),) = run_in_processes(_query_engine, [(case, context.folder, x, u)], log=engine_log)
    if own is not None:
        return own, seconds
    traits = kind.file_traits if issubclass(kind, Engine) else None
    if file is None or traits is None:
        return None, seconds
    return model_file_findings(case, traits, file, loaded), seconds


def _query_engine(case: Case, folder: Path, x: Any, u: Any) -> tuple[Mapping[str, Link], float, list[Finding] | None]:
    """Result of `ask_engine`, and findings about a file in the engine's own format."""
    from simgap.simulators.rollouts import engine_of

    findings = engine_of(case, folder).findings(case, folder)
    return *ask_engine(case, folder, x, u), findings


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
