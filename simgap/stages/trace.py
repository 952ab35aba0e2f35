"""Stage `trace`: the closed loop as a recording to look at, held against the table of traces it was made from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simgap.config.synthesis import InvarianceSpecification, ReachAvoidSpecification
from simgap.geometry import Box
from simgap.io.controller_file import load_controller
from simgap.io.parquet import read_parquet
from simgap.io.recording import TITLES, Content, JointScene, PlanarScene, write_recording
from simgap.io.recording_check import verify
from simgap.io.traces import NOMINAL, ROBUST, Trace, shown, split
from simgap.stages.context import Context, log
from simgap.synthesis.controller import Controller
from simgap.synthesis.regions import partial_box

ABOUT = """# {title}

Both controllers in the simulator, on the time line `sim_time`.

- **blue**: the controller made for the model **with** its gap
- **vermilion**: the controller made for the nominal model alone
- **grey**: the same controller on the nominal model itself
- **orange**: the bound of the gap; **green**: the ends of the safe set

Winning domains: pale where both win, blue or vermilion where only one does.

{runs}
"""


def run(case_path: Path, nominal: Path, robust: Path, traces_path: Path, out: Path) -> None:
    """Write the recording of a case and read it back.

    Raises:
        UserError: damaged traces or controllers.
        BrokenPromise: a recording that does not hold what the table holds.
    """
    context = Context.load(case_path)
    with context.blame():
        traces = split(read_parquet(traces_path), context.states, context.inputs)
        content = recording_content(context, traces, load_controller(nominal), load_controller(robust))
    write_recording(out, content)
    count = verify(out, traces, context.states, context.inputs)
    log.info("recorded %d runs; %d values read back and equal to the table", len(traces), count)


def recording_content(context: Context, traces: list[Trace], nominal: Controller, robust: Controller) -> Content:
    """What the recording of a case shows."""
    chosen = {kind: shown(traces, kind) for kind in (ROBUST, NOMINAL)}
    lines = [f"- {TITLES[kind]}: run {t.run}, {_fate(t)}" for kind, t in chosen.items()]
    about = ABOUT.format(title=context.case.title or context.case.name, runs="\n".join(lines))
    return Content(
        case=context.case.name,
        about=about,
        states=tuple(context.states),
        inputs=tuple(context.inputs),
        units=context.units,
        safe=limits(context),
        traces=traces,
        shown=chosen,
        controllers={ROBUST: robust, NOMINAL: nominal},
        scene=scene(context),
    )


def _fate(trace: Trace) -> str:
    if trace.violates:
        first = float(trace.t[~trace.safe][0])
        return f"**unsafe after {first:g} s**"
    return f"safe for all {trace.duration:g} s"


def limits(context: Context) -> Box:
    """The interval that each state must keep to, infinite where there is none."""
    specification = context.need(context.case.synthesis, "synthesis").specification
    named = specification.safe if isinstance(specification, InvarianceSpecification) else specification.arena
    box = partial_box(named, tuple(context.states))
    if isinstance(specification, InvarianceSpecification):
        return Box(np.maximum(box.lo, context.box.lo), np.minimum(box.hi, context.box.hi))
    return box


def scene(context: Context) -> JointScene | PlanarScene | None:
    """The 3-D scene that suits the case: its URDF with joints, or a robot in an arena."""
    plant = context.case.plant
    specification = context.need(context.case.synthesis, "synthesis").specification
    if plant.urdf is not None:
        joints = {
            s.joint: k for k, s in enumerate(plant.states.values()) if s.joint is not None and s.quantity == "position"
        }
        return JointScene(context.folder / plant.urdf, joints)
    wheels = plant.symbolic.wheels if plant.symbolic is not None else None
    if wheels is not None and isinstance(specification, ReachAvoidSpecification):
        return _planar(context, specification)
    return None


def _planar(context: Context, specification: ReachAvoidSpecification) -> PlanarScene:
    symbolic = context.need(context.case.plant.symbolic, "plant.symbolic")
    wheels = context.need(symbolic.wheels, "plant.symbolic.wheels")
    names = (wheels.x, wheels.y)
    axes = [context.states.index(n) for n in (*names, wheels.heading)]
    outer = {n: specification.arena.get(n, context.domain.X[n]) for n in names}
    urdf = context.case.simulator.urdf if context.case.simulator is not None else None
    return PlanarScene(
        urdf=context.folder / urdf if urdf else None,
        axes=(axes[0], axes[1], axes[2]),
        arena=_flat(outer, names),
        target=_flat({n: specification.target.get(n, outer[n]) for n in names}, names),
        obstacles=tuple(_flat({n: o.get(n, outer[n]) for n in names}, names) for o in specification.obstacles),
        radius=max(specification.clearance.values(), default=0.15),
    )


def _flat(ends: dict[str, tuple[float, float]], names: tuple[str, str]) -> Box:
    return Box([ends[n][0] for n in names], [ends[n][1] for n in names])
