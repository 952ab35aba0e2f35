"""Radius and track of a case against the wheels of its URDF: commands are turned into wheel speeds by the former."""

from __future__ import annotations

from typing import Any

from simgap.errors import UserError
from simgap.io.wheeled_urdf import wheels_of
from simgap.plants.context import Context
from simgap.simulators.surprises import Finding

SAID, REFUSED = 0.02, 1.5
"""Share by which a size may differ from the file's unsaid (a worn tyre, calibrated), and the factor beyond which it is
a slip of the pen. Judgement."""


def wheel_sizes(context: Context) -> list[Finding]:
    """Sizes that differ from the file's, where it has two wheels that are the case's.

    Raises:
        UserError: one that is another by more than half.
    """
    section: Any = context.case.simulator
    if not hasattr(section, "wheel_radius"):
        return []
    urdf = context.folder / section.urdf
    found = wheels_of(urdf)
    if found is None or {section.left, section.right} != {found.left, found.right}:
        return []
    apart = []
    sizes = ("wheel_radius", section.wheel_radius, found.radius), ("track", section.track, found.track)
    for key, own, stated in sizes:
        differs = f"{own:g} m, where the wheels of {urdf.name} have {stated:g} m"
        if max(own / stated, stated / own) > REFUSED:
            raise UserError(differs, key=f"simulator.{key}", remedy=f"Set it to {stated:g}, or mend the URDF.")
        if abs(own / stated - 1.0) > SAID:
            remedy = "Leave it, if it was calibrated: the robot then drives as these numbers say, the model as its own"
            apart.append(Finding(f"simulator.{key}", differs, remedy))
    return apart
