"""The bound of a robot whose simulator remembers earlier inputs, for step `gap`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from simgap.config.pose import pose_axes
from simgap.errors import BrokenPromise
from simgap.gap.acceptance import tolerate
from simgap.gap.fresh_check import FreshCheck, check_fresh
from simgap.gap.function import GapDomain
from simgap.gap.hidden_fit import HiddenStateFit, HistoryInfluence, HullFit, assemble_hulls
from simgap.gap.hidden_state import tolerance_of
from simgap.gap.points import Columns, Points
from simgap.gap.steps.samples import read_back
from simgap.gap.steps.tables import body_samples
from simgap.gap.symmetry import HeadingDeviation, check_symmetry
from simgap.geometry import Floats
from simgap.plants.context import Context

Saved = Mapping[str, Mapping[str, Any]]
LONGER = "Raise hidden_state.chains or hidden_state.previous, or set hidden_state.tolerated_probability."


def hidden_bound(
    context: Context, motion: Floats, points: Points, scp: Saved, lipschitz: Saved, fresh: Columns
) -> tuple[dict[str, Any], FreshCheck]:
    """The content of gap.json, swept boxes included, and how the bound fared on fresh sequences; `motion` is (M, 3).

    Raises:
        BrokenPromise: a symmetry that does not hold, a memory that does not fade, or violations on fresh sequences.
    """
    hidden = context.need(context.case.hidden_state, "hidden_state")
    symmetry = context.need(context.case.symmetry, "symmetry")
    hulls = [read_back(HullFit.from_json, scp[n]) for n in context.states]
    influences = [read_back(HistoryInfluence.from_json, lipschitz[n]) for n in context.states]
    deviation = HeadingDeviation(np.array([own.deviation for own in influences]), influences[0].compared)
    check_symmetry(deviation, context.states, tolerance_of(context.states, symmetry.tolerance))
    pose = pose_axes(context)
    free = tuple(sorted(pose[:2]))
    domain = GapDomain(
        tuple(context.states), tuple(context.inputs), context.box, context.input_set, free, context.periodic
    )
    between = context.need(context.case.simulator, "simulator").between_poses(
        context.domain.tau, context.case.plant.gravity
    )
    fit = assemble_hulls(domain, hulls, influences, between, hidden.growth, pose)
    check = _check(context, fit, motion, fresh)
    tolerate(check, hidden.tolerated_probability, LONGER)
    return _content(context, fit, check, len(points.states), hulls[0].grid), check


def _check(context: Context, fit: HiddenStateFit, motion: Floats, fresh: Columns) -> FreshCheck:
    """Fresh sequences against the bound at heading 0, where the robot's frame is the world's, and against swept boxes.

    Raises:
        BrokenPromise: when a fresh path leaves the swept box of its input.
    """
    samples = body_samples(context.case, fresh)
    x = np.zeros((len(samples.m), 3))
    x[:] = 0.5 * (context.box.lo + context.box.hi)
    x[:, pose_axes(context)[2]] = 0.0
    d = samples.final - motion[samples.m]
    beyond = np.maximum(
        fit.swept.lower[samples.m] - samples.extent[:, [0, 2]], samples.extent[:, [1, 3]] - fit.swept.upper[samples.m]
    )
    if (beyond > 0).any():
        raise BrokenPromise(
            f"{int((beyond > 0).any(axis=1).sum())} of {len(beyond)} fresh paths leave the swept box of their input, "
            f"by up to {beyond.max():.3g} m",
            "Raise hidden_state.chains or hidden_state.previous.",
        )
    return check_fresh(fit.gap, x, context.input_set[samples.m], d)


def _content(context: Context, fit: HiddenStateFit, check: FreshCheck, previous: int, rolled: int) -> dict[str, Any]:
    hidden = context.need(context.case.hidden_state, "hidden_state")
    function = fit.gap.with_tiers([*fit.gap.tiers, check.tier])
    size = np.maximum(np.abs(fit.gap.lower), np.abs(fit.gap.upper))
    width = fit.gap.upper - fit.gap.lower
    suprema = function.sup()
    dimensions = [
        {
            "state": name,
            "largest_sampled_gap": float(fit.largest[i]),
            "sup_size": suprema[name].size,
            "sup_width": suprema[name].width,
            "mean_size": float(size[:, i].mean()),
            "mean_width": float(width[:, i].mean()),
            "beyond_previous_inputs": float(fit.excess[i]),
            "margin": float(fit.margin[i]),
        }
        for i, name in enumerate(context.states)
    ]
    return {
        **function.to_json(),
        "swept_boxes": {"lower": fit.swept.lower, "upper": fit.swept.upper},
        "samples": rolled,
        "dimensions": dimensions,
        "memory": fit.memory,
        "heading_deviation": fit.deviation.largest,
        "budget": {
            "previous_inputs": previous,
            "random_sequences": hidden.chains,
            "steps_of_each": hidden.chain_length,
            "substeps": context.case.simulator.substeps if context.case.simulator else None,
        },
        "fresh": asdict(check),
    }
