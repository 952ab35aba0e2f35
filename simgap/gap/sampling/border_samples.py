"""Samples on the border of X and on both sides of switching surfaces: some for the fit, others to check the bound.

Those of the fit lie on the lattice of the cell centres, those of the check on a random one. None of them is a random
sample of X: they never enter the statistical statement.

A switching surface is an expression over states and inputs that is 0 on it. Effects own theirs (`Effect.surfaces`), a
nominal model in equations has those of its `sign`, `abs`, `min` and `max`, a joint those of its end stops. What an
engine does on its own, unknown to the case, is not among them.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from pathlib import Path

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.effects import effect
from simgap.errors import UserError
from simgap.gap.bounds.function import GapDomain
from simgap.gap.sampling.borders import Borders, critical_points
from simgap.gap.sampling.points import (
    Columns,
    covering_grid,
    free_axes,
    product,
    remembers,
    stacked,
    successor_columns,
    successors,
)
from simgap.gap.sampling.samples import Directed
from simgap.gap.sampling.symmetry import shifted_states
from simgap.gap.thresholds import CHECK_LEVELS, LEAST_CHECKED_BORDER, MOST_BORDER_STATES
from simgap.late import sympy as sp
from simgap.model.symbolic import symbol
from simgap.plants.context import Context
from simgap.plants.model_file import joint_stops
from simgap.simulators.build import switches
from simgap.simulators.rollouts import roll_out_range

FIT, CHECK, SHIFTED = "fit", "check", "shifted"
NO_BORDERS = "the samples on borders of X and beside switching surfaces are missing"
MAKE_BORDERS = "Make them with `simgap borders` and give them as --borders."


def switching_surfaces(context: Context) -> tuple[sp.Expr, ...]:
    """All surfaces of a case, each once, in order of their text: those of model and simulator alike.

    Raises:
        UserError: a plant that cannot be built.
    """
    plant, simulator = context.case.plant, context.case.simulator
    declared = context.plant.declared
    found = [*kinks(context.plant.carried.numeric()), *_stops(context), *switches(context.case, context.folder)]
    for added in (*plant.effects, *(simulator.effects if simulator is not None else ())):
        own = effect(added.name)
        if added.on in own.targets(declared):
            found += own.surfaces(declared, added.on, added.parameters)
    known = {symbol(name) for name in (*context.states, *context.inputs)}
    kept = {e for e in found if e.free_symbols and e.free_symbols <= known}
    return tuple(sorted(kept, key=str))


def kinks(expressions: Iterable[sp.Expr]) -> list[sp.Expr]:
    """Surfaces on which `sign`, `abs`, `min` and `max` in the expressions switch."""
    found: list[sp.Expr] = []
    for expression in expressions:
        for node in sp.preorder_traversal(expression):
            if isinstance(node, sp.sign | sp.Abs):
                found.append(node.args[0])
            elif isinstance(node, sp.Min | sp.Max):
                found += [a - b for a, b in combinations(node.args, 2)]
    return found


def _stops(context: Context) -> list[sp.Expr]:
    plant, simulator = context.case.plant, context.case.simulator
    places = {s.joint: name for name, s in plant.states.items() if s.quantity == "position" and s.joint}
    files = {f for f in (plant.urdf, simulator.urdf if simulator is not None else None) if f}
    return [
        symbol(places[joint]) - sp.Float(end)
        for file in sorted(files)
        if reading.is_file(context.folder / file)
        for joint, ends in joint_stops(context.folder / file, list(places)).items()
        for end in ends
    ]


def parts_of(context: Context) -> tuple[str, ...]:
    """The parts of the table: for the fit, for the check, and shifted ones where a translation is declared."""
    return (FIT, CHECK, SHIFTED) if free_axes(context.case) else (FIT, CHECK)


def border_states(context: Context, name: str, part: str) -> Borders:
    """States for the fit, for the check, or shifted ones, on the grid of that name.

    Raises:
        UserError: a simulator that remembers earlier inputs, whose gap is no function of X.
    """
    if remembers(context.case):
        raise UserError("a gap taken over histories has no border of X", key="hidden_state")
    box, grid = context.box, covering_grid(context.case, context.box, name)
    if part == SHIFTED:
        x = shifted_states(context)
        return Borders(x, np.zeros(x.shape, dtype=bool), np.arange(len(x)))
    names = tuple(context.states), tuple(context.inputs)
    domain = GapDomain(*names, box, context.input_set, free_axes(context.case))
    if part == FIT:
        lattice, most = [grid.axis(j) for j in range(box.size)], MOST_BORDER_STATES
    else:  # fresh samples and means have streams of their own
        rng = np.random.default_rng([context.need(context.case.gap, "gap").seed, 2])
        lattice = [rng.uniform(lo, hi, CHECK_LEVELS) for lo, hi in zip(box.lo, box.hi, strict=True)]
        most = checked_at_most(grid.size)
    return critical_points(domain, switching_surfaces(context), lattice, most)


def checked_at_most(grid: int) -> int:
    """Most states on borders that check a bound made on so many states."""
    return min(MOST_BORDER_STATES, max(LEAST_CHECKED_BORDER, grid))


def directed_samples(context: Context, name: str, rolled: Columns, i: int) -> Directed:
    """The gap of dimension i at the states of the fit.

    Raises:
        UserError: a table of another case, or of another grid.
    """
    own = border_states(context, name, FIT)
    _, _, lower, upper = border_gaps(context, rolled, FIT, own)
    shape = (len(own.x), len(context.input_set))
    return Directed(own, lower[:, i].reshape(shape), upper[:, i].reshape(shape))


def border_gaps(context: Context, rolled: Columns, part: str, own: Borders) -> tuple[Floats, Floats, Floats, Floats]:
    """States, inputs, and both ends of the gap of one part: (n, nx), (n, nu), (n, nx), (n, nx).

    Raises:
        UserError: a table of another case, or of another grid.
    """
    mine = {key: values[rolled["part"] == part] for key, values in rolled.items()} if "part" in rolled else {}
    x, u = product(own.x, context.input_set)
    known = {*context.states, *context.inputs} <= set(mine)
    if not (
        known and np.array_equal(stacked(mine, context.states), x) and np.array_equal(stacked(mine, context.inputs), u)
    ):
        raise UserError(
            "the samples on borders and beside switching surfaces are those of another case",
            remedy="Run `borders` again, and `scp` and `gap` after it.",
        )
    predicted = context.plant.sampled.step(x, u)
    ends = [successors(mine, state) for state in context.states]
    lower, upper = (np.stack([pair[k] for pair in ends], axis=1) - predicted for k in (0, 1))
    return x, u, lower, upper


def roll_out_borders(case: Case, folder: Path, states: dict[str, Floats], inputs: Floats) -> tuple[Columns, str]:
    """Roll out each part's states (n, nx) with all inputs (M, nu), in the engine's process: the table, the engine."""
    x, u = product(np.concatenate(list(states.values())), inputs)
    following, spread, engine = roll_out_range(case, folder, x, u)
    return border_columns(case, states, inputs, following, spread), engine


def border_columns(
    case: Case, states: dict[str, Floats], inputs: Floats, following: Floats,
    spread: tuple[Floats, Floats] | None = None,
) -> Columns:  # fmt: skip
    """The table of roll-outs of the parts of `states` with all inputs: successors (n, nx)."""
    x, u = product(np.concatenate(list(states.values())), inputs)
    part = np.repeat(list(states), [len(own) * len(inputs) for own in states.values()])
    return {"part": part, **successor_columns(case, x, u, following, spread)}
