"""Surroundings of the runs of a case: the ends that its states must keep to, and the 3-D scene that they move in."""

from __future__ import annotations

from simgap.geometry import Box
from simgap.io.rerun.recording import JointScene, PlanarScene
from simgap.plants.context import Context
from simgap.specifications.base import specification_of
from simgap.specifications.space import Space


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
