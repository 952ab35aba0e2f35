"""A `gap` section that would be refused after the roll-outs: few cells, unknown symbols, a gap that jumps at rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from simgap.config.gap import LipschitzSection
from simgap.config.plant import AddedEffect
from simgap.effects import effect, joint_effect
from simgap.effects.base import CoordinateEffect
from simgap.effects.commands import DriveEffect
from simgap.errors import Finding, UserError, placed
from simgap.gap.bases import Blocks
from simgap.gap.lipschitz.grid import FEWEST
from simgap.gap.noise import WANTED, alpha_of_run, draws_at, share, statement_of
from simgap.gap.sampling.points import covering_grid, free_axes, own_point
from simgap.late import sympy as sp
from simgap.plants.context import Context


def refuse_few_cells(context: Context) -> None:
    """Refuse fewer than `FEWEST` cells along a state on which the gap may depend.

    Raises:
        UserError: with the state and the key of the spacing.
    """
    case = context.case
    if case.simulator is None or case.grid is None or case.gap is None or case.hidden_state is not None:
        return
    cells, free = covering_grid(case, context.box, own_point(case)).cells, free_axes(case)
    for j, name in enumerate(context.states):
        if j in free or cells[j] >= FEWEST:
            continue
        width = float(context.box.hi[j] - context.box.lo[j]) / (2 * FEWEST)
        key = f"grid.half_widths.{name}" if case.grid.half_widths else "grid.eps"
        raise UserError(
            f"leaves {cells[j]} cell{'s' if cells[j] > 1 else ''} along {name}, too few to see how the gap changes",
            key=key, remedy=f"At most {width:.3g} there: {FEWEST} cells. A state on which the gap does not depend "
            "goes under symmetry.along.",
        )  # fmt: skip


def refuse_basis(context: Context) -> None:
    """Refuse a basis with symbols that do not exist, or without a range over X and U.

    Raises:
        UserError: with the key.
    """
    section = context.case.gap
    if section is None or section.bound not in ("scenario", "conformal") or context.case.domain is None:
        return
    from simgap.gap.bounds.basis import widened
    from simgap.gap.fitting.linear_fit import listed_basis  # takes a second: only paid by cases that get this far

    with placed(key="gap.basis"):
        free = free_axes(context.case)
        basis = listed_basis(section.basis, context.states, context.inputs, context.box, free)
        _ = basis.ranges(widened(context.box), context.input_set)


def find_noise(context: Context) -> Iterator[Finding]:
    """What the statement about a simulator with noise costs, and what it says of a run."""
    case, own = context.case, statement_of(context.case)
    if own is None or case.grid is None or case.domain is None:
        return
    samples = covering_grid(case, context.box, own_point(case)).size * len(context.input_set)
    draws = draws_at(case, samples)
    problem = f"the noise is drawn {draws:,} times at each of {samples:,} samples, {draws * samples:,} roll-outs"
    steps = case.validation.steps if case.validation is not None else 1
    alpha = alpha_of_run(steps)
    more = draws_at(case, samples, alpha)
    yield Finding(
        "gap.noise", f"{problem}. {own.of_run(steps)[:-1]}",
        f"gap.noise.alpha: {alpha:g} would make it {share(WANTED)}, by {more:,} draws at each and {more * samples:,} "
        "roll-outs",
    )  # fmt: skip


_BESIDE, _SAME = 1e-9, 1e-3
"""Share of X's speeds that is close to rest, and of the largest force by which a smooth one may differ across it."""


def find_jumps_at_rest(context: Context) -> Iterator[Finding]:
    """A finding for each effect of the simulator that switches at rest within X and is none of the nominal model."""
    case = context.case
    if case.simulator is None or case.gap is None or case.domain is None or case.hidden_state is not None:
        return
    if isinstance(case.gap.basis, Blocks) and case.gap.lipschitz.rough_limit > LipschitzSection().rough_limit:
        return  # made for it
    known = {(own.name, own.on) for own in case.plant.effects}
    for k, added in enumerate(case.simulator.effects):
        if (added.name, added.on) not in known and (velocity := _jumps_along(context, added)) is not None:
            yield Finding(
                f"simulator.effects.{k}",
                f"{added.name} on {added.on} switches at rest, and the nominal model lacks it: the gap jumps where "
                f"{velocity} changes its sign, and `gap` refuses it if more than {case.gap.lipschitz.rough_limit:g} "
                "of the cells see that",
                "Declare it in plant.effects too; or let the bound take the jump in, with gap.basis: {kind: blocks}, "
                "as many along that speed as the grid has cells, and gap.lipschitz.rough_limit: 0.5",
            )


def find_stuck_joints(context: Context) -> Iterator[Finding]:
    """A finding for each joint whose dry friction in the simulator is more than its input can overcome."""
    case = context.case
    if case.simulator is None or case.domain is None:
        return
    dry = joint_effect("frictionloss")
    for k, added in enumerate(case.simulator.effects):
        for j, (name, own) in enumerate(case.plant.inputs.items()):
            most = float(abs(context.input_set[:, j]).max())
            force = added.parameters.get(dry.parameters[0].symbol, 0.0) if added.name == dry.name else 0.0
            if own.joint != added.on or not force or force < most:
                continue
            problem = (
                f"dry friction of {force:g} at {added.on}, and {name} goes to {most:g}: the input does not move it"
            )
            remedy = f"Is it in {own.unit}? Or enlarge domain.U.{name}"
            yield Finding(f"simulator.effects.{k}", problem, remedy)


def _jumps_along(context: Context, added: AddedEffect) -> str | None:
    """The velocity at whose 0, inside X, the effect's force jumps; None if it does not."""
    own, model, values = effect(added.name), context.plant.declared, added.parameters
    if added.on not in own.targets(model):
        return None
    force: Callable[[float], float]
    if isinstance(own, CoordinateEffect):
        velocity = model.coordinate(added.on).velocity
        force = lambda v: float(own.force(sp.Float(0), sp.Float(v), values))  # noqa: E731
    elif isinstance(own, DriveEffect):
        velocity = str(own.speed(model, added.on))
        force = lambda v: float(own.felt(sp.Float(1), sp.Float(v), values))  # noqa: E731
    else:
        return None
    if velocity not in context.states:
        return None
    j = context.states.index(velocity)
    lo, hi = float(context.box.lo[j]), float(context.box.hi[j])
    jump, most = abs(force(_BESIDE * hi) - force(_BESIDE * lo)), max(abs(force(lo)), abs(force(hi)))
    return velocity if lo < 0.0 < hi and jump > _SAME * most else None
