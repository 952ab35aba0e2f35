"""What the audit says of margins: by how much gamma could grow before a winning cell is lost, and over which cells."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from simgap.gap.function import GapFunction
from simgap.gap.symmetry import BodyFrameGap
from simgap.geometry import Floats
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.stages.context import Context
from simgap.synthesis.margins import LARGEST_FACTOR, Margins, Remembered, one_step_margins, shown_layers

SHARES = (0.0, 0.05, 0.5)  # quantiles of the margins that are printed
LAYERS = 3  # headings that are looked at where classes are remembered: each costs a robot 3 CPU s


def margins_of(context: Context, gap: GapFunction, solution: Solution) -> Margins | None:
    """Margins of the cells in which a run may start, those of some headings where classes of inputs are remembered.

    None where it is pending which input acts, and where cells of the true state are kept by inputs of the measured one.
    """
    if solution.late:
        return None
    space, sensing = Space.of(context.case), context.case.sensing
    error: Floats | None = space.vector(sensing.error) if sensing else None
    if solution.value is None and error is not None and np.any(error > 0):
        return None
    axes = [j for j in range(space.size) if j not in gap.domain.free]
    about = context.plant.sampled, solution.grid, context.input_set
    if solution.kind is not None:
        return _after_rest(context, gap, solution, axes, error)
    inside = solution.winning if solution.value is None else solution.value >= 0
    return one_step_margins(*about, gap.kernel(), inside, solution.mask, axes, error)


def _after_rest(
    context: Context, gap: GapFunction, solution: Solution, axes: list[int], error: Floats | None
) -> Margins | None:
    """Of a controller that remembers classes: after an input of the class of a start, at the headings of the report."""
    if solution.value is None or solution.kind is None or not isinstance(gap, BodyFrameGap):
        return None
    sets, grid = solution.value.reshape(-1, solution.memory) >= 0, solution.grid
    about = context.plant.sampled, grid, context.input_set
    kernel = gap.after(solution.first).kernel() if gap.previous is not None else gap.kernel()
    remembered = Remembered(sets, solution.kind, shown_layers(grid.cells[axes[-1]], LAYERS) if axes else None)
    mask = np.ascontiguousarray(solution.mask.reshape(grid.size, solution.memory, -1)[:, solution.first])
    found = one_step_margins(*about, kernel, sets[:, solution.first], mask, axes, error, remembered)
    layers = len(shown_layers(grid.cells[axes[-1]], LAYERS)) if axes else 0
    which = f", in {layers} of {grid.cells[axes[-1]]} layers of {context.states[axes[-1]]}" if axes else ""
    return replace(found, only=f"where the previous input is of the class of a robot at rest{which}")


def summary(context: Context, margins: Margins | None) -> dict[str, Any] | None:
    """Least, 5 % and median margin over the cells that have one, how many cells that is, and which ones only."""
    if margins is None:
        return None
    known = np.isfinite(margins.factor)
    if not known.any():
        return None

    def quantiles(values: Any) -> dict[str, float]:
        named = zip(("least", "five_percent", "median"), np.quantile(values, SHARES, method="lower"), strict=True)
        return {name: float(v) for name, v in named}

    return {
        "cells": int(known.sum()),
        **({"only": margins.only} if margins.only else {}),
        "factor": quantiles(margins.factor[known]),
        "largest_looked_for": LARGEST_FACTOR,
        "extra": {n: quantiles(margins.extra[known, j]) for j, n in enumerate(context.states)},
    }
