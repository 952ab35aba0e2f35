"""Equations in mixed units, that add apples to pears, or too long to compile."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.dimensions import rate_mismatch
from simgap.plants.context import Context
from simgap.simulators.surprises import Finding
from simgap.units import dimension, of_base

HEAVY = 5_000
"""Operations to be compiled beyond which a person is warned; numba's time grows faster than their number. A Furuta
pendulum has 81 by explicit_euler and 74 by rk4, both compiled in seconds; 24,913 were not in 250 s."""

_DRAWN, _SAME = 3, 1e-6
"""Points at which equations in two systems of units are compared, and the relative difference that is rounding."""


def refuse_prefixes(context: Context) -> None:
    """Refuse a unit that is a power of a thousand away from SI (mV, g, km) where the equations mix it with others.

    Numbers enter the equations as they stand. Where all units make one system (mm, mN and kg do) nothing is mixed: the
    same equations then hold in SI, which is what is tried.

    Raises:
        UserError: with the key of the unit.
    """
    if context.case.plant.symbolic is None:
        return
    model = context.plant.declared
    keys = {v.name: f"plant.states.{v.name}.unit" for v in model.states}
    keys |= {v.name: f"plant.inputs.{v.name}.unit" for v in model.inputs}
    keys |= {name: f"plant.symbolic.parameters.{name}.unit" for name in model.parameters}
    units = {v.name: v.unit for v in (*model.states, *model.inputs)} | {k: p.unit for k, p in model.parameters.items()}
    factors = {name: of_base(unit) for name, unit in units.items()}
    odd = [name for name, factor in factors.items() if _prefixed(factor)]
    if not odd or _one_system(model.xdot, [v.name for v in model.states], factors):
        return
    name = odd[0]
    raise UserError(
        f"is {units[name]}, beside units of another size: the equations take each number as it stands, and a factor of "
        f"{max(factors[name], 1.0 / factors[name]):g} is lost", key=keys[name],
        remedy="Write it, and every number of it, in SI units without a prefix.",
    )  # fmt: skip


def _prefixed(factor: float) -> bool:
    thousands = math.log10(factor) / 3.0
    return abs(thousands) > 0.5 and abs(thousands - round(thousands)) < 1e-9


def _one_system(rates: Sequence[sp.Expr], states: Sequence[str], factors: Mapping[str, float]) -> bool:
    """Whether f_x g(X / f) = g(X): the rates g of numbers in their own units, f of them in SI, and of numbers in SI."""
    rng = np.random.default_rng(0)
    for _ in range(_DRAWN):
        here = {name: float(rng.uniform(0.5, 2.0)) for name in factors}
        for rate, state in zip(rates, states, strict=True):
            symbols = {s: str(s) for s in rate.free_symbols if str(s) in factors}
            plain = complex(rate.subs({s: here[n] for s, n in symbols.items()}))
            own = factors[state] * complex(rate.subs({s: here[n] / factors[n] for s, n in symbols.items()}))
            if abs(own - plain) > _SAME * max(abs(own), abs(plain)):
                return False
    return True


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


def heavy_steps(context: Context) -> list[Finding]:
    """A nominal step of so many operations that synthesis will take far longer than is estimated."""
    if context.case.synthesis is None:
        return []
    operations = context.plant.sampled.operations
    if operations <= HEAVY:
        return []
    return [
        Finding(
            "plant",
            f"a step of the nominal model has {operations:,} operations; compiling and asking it takes synthesis "
            "minutes to hours more than is estimated",
            "Leave out terms that matter little, or fix joints; what the model then misses is in the gap",
        )
    ]
