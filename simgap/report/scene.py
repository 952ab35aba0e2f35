"""What surrounds the runs of a case: the ends that its states must keep to, and the 3-D scene that they move in."""

from __future__ import annotations

import numpy as np

from simgap.config.context import Context
from simgap.config.synthesis import InvarianceSpecification, ReachAvoidSpecification
from simgap.geometry import Box
from simgap.io.recording_content import JointScene, PlanarScene
from simgap.specifications.regions import partial_box


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
