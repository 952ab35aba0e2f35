"""Held-out transitions of the recordings against `f +- gamma`, before and after the correction.

The diagnosis keeps the transitions, the report compares them with the two bounds. What is measured carries noise at
both ends of a step, so the share that noise alone would leave inside the same bound stands beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.correction.transitions import seen, transitions
from simgap.diagnosis.result import WindowPrediction
from simgap.gap.bounds.function import GapFunction
from simgap.io.results import stack
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import SymbolicModel
from simgap.plants.context import Context

DRAWS = 20  # noise vectors for each transition


def transition_columns(
    context: Context,
    windows: Sequence[WindowPrediction],
    sigma: Mapping[str, float],
    model: SymbolicModel,
    late: Mapping[str, float],
    declared: Mapping[str, float],
) -> dict[str, Floats]:
    """Held-out transitions over tau: states, inputs (`late_` as the corrected plant feels them), `next_`; (n,) each.

    Those of files whose known conditions are not the declared ones are left out: the case's bound is for the declared.
    A case without a `domain` has no tau; the median interval of the data stands in for it.

    Args:
        sigma: noise of each measured state, in the order of the columns.
        model: the corrected one, its known conditions as inputs.
        late: seconds by which an input acts later; declared: condition -> its value in the case.
    """
    whole, noise = seen([w for w in windows if w.held_out], sigma, model)
    steps = [np.diff(w.t) for w in whole]
    domain, measured = context.case.domain, list(noise)
    tau = domain.tau if domain is not None else float(np.median(np.concatenate(steps))) if steps else 1.0
    plain, later = (transitions(whole, measured, model, by, tau) for by in ({}, late))
    names = [*model.state_names, *model.input_names]
    kept = np.ones(len(plain.start), dtype=bool)
    for n, value in declared.items():
        kept &= np.isclose(plain.start[:, names.index(n)], value, rtol=1e-9, atol=1e-12)  # a mean of a constant
    columns = {n: plain.start[kept, names.index(n)] for n in (*context.states, *context.inputs)}
    columns |= {f"late_{n}": later.start[kept, names.index(n)] for n in context.inputs}
    return columns | {f"next_{n}": later.then[kept, k] for k, n in enumerate(measured)}


def share_inside(
    context: Context, rows: Any, model: NominalModel, gap: GapFunction, noise: Mapping[str, float], late: bool
) -> dict[str, float] | None:
    """Share of the held-out transitions inside `f +- gamma` in all measured states at once.

    Args:
        rows: table with the columns of `transition_columns`.
        model, gap: f and its bound.
        noise: state -> standard deviation of a reading.
        late: whether the inputs act as the corrected plant feels them.

    Returns:
        share, noise_alone (what a rig inside the bound's middle would show with this noise), transitions; None if no
        transition begins in X, with an input between the ends of U, and is kept in X by the model.
    """
    measured = [n for n in context.states if f"next_{n}" in rows.column_names]
    x, u = stack(rows, context.states), stack(rows, [f"late_{n}" if late else n for n in context.inputs])
    then = stack(rows, [f"next_{n}" for n in measured])
    inputs = context.input_set
    known = (
        context.box.contains(x)
        & context.box.contains(model.step(x, u))
        & np.all((u >= inputs.min(axis=0)) & (u <= inputs.max(axis=0)), axis=1)
    )
    if not known.any():
        return None
    x, u, then = x[known], u[known], then[known]
    axes = [context.states.index(n) for n in measured]
    nearest = inputs[np.argmin(((u[:, None, :] - inputs[None]) ** 2).sum(axis=-1), axis=1)]  # gamma is given on U
    lo, hi = (bound[:, axes] for bound in gap.bounds(x, nearest))
    residual = then - model.step(x, u)[:, axes]
    sigma = np.sqrt(2.0) * np.array([noise[n] for n in measured])
    drawn = np.random.default_rng(0).standard_normal((DRAWS, *residual.shape)) * sigma + 0.5 * (lo + hi)
    return {
        "share": float(np.mean(np.all((residual >= lo) & (residual <= hi), axis=1))),
        "noise_alone": float(np.mean(np.all((drawn >= lo) & (drawn <= hi), axis=2))),
        "transitions": float(len(x)),
    }
