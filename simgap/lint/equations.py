"""Equations in mixed units, that add apples to pears, or too long to compile; a sampling time that does not fit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from simgap.arrays import Floats
from simgap.errors import Finding, UserError
from simgap.late import sympy as sp
from simgap.model.dimensions import rate_mismatch
from simgap.model.integrators import RungeKutta
from simgap.model.symbolic import symbol
from simgap.notation import pretty_unit
from simgap.plants.context import Context
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
    """True if f_x g(X / f) = g(X): the rates g of numbers in their own units, f of them in SI, and of numbers in SI."""
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


def find_mixed_units(context: Context) -> list[Finding]:
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


def find_wrong_dimensions(context: Context) -> list[Finding]:
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


def find_heavy_steps(context: Context) -> list[Finding]:
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


HOPELESS = 100.0
"""Widths of X in one step, from most of X and U, beyond which a unit is wrong. Judgement: from two on nothing stays."""
HARDLY = 1e-4
"""Width of X in one step at most, from all of X and U, below which a state hardly moves: 10,000 cells would not see it.
Judgement: of the shipped cases the least is .006."""
LEADS = 0.5
"""Power with which a parameter acts on how far a state moves, from which on it is named. Judgement."""
DRAWN, MOST_INPUTS, LONGEST_RULE = 200, 16, 20_000


def find_long_steps(context: Context) -> list[Finding]:
    """A finding for each state that crosses all of X within one sampling time from most of X x U, or hardly moves.

    By the nominal model.

    Of a rule of more than `LONGEST_RULE` operations nothing is asked: reading it would take longer than a check may.

    Raises:
        UserError: a state that crosses X a hundred times.
    """
    if context.case.domain is None or not context.states:
        return []
    model, box = context.plant.sampled, context.box
    if model.operations > LONGEST_RULE:
        return []
    inputs = context.input_set[np.linspace(0, len(context.input_set) - 1, MOST_INPUTS).round().astype(int)]
    drawn = box.lo + (box.hi - box.lo) * np.random.default_rng(0).random((DRAWN, len(context.states)))
    x, u = (np.array(part) for part in zip(*itertools.product(drawn, inputs), strict=True))
    rates = model.rule.xdot if isinstance(model.rule, RungeKutta) else None
    rows = sp.lambdify((*model.x, *model.u), rates if rates is not None else model.rule, modules="numpy")
    with np.errstate(all="ignore"):
        values = np.stack([np.broadcast_to(row, len(x)) for row in rows(*x.T, *u.T)], axis=1)
    moved = np.abs(values * model.tau if rates is not None else values - x)
    found = []
    widths = np.median(moved, axis=0) / (box.hi - box.lo)
    for j in np.argsort(-widths, kind="stable"):  # what is refused is the worst: others may only follow it
        name = context.states[j]
        width, usual = box.hi[j] - box.lo[j], float(np.median(moved[:, j]))
        if j not in context.periodic and usual > width:
            unit = pretty_unit(context.units[name])
            problem = (
                f"in one sampling time of {model.tau:g} s {name} moves by {usual:.3g} {unit}, {usual / width:.2g} "
                "times the width of X, from most of X and U"
            )
            if usual > HOPELESS * width:
                remedy = f"Look at the units of tau, X and U, and at parameters{_leading(context, j, x, u)}."
                raise UserError(problem, key="domain.tau", remedy=remedy)
            found.append(Finding("domain.tau", problem, "Shorten tau (is it in seconds?), or enlarge X"))
        elif float(most := moved[:, j].max()) < HARDLY * width:
            problem = (
                f"{name} moves by at most {most / width:.2g} of the width of X in one sampling time of {model.tau:g} s"
            )
            remedy = f"Look at the units of tau and X, and at parameters{_leading(context, j, x, u)}; or lengthen tau"
            found.append(Finding("domain.tau", problem, remedy))
    return found


def _leading(context: Context, j: int, x: Floats, u: Floats) -> str:
    """The parameters of written equations with which the rate of state j grows or falls, as an addition to a remedy."""
    if context.case.plant.symbolic is None:
        return ""
    plant = context.plant.declared
    names = [*plant.state_names, *plant.input_names]
    order = [names.index(n) for n in (*context.states, *context.inputs) if n in names]
    if len(order) != len(names) or context.states[j] not in plant.state_names:
        return ""
    at = np.empty((len(names), len(x)))
    at[order] = np.concatenate([x, u], axis=1).T
    values = {name: p.value for name, p in plant.parameters.items()}
    rate = sp.lambdify([*map(symbol, (*names, *values))], plant.xdot[plant.state_names.index(context.states[j])])
    with np.errstate(all="ignore"):
        usual = float(np.median(np.abs(rate(*at, *values.values()))))
        twice = {
            name: float(np.median(np.abs(rate(*at, *(values | {name: 2.0 * value}).values()))))
            for name, value in values.items()
        }
        powers = {name: math.log2(v / usual) for name, v in twice.items() if v > 0.0 and usual > 0.0}
    leading = sorted((n for n, p in powers.items() if abs(p) >= LEADS), key=lambda n: -abs(powers[n]))
    own = [f"{n} = {values[n]:g} {pretty_unit(plant.parameters[n].unit)}".rstrip() for n in leading]
    return f", first at {' and '.join(own)}" if own else ""
