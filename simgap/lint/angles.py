"""Angles of X that look like degrees, where numbers are radians, and states said to wrap around that do not."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from simgap.arrays import Floats
from simgap.errors import Finding, UserError
from simgap.late import sympy as sp
from simgap.lint.costs import StageCost, affordable
from simgap.lint.equations import LONGEST_RULE
from simgap.model.symbolic import symbol
from simgap.plants.context import Context
from simgap.plants.model_file import FileJoint
from simgap.simulators.rollouts import closed_form

ROUND, LEAST, LARGE = 5.0, 10.0, 100.0
"""Of what both ends of an angle are multiples when they are degrees, from which size on that says something (a turn and
a half in rad), and the size beyond which any number is said. Judgement; an angle may wind: it is said, not refused."""
BEYOND = 3.0
"""How many times an end of X is its joint's limit, beyond which a unit is wrong, if degrees would fit. Judgement."""
DRAWN, SAME = 50, 1e-9
"""Places where rates are compared with those a width of X further on, and how much of their size they may differ: pi as
a double leaves 1e-16 of it, four decimals of pi leave 1e-5, and what is proven on X would not hold a turn away."""


def find_degrees(context: Context, joints: Mapping[str, FileJoint]) -> list[Finding]:
    """A finding for each angle of X in rad whose ends look like degrees.

    Args:
        context: of a case with a domain or without.
        joints: of the model file, by name; nothing for equations.

    Raises:
        UserError: an angle far beyond the limits of its joint, which would lie within them as degrees.
    """
    if context.case.domain is None:
        return []
    return [found for name in context.states if (found := _angle(context, joints, name)) is not None]


def affordable_or_degrees(context: Context, found: list[StageCost]) -> None:
    """Hold the costs against the budget; where X looks like degrees, that is the reason to be told.

    Raises:
        UserError: as `affordable` does.
    """
    try:
        affordable(context, found)
    except UserError as error:
        for first in find_degrees(context, {}):
            problem = f"{first.problem}; as it stands, {error.problem}"
            raise UserError(problem, key=first.key, remedy=f"{first.remedy}, and then {error.key}.") from None
        raise


def _angle(context: Context, joints: Mapping[str, FileJoint], name: str) -> Finding | None:
    if context.units[name] != "rad":
        return None
    lo, hi = context.domain.X[name]
    most = max(abs(lo), abs(hi))
    whole = all(abs(end / ROUND - round(end / ROUND)) < 1e-9 for end in (lo, hi))
    if not (whole and most >= LEAST) and most < LARGE:
        return None
    meant = f"[{math.radians(lo):.4g}, {math.radians(hi):.4g}]"
    key = f"domain.X.{name}"
    problem = f"[{lo:g}, {hi:g}] is in rad, {most / math.tau:.3g} turns away from 0; it looks like degrees"
    remedy = f"Write {meant} if it is, and rates, targets and obstacles of it in rad too"
    joint = joints.get(context.case.plant.states[name].joint or "")
    if joint is not None and joint.range is not None:
        ends = max(abs(end) for end in joint.range)
        if most > BEYOND * ends and math.radians(most) <= ends:
            stops = f"ends at {joint.range[0]:g} and {joint.range[1]:g}"
            own = f"; its joint '{context.case.plant.states[name].joint}' {stops}"
            raise UserError(problem + own, key=key, remedy=f"{remedy}.")
    return Finding(key, problem, f"{remedy}; leave it if the angle winds so far")


def refuse_seams(context: Context) -> None:
    """Refuse a state said to wrap around where model or known simulator differ a width of X further on.

    Raises:
        UserError: with the state, and what its X has to be for an angle in rad.
    """
    if context.case.domain is None or not context.periodic:
        return
    declared = context.plant.declared
    if declared.derived and context.plant.sampled.operations <= LONGEST_RULE:
        _refuse_seams(context, "model's rates", declared.numeric())
    simulator = None if context.case.simulator is None else closed_form(context.case, context.folder)
    if simulator is not None:
        steps = [e - symbol(s) for e, s in zip(simulator, context.states, strict=True)]
        _refuse_seams(context, "simulator's steps", steps)


def _refuse_seams(context: Context, whose: str, exprs: Sequence[sp.Expr]) -> None:
    for name, apart in _across(context, exprs):
        if apart > SAME:
            lo, hi = context.domain.X[name]
            angle = context.units[name] == "rad"
            raise UserError(
                f"wraps around, yet the {whose} differ by {apart:.2g} of their size after the {hi - lo:.5g} of X",
                key=f"domain.X.{name}",
                remedy=(f"Give a full turn in rad, such as [{-math.pi}, {math.pi}]" if angle else "Give it one period")
                + f", or take {name} out of domain.periodic.",
            )


def _across(context: Context, exprs: Sequence[sp.Expr]) -> Iterator[tuple[str, float]]:
    """For each state that wraps: by how much expressions change a width of X further on, as a share of the largest."""
    box = context.box
    rows = sp.lambdify([symbol(name) for name in (*context.states, *context.inputs)], exprs, modules="numpy")
    rng = np.random.default_rng(0)
    x = box.lo + (box.hi - box.lo) * rng.random((DRAWN, len(context.states)))
    u = context.input_set[rng.integers(len(context.input_set), size=DRAWN)]
    here = _rates(rows, x, u)
    size = np.nanmax(np.abs(here), axis=1)
    for j in context.periodic:
        turned = x.copy()
        turned[:, j] += box.hi[j] - box.lo[j]
        apart = np.nanmax(np.abs(_rates(rows, turned, u) - here), axis=1)
        yield context.states[j], float(np.max(apart / np.where(size > 0.0, size, 1.0)))


def _rates(rows: Callable[..., list[Floats]], x: Floats, u: Floats) -> Floats:
    """(nx, n) from states (n, nx) and inputs (n, nu)."""
    with np.errstate(all="ignore"):
        return np.stack([np.broadcast_to(row, len(x)) for row in rows(*x.T, *u.T)])
