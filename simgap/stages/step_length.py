"""A sampling time in which the plant leaves X at once: forgotten milliseconds, or a box that is far too small."""

from __future__ import annotations

import itertools

import numpy as np
import sympy as sp

from simgap.errors import UserError
from simgap.model.runge_kutta import RungeKutta
from simgap.notation import pretty_unit
from simgap.simulators.surprises import Finding
from simgap.stages.context import Context

HOPELESS = 100.0
"""Widths of X in one step, from most of X and U, beyond which a unit is wrong. Judgement: from two on nothing stays."""
DRAWN, MOST_INPUTS, LONGEST_RULE = 200, 16, 20_000


def long_steps(context: Context) -> list[Finding]:
    """A finding for each state that crosses all of X within one sampling time from most of X x U, by the nominal model.

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
    for j, name in enumerate(context.states):
        width, usual = box.hi[j] - box.lo[j], float(np.median(moved[:, j]))
        if j not in context.periodic and usual > width:
            unit = pretty_unit(context.units[name])
            problem = (
                f"in one sampling time of {model.tau:g} s {name} moves by {usual:.3g} {unit}, {usual / width:.2g} "
                "times the width of X, from most of X and U"
            )
            if usual > HOPELESS * width:
                raise UserError(
                    problem, key="domain.tau", remedy="Look at the units of tau, X and U, and at parameters."
                )
            found.append(Finding("domain.tau", problem, "Shorten tau (is it in seconds?), or enlarge X"))
    return found
