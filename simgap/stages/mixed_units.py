"""Parameters in other units than those that the equations are computed in."""

from __future__ import annotations

from simgap.simulators.surprises import Finding
from simgap.stages.context import Context
from simgap.units import of_base


def mixed_units(context: Context) -> list[Finding]:
    """Parameters that are not in SI units while every state and input is: their values are not converted."""
    section = context.case.plant.symbolic
    if section is None or any(abs(of_base(u) - 1.0) > 1e-9 for u in context.units.values()):
        return []
    return [
        Finding(
            f"plant.symbolic.parameters.{name}",
            f"is in {p.unit}, while states and inputs are in SI units; the equations take the number as it stands",
            f"Write it in SI units: {p.value * of_base(p.unit):.6g}",
        )
        for name, p in section.parameters.items()
        if abs(of_base(p.unit) - 1.0) > 1e-9
    ]
