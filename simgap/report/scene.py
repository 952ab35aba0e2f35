"""Runs of a case as they are seen: the ends that states must keep to, the 3-D scene, the content of its recording."""

from __future__ import annotations

import numpy as np

from simgap.geometry import Box
from simgap.io.rerun.recording import Content, JointScene, PlanarScene
from simgap.io.traces import GAP_AWARE, NOMINAL, TITLES, Trace, shown
from simgap.notation import axis_label
from simgap.plants.context import Context
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space
from simgap.synthesis.controller import Controller


def limits(context: Context) -> Box:
    """The interval that each state must keep to, infinite where there is none."""
    return specification_of(context.case).limits(Space.of(context.case))


def scene(context: Context) -> JointScene | PlanarScene | None:
    """The 3-D scene that suits the case: its URDF with joints, or a robot on a floor."""
    plant = context.case.plant
    if plant.urdf is not None:
        joints = {
            s.joint: k for k, s in enumerate(plant.states.values()) if s.joint is not None and s.quantity == "position"
        }
        return JointScene(context.folder / plant.urdf, joints)
    plane = specification_of(context.case).plane(Space.of(context.case))
    if plane is None:
        return None
    urdf = getattr(context.case.simulator, "urdf", None)
    return PlanarScene(
        urdf=context.folder / urdf if urdf else None,
        axes=plane.axes,
        arena=plane.arena,
        target=plane.target,
        obstacles=plane.obstacles,
        radius=plane.radius,
    )


ABOUT = """# {title}

Both controllers in the simulator, on the time line `sim_time`.

- **blue**: the controller made for the model **with** its gap
- **vermilion**: the controller made for the nominal model alone
- **grey**: the same controller on the nominal model itself
- **orange**: the bound of the gap{green}

Winning domains ({domains}): pale where both win, blue or vermilion where only one does.

{runs}
"""


def recording_content(context: Context, traces: list[Trace], nominal: Controller, gap_aware: Controller) -> Content:
    """Content of the recording of a case."""
    chosen = {kind: shown(traces, kind) for kind in (GAP_AWARE, NOMINAL)}
    lines = [f"- {TITLES[kind]}: run {t.run}, {_fate(t)}" for kind, t in chosen.items()]
    safe = limits(context)
    green = "; **green**: the ends of the safe set" if np.isfinite([safe.lo, safe.hi]).any() else ""
    title = context.case.title or context.case.name
    about = ABOUT.format(title=title, runs="\n".join(lines), green=green, domains=_domains(context, gap_aware))
    return Content(
        case=context.case.name,
        about=about,
        states=tuple(context.states),
        inputs=tuple(context.inputs),
        units=context.units,
        safe=safe,
        traces=traces,
        shown=chosen,
        controllers={GAP_AWARE: gap_aware, NOMINAL: nominal},
        scene=scene(context),
    )


def _domains(context: Context, controller: Controller) -> str:
    """Words on the view of the domains: its axes with their ends, and for which other states it holds."""
    box, states = controller.grid.box, context.states
    ends = [f"{axis_label(n, context.units)} from {box.lo[j]:g} to {box.hi[j]:g}" for j, n in enumerate(states[:2])]
    where = ", ".join(f"{end} {way}" for end, way in zip(ends, ("across", "up"), strict=False))
    return where + (f", for every {' and '.join(states[2:])}" if states[2:] else "")


def _fate(trace: Trace) -> str:
    if trace.violates:
        first = float(trace.t[~trace.safe][0])
        return f"**unsafe after {first:g} s**"
    return f"safe until its end after {trace.duration:g} s"
