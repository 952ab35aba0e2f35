"""The inertia of a motor's rotor, as large at the joint as the gear's ratio squared makes it (armature)."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

from simgap.effects.base import PLANT, CoordinateTarget, EffectParameter, MjcfPlace, Values
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel

Column: TypeAlias = "tuple[sp.Expr, ...]"


class ReflectedInertia(CoordinateTarget):
    """A further inertia on the coordinate alone: I added to the diagonal of the mass matrix.

    With m the column of the inverse mass matrix and a the coordinate's acceleration, every acceleration falls by
    m I a / (1 + I m_c), m_c its entry at the coordinate (Sherman, Morrison (1950), Ann. Math. Stat. 21(1)).
    """

    name = "reflected_inertia"
    long = "a reflected inertia of {I} at the {on}"
    formula = "M' = M + I e e^T, e the coordinate"
    source = "Siciliano et al. (2009), Robotics, sec. 7.2.1 (rotor inertia times the gear ratio squared)"
    rank = PLANT + 40
    excitation = "vary the speed, and add faster input changes"
    parameters = (EffectParameter("I", "{force}*s^2/{position}", "reflected inertia", null=0.0, lower=0.0),)
    mjcf = MjcfPlace("joint", ("armature",))

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Change the accelerations and what every force does to them."""
        c = model.coordinate(on)
        own = model.state_names.index(c.velocity)
        column = model.force_map[on]
        share = values["I"] / (1 + values["I"] * column[own])

        def slowed(rates: Column) -> Column:
            return tuple(f - m * share * rates[own] for f, m in zip(rates, column, strict=True))

        columns = {name: slowed(other) for name, other in model.force_map.items()}
        return replace(model, xdot=slowed(model.xdot), force_map=columns)
