"""Margins of the audit: by how much gamma could grow before a winning cell is lost, and over which cells."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapFunction
from simgap.geometry import Grid
from simgap.plants.context import Context
from simgap.specifications.base import specification_of
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.input_sets import crop, inner, margins, unpack
from simgap.synthesis.margins import LARGEST_FACTOR, Margins, Remembered, one_step_margins, shown_layers

SHARES = (0.0, 0.05, 0.5)  # quantiles of the margins that are printed
LAYERS = 3  # headings that are looked at where classes are remembered: each costs a robot 3 CPU s
LARGEST_TABLES = 1_500_000_000
"""Bytes of the counts of cells that do not win, four for each cell and each thing that may be remembered."""


def margins_of(context: Context, gap: GapFunction, solution: Solution) -> Margins | str:
    """Margins of the cells in which a run may start, those of some headings where classes of inputs are remembered.

    Where there are none, why: a sentence.
    """
    space, sensing = Space.of(context.case), context.case.sensing
    error = space.vector(sensing.error if sensing else {})
    sets = len(context.input_set) if solution.late else solution.memory
    needed = 4 * solution.grid.size * 2 ** len(solution.grid.periodic) * sets
    if needed > LARGEST_TABLES:
        return f"Counting how far each of {sets} sets of cells reaches would take {needed / 1e9:.1f} GB."
    blurred = bool(error.any()) or solution.late
    if blurred and specification_of(context.case).on_true_cells:
        return _of_true_cells(context, gap, solution, error)
    return _of_measured_cells(context, gap, solution, error)


def _of_measured_cells(context: Context, gap: GapFunction, solution: Solution, error: Floats) -> Margins:
    """At what is remembered at a start: the class of a robot at rest, the input that acts first."""
    grid, names, first = solution.grid, context.states, solution.first
    acts, after = solution.step(first, np.arange(len(context.input_set)))
    nodes = solution.served if solution.value is None else solution.value >= 0
    nodes = nodes.reshape(grid.size, solution.memory)
    remembered, kind = np.unique(after, return_inverse=True)
    axes = gap.domain.read
    layers = shown_layers(grid.cells[axes[-1]], LAYERS) if solution.kind is not None and axes else None
    late = int(acts) if solution.late else None
    known = Remembered(nodes[:, remembered], kind.reshape(-1).astype(np.int64), layers, late)
    rows = np.arange(grid.size) * solution.memory + first
    mask = np.ascontiguousarray(solution.admitted(len(context.input_set), rows))
    about = context.plant.sampled, grid, context.input_set, _after(gap, solution).kernel()
    found = one_step_margins(*about, nodes[:, first], mask, axes, error, known)
    only = ["where the previous input is of the class of a robot at rest"] if solution.kind is not None else []
    only += [_first(context, late)] if late is not None else []
    which = "" if layers is None else f", in {len(layers)} of {grid.cells[axes[-1]]} layers of {names[axes[-1]]}"
    return replace(found, only=" and ".join(only) + which)


def _of_true_cells(context: Context, gap: GapFunction, solution: Solution, error: Floats) -> Margins | str:
    """Margins of cells of the true state that are kept by inputs of the measured ones."""
    larger, inputs = solution.grid, context.input_set
    reach = margins(larger, error)
    grid = _true_grid(context, larger, reach)
    winning, late = crop(solution.winning, grid, larger), None
    known = None
    if solution.late:
        if solution.acting is None:
            return "The controller file does not say which inputs may act from which cells: run the synthesis again."
        late = solution.first
        acting = unpack(crop(solution.acting, grid, larger), len(inputs)).astype(np.bool_)
        known = Remembered(acting, np.arange(len(inputs)), acting=late)
    mask = solution.mask.reshape(larger.size, solution.memory, -1)[:, solution.first]
    about = context.plant.sampled, grid, inputs, gap.kernel(), winning, np.ascontiguousarray(mask)
    found = one_step_margins(*about, gap.domain.read, None, known, reach)
    factor, extra = np.full(larger.size, np.nan, np.float32), np.full((larger.size, grid.box.size), np.nan, np.float32)
    factor.reshape(larger.cells)[inner(grid, larger)] = found.factor.reshape(grid.cells)
    extra.reshape(*larger.cells, -1)[inner(grid, larger)] = found.extra.reshape(*grid.cells, -1)
    return Margins(factor, extra, "" if late is None else _first(context, late))


def _true_grid(context: Context, larger: Grid, reach: tuple[int, ...]) -> Grid:
    """The cells of the true state within those of its measurements."""
    space = Space.of(context.case)
    wide = [0 if j in larger.periodic else 2 * m for j, m in enumerate(reach)]
    region = specification_of(context.case).region(space)
    return space.grid(region, [c - w for c, w in zip(larger.cells, wide, strict=True)])


def _after(gap: GapFunction, solution: Solution) -> GapFunction:
    """The bound in the first sample: after an input of the class of a start, where there are classes."""
    if solution.kind is None or not isinstance(gap, BodyFrameGap) or gap.previous is None:
        return gap
    return gap.after(solution.first % (int(solution.kind.max()) + 1))


def _first(context: Context, late: int) -> str:
    values = ", ".join(f"{n} = {u:g}" for n, u in zip(context.inputs, context.input_set[late], strict=True))
    return f"where the first input, {values}, acts"


def summary(context: Context, margins: Margins | str) -> dict[str, Any] | None:
    """Least, 5 % and median margin over the cells that have one, how many cells that is, and which ones only."""
    if isinstance(margins, str):
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
