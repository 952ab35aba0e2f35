"""What an engine step leaves open of when a force turns round: a staircase that no affordable grid sees.

Dry friction that an engine applies once a step changes its sign at the end of a step and not within it. As the state
goes on smoothly, the number of steps with the one sign goes down by whole steps, and the gap jumps by

    kick = (what the rates jump by across the surface) tau / substeps

each time: a staircase whose steps are a substep's change of speed apart, a few times narrower than a cell. Samples see
its mean slope and, by chance, some of its jumps. So the kick, and what the nominal map makes of one at the beginning of
a step, is added to the bound. It is an estimate: of one joint's turning once in a step, at random states.
"""

from __future__ import annotations

import numpy as np
import sympy as sp

from simgap.config.plant import AddedEffect
from simgap.effects import AppliedEffect, apply_effects, effect
from simgap.gap.borders import BESIDE
from simgap.gap.tiers import Tier
from simgap.geometry import Floats
from simgap.model.symbolic import symbol
from simgap.plants.context import Context

_STATES = 4096
"""Random states and inputs at which the jump and what becomes of it are taken."""


def engine_grain(context: Context) -> Floats | None:
    """By how much a step of the engine blurs the gap, (nx,); None where no declared force turns round with a speed."""
    section, box = context.case.simulator, context.box
    if section is None or section.substeps == 1:  # then the start of the step alone decides, and borders see that
        return None
    rng = np.random.default_rng(0)
    x = rng.uniform(box.lo, box.hi, (_STATES, box.size))
    u = context.input_set[rng.integers(0, len(context.input_set), _STATES)]
    kick = np.sum([_jump(context, added, x, u) for added in section.effects], axis=0, initial=0.0)
    kick = np.broadcast_to(kick, box.size) * context.domain.tau / section.substeps
    return _carried(context, x, u, kick) if kick.any() else None


def _jump(context: Context, added: AddedEffect, x: Floats, u: Floats) -> Floats:
    """Largest jump of the rates where the effect turns round with a speed, (nx,), at states and inputs (n, .)."""
    own, model, found = effect(added.name), context.plant.declared, np.zeros(len(context.states))
    if own.remembers or added.on not in own.targets(model) or not set(model.state_names) <= set(context.states):
        return found
    model = apply_effects(model, [AppliedEffect(added.name, added.on, added.parameters)])
    order = [context.states.index(name) for name in model.state_names]
    rates = sp.lambdify([*map(symbol, (*model.state_names, *model.input_names))], model.numeric(), cse=True)
    for surface in own.surfaces(context.plant.declared, added.on, added.parameters):
        if not (surface.is_Symbol and surface.name in context.states):
            continue
        j, sides = context.states.index(surface.name), []
        for way in (-1.0, 1.0):
            at = x.copy()
            at[:, j] = way * BESIDE * (context.box.hi[j] - context.box.lo[j])
            sides.append(np.stack(np.broadcast_arrays(*rates(*at[:, order].T, *u.T)), axis=1))
        found[order] += np.abs(sides[1] - sides[0]).max(axis=0)
    return found


def _carried(context: Context, x: Floats, u: Floats, kick: Floats) -> Floats:
    """The kick at the end of a step, or what the nominal map makes of one at its beginning if that is more."""
    step, moved = context.plant.sampled.step, np.zeros(len(kick))
    for j in np.flatnonzero(kick):
        at = x.copy()
        at[:, j] += kick[j]
        moved += np.abs(step(at, u) - step(x, u)).max(axis=0)
    return np.maximum(kick, moved)


def grain_tier(context: Context, grain: Floats) -> Tier:
    """What is said of it."""
    added = ", ".join(f"{size:.2g} for {name}" for name, size in zip(context.states, grain, strict=True))
    return Tier(
        2,
        "A declared force that turns round does so at the end of an engine step, not within it, which makes a "
        f"staircase that is narrower than a cell; what one step of it moves is added to the bound: {added}. That no "
        "more happens is an estimate.",
    )
