"""Staircase in the gap where an engine reverses a force once a step: narrower than a cell, so it is measured on lines.

Dry friction that an engine applies once a step changes its sign at the end of a step and not within it. As the state
goes on smoothly, the number of steps with the one sign goes down by whole steps, and the gap jumps by about

    kick = (what the rates jump by across the surface) tau / substeps

each time: a staircase whose steps are a substep's change of speed apart, a few times narrower than a cell. Samples
see its mean slope and, by chance, some of its jumps. What a jump is depends on engine, integrators and how the plant
carries it on, so it is measured: as the largest difference of neighbours on short lines along each speed, less the
slope there. The kick by the nominal plant's own rates stands beside it, for lines are random. Both are estimates.
"""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.config.plant import AddedEffect
from simgap.effects import AppliedEffect, apply_effects, effect
from simgap.gap.bounds.function import Tier
from simgap.gap.sampling.borders import BESIDE, switching_surfaces
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol
from simgap.plants.context import Context
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out_alike

LINES, POINTS, LENGTH = 320, 64, 0.004
"""Lines along each speed, points on each, and their length as a share of X. On a cart with a pole a stair is .001 to
.01 of X long, and what is measured is within 1 % of its height. Judgement."""
NEAR, SMOOTH, NOTHING = 1e-3, 0.25, 1e-6
"""Half of the lines begin this share of X to all of it from rest, evenly in the logarithm; quantile of the differences
on a line that is taken for its slope; share of X up to which a line only bends where no force
that the engine reverses is declared."""
_STATES = 4096
"""Random states and inputs at which the rates' jump is taken."""


def staircase_height(context: Context) -> Floats | None:
    """Height of a stair, (nx,); None where no force is known to turn round with a speed.

    Raises:
        UserError: whatever the engine refuses.
    """
    if context.case.simulator is None:
        return None
    found = {surface.name for surface in switching_surfaces(context) if surface.is_Symbol} & set(context.states)
    box, known = context.box, kick(context)
    height = known
    rng = np.random.default_rng(0)
    for name in sorted(found):
        j = context.states.index(name)
        if not box.lo[j] < 0.0 < box.hi[j]:
            continue
        x, u = _lines(context, j, rng)
        ((following, _),) = run_in_processes(roll_out_alike, [(context.case, context.folder, x, u)], 1, None)
        gap = (following - context.plant.sampled.step(x, u)).reshape(LINES, POINTS, -1)
        height = np.maximum(height, stair(gap, x[:, j].reshape(LINES, POINTS)))
    height = np.where(known.any() | (height > NOTHING * (box.hi - box.lo)), height, 0.0)
    return height if height.any() else None


def _lines(context: Context, j: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """States (LINES POINTS, nx) on short lines along speed j, and the input of each line."""
    box = context.box
    width = box.hi[j] - box.lo[j]
    x = rng.uniform(box.lo, box.hi, (LINES, box.size))
    near = slice(0, LINES // 2)
    x[near, j] = np.where(x[near, j] < 0.0, box.lo[j], box.hi[j]) * NEAR ** rng.uniform(0.0, 1.0, LINES // 2)
    x[:, j] = np.clip(x[:, j], box.lo[j], box.hi[j] - LENGTH * width)
    states = np.repeat(x[:, None], POINTS, axis=1)
    states[:, :, j] += LENGTH * width * np.arange(POINTS) / (POINTS - 1)
    inputs = context.input_set[rng.integers(0, len(context.input_set), LINES)]
    return states.reshape(-1, box.size), np.repeat(inputs, POINTS, axis=0)


def stair(gap: Floats, speed: Floats) -> Floats:
    """The largest jump of the gap (lines, points, nx) between neighbours, less the slope of its line: (nx,).

    Neighbours on both sides of rest are left out: what the start of a step alone decides, samples beside the surface
    see.
    """
    steps = np.abs(np.diff(gap, axis=1))
    smooth = np.quantile(steps, SMOOTH, axis=1, keepdims=True)
    across = (speed[:, :-1] < 0.0) & (speed[:, 1:] >= 0.0)
    return np.asarray(np.where(across[:, :, None], 0.0, steps - smooth).max(axis=(0, 1), initial=0.0))


def kick(context: Context) -> Floats:
    """Jump of the rates where a declared force turns round with a speed, times a step of the engine: (nx,)."""
    section, box = context.case.simulator, context.box
    if section is None or section.substeps == 1:  # then the start of the step alone decides, but for what is measured
        return np.zeros(box.size)
    rng = np.random.default_rng(0)
    x = rng.uniform(box.lo, box.hi, (_STATES, box.size))
    u = context.input_set[rng.integers(0, len(context.input_set), _STATES)]
    jumps = np.sum([_jump(context, added, x, u) for added in section.effects], axis=0, initial=0.0)
    return np.broadcast_to(jumps, box.size) * context.domain.tau / section.substeps


def _jump(context: Context, added: AddedEffect, x: Floats, u: Floats) -> Floats:
    """Largest jump of the rates where the effect turns round with a speed, (nx,), at states and inputs (n, .)."""
    own, model, found = effect(added.name), context.plant.declared, np.zeros(len(context.states))
    if own.remembers or added.on not in own.targets(model) or not set(model.state_names) <= set(context.states):
        return found
    order = [context.states.index(name) for name in model.state_names]
    with_it = apply_effects(model, [AppliedEffect(added.name, added.on, added.parameters)])
    for surface in own.surfaces(model, added.on, added.parameters):
        if not (surface.is_Symbol and surface.name in context.states):
            continue
        j, sides = context.states.index(surface.name), []
        for way in (-1.0, 1.0):
            at = x.copy()
            at[:, j] = way * BESIDE * (context.box.hi[j] - context.box.lo[j])
            sides.append(_rates(with_it, at[:, order], u) - _rates(model, at[:, order], u))
        found[order] += np.abs(sides[1] - sides[0]).max(axis=0)
    return found


def _rates(model: SymbolicModel, x: Floats, u: Floats) -> Floats:
    names = [*map(symbol, (*model.state_names, *model.input_names))]
    rows = sp.lambdify(names, model.numeric(), cse=True)(*x.T, *u.T)
    return np.stack([np.broadcast_to(row, len(x)) for row in rows], axis=1)


def staircase_tier(context: Context, height: Floats) -> Tier:
    """The stair that was added to the bound, as a statement of its guarantee."""
    added = ", ".join(f"{size:.2g} for {name}" for name, size in zip(context.states, height, strict=True))
    return Tier(
        2,
        "In the engine a force reverses at the end of a step, not within it. This makes a staircase narrower than a "
        f"cell, and one stair is added to the bound: {added}. It is the largest found on random lines along the "
        "speeds, or by the rates of the nominal plant: an estimate.",
    )
