"""A sampling time in which the plant leaves X at once, or hardly moves: forgotten milliseconds, mH taken for H."""

from __future__ import annotations

import itertools
import math

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.runge_kutta import RungeKutta
from simgap.model.symbolic import symbol
from simgap.notation import pretty_unit
from simgap.plants.context import Context
from simgap.simulators.surprises import Finding

HOPELESS = 100.0
"""Widths of X in one step, from most of X and U, beyond which a unit is wrong. Judgement: from two on nothing stays."""
HARDLY = 1e-4
"""Width of X in one step at most, from all of X and U, below which a state hardly moves: 10,000 cells would not see it.
Judgement: of the shipped cases the least is .006."""
LEADS = 0.5
"""Power with which a parameter acts on how far a state moves, from which on it is named. Judgement."""
DRAWN, MOST_INPUTS, LONGEST_RULE = 200, 16, 20_000


def long_steps(context: Context) -> list[Finding]:
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
