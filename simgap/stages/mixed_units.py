"""Parameters in other units than those that the equations are computed in, and equations that add apples to pears."""

from __future__ import annotations

from simgap.model.dimensions import rate_mismatch
from simgap.simulators.surprises import Finding
from simgap.stages.context import Context
from simgap.units import dimension, of_base


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


def wrong_dimensions(context: Context) -> list[Finding]:
    """Equations whose terms are of different dimensions, or that do not give what their state has a second."""
    if context.case.plant.symbolic is None:
        return []
    model = context.plant.declared
    units = {v.name: v.unit for v in (*model.states, *model.inputs)} | {k: p.unit for k, p in model.parameters.items()}
    known = {name: dimension(unit) for name, unit in units.items()}
    wrong = {v.name: rate_mismatch(rate, v.unit, known) for v, rate in zip(model.states, model.xdot, strict=True)}
    return [
        Finding(
            f"plant.symbolic.dynamics.{name}", words, "Correct a unit or the equation (a number may carry any unit)"
        )
        for name, words in wrong.items()
        if words
    ]
