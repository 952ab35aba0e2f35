"""Held-out transitions of the recordings against `f +- gamma`, before and after the correction.

The diagnosis writes the transitions, the report holds them against the two bounds. What is measured carries noise at
both ends of a step, so the share that noise alone would leave inside the same bound stands beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.verdict.remainder import transitions
from simgap.gap.function import GapFunction
from simgap.io.parquet import read_parquet, stack, table, write_parquet
from simgap.model.sampled import NominalModel
from simgap.stages.context import Context

FILE = "transitions.parquet"
DRAWS = 20  # noise vectors for each transition


def write_transitions(
    context: Context,
    path: Path,
    windows: Sequence[WindowPrediction],
    measured: Sequence[str],
    late: Mapping[str, float],
    record: Mapping[str, Any],
) -> None:
    """Held-out transitions over tau: states, inputs (and `late_` inputs as the corrected plant feels them), `next_`."""
    tau = context.domain.tau
    held = [w for w in windows if w.held_out]
    names, nx = [*context.states, *context.inputs], len(context.states)
    start, then = transitions(held, measured, names, {}, tau)
    later, _ = transitions(held, measured, names, late, tau)
    columns = {n: start[:, k] for k, n in enumerate(names)}
    columns |= {f"late_{n}": later[:, nx + k] for k, n in enumerate(context.inputs)}
    columns |= {f"next_{n}": then[:, k] for k, n in enumerate(measured)}
    units = {c: context.units[c.removeprefix("late_").removeprefix("next_")] for c in columns}
    write_parquet(path, table(columns, units, {"case": context.case.name}, record))


def share_inside(
    context: Context, path: Path, model: NominalModel, gap: GapFunction, noise: Mapping[str, float], late: bool
) -> dict[str, float] | None:
    """Share of the held-out transitions inside `f +- gamma` in all measured states at once.

    Args:
        path: what `write_transitions` wrote.
        model, gap: f and its bound.
        noise: state -> standard deviation of a reading.
        late: whether the inputs act as the corrected plant feels them.

    Returns:
        share, noise_alone (what a rig inside the bound's middle would show with this noise), transitions; None if no
        transition lies in X with an input between the ends of U.
    """
    rows = read_parquet(path)
    measured = [n for n in context.states if f"next_{n}" in rows.column_names]
    x, u = stack(rows, context.states), stack(rows, [f"late_{n}" if late else n for n in context.inputs])
    then = stack(rows, [f"next_{n}" for n in measured])
    inputs = context.input_set
    known = context.box.contains(x) & np.all((u >= inputs.min(axis=0)) & (u <= inputs.max(axis=0)), axis=1)
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
