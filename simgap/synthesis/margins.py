"""One-step margins: by how much gamma could grow at a winning cell before no admissible input keeps it there.

With gamma = [lo, hi] over the cell, half-width w = (hi - lo) / 2, and an admissible input m, the successor box of the
cell is that of f, moved by lo and hi (`product`). The margin of a cell is

    factor    = max over m of the largest s such that the box, grown by (s - 1) w on both sides along every axis,
    extra_i   = max over m of the largest e such that the box, grown by e on both sides along axis i alone,

still covers winning cells only. Admissible are the controller's inputs: towards a target those that go down a level.
Where the class of the previous input is remembered, gamma and the inputs are those after an input of one class, and the
cells that are covered have to win after an input of the class of m. Where inputs are late, the box is that of the input
that acts now, and the cells that are covered have to win with m to act next.

A controller that keeps cells of the true state by measurements with an error takes an input of the measured cell,
whichever the measurement is. The margin of a true cell is then the least over the measured cells y that its states may
be measured in, with m admitted at y:

    factor    = min over y of max over m of the largest s such that ...

It is a statement about one cell and one step: gamma has grown at this cell alone and the winning domain is the old one.
Where gamma grows everywhere, cells may be lost sooner, since those that they rely on are lost first. What the path
between samples touches is not asked again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgap.geometry import Grid
from simgap.synthesis.frame import Frame
from simgap.synthesis.holes import count_holes, layout, table_size
from simgap.synthesis.margins_search import LARGEST_FACTOR, searcher
from simgap.synthesis.nominal import Model
from simgap.synthesis.product import Kernel, image
from simgap.synthesis.tables import reduced_cells
from simgap.synthesis.windows import crop, padded, to_bytes, to_words, window_and

__all__ = ["LARGEST_FACTOR", "Margins", "Remembered", "one_step_margins", "shown_layers"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Margins:
    """Margins of cells, NaN where a cell does not win or is the goal.

    Attributes:
        factor: (cells,) on gamma's half-width, at most `LARGEST_FACTOR`.
        extra: (cells, nx) for each state alone, in its unit, at most the width of the region.
        only: of which cells, where it is not all of them, as words.
    """

    factor: NDArray[np.float32]
    extra: NDArray[np.float32]
    only: str = ""


@dataclass(frozen=True, eq=False)
class Remembered:
    """What a controller that remembers adds: the class of the previous input, the input that acts now, or both.

    Attributes:
        winning: (cells, C) bool, sets of cells that win, each with something that is remembered there.
        kind: (M,) in which of them the successors have to be when an input was chosen.
        layers: indices along the last axis on which boxes depend that are looked at, all when None: nodes are many.
        acting: the input that acts whatever is chosen, where inputs are late; None where the chosen one does.
    """

    winning: NDArray[np.bool_]
    kind: NDArray[np.int64]
    layers: NDArray[np.int64] | None = None
    acting: int | None = None


def shown_layers(cells: int, count: int = 6) -> NDArray[np.int64]:
    """At most `count` indices spread over an axis of so many cells, the first included."""
    return np.unique((np.arange(count) * cells) // count)


def one_step_margins(
    model: Model,
    grid: Grid,
    inputs: Floats,
    gap: Kernel,
    winning: NDArray[np.bool_],
    mask: NDArray[np.uint8],
    gap_axes: Sequence[int] | None = None,
    error: ArrayLike | None = None,
    remembered: Remembered | None = None,
    reach: tuple[int, ...] | None = None,
) -> Margins:
    """Margins of the cells that win and have an input.

    Args:
        model: nominal map f; grid: cells of the measured state, or of the true one with a `reach`.
        inputs: U, (M, nu).
        gap: kernel of the bound; gap_axes: state axes on which it depends, all when None.
        winning: (cells,) bool; mask: (cells, ceil(M / 8)) packed admissible inputs, of the measured cells (`padded`
            by the reach) where there is one.
        error: bound of the measurement error that boxes account for, (nx,).
        remembered: where successors must win instead, if the controller remembers something; gap, winning and mask are
            those of one thing that it may remember.
        reach: cells to either side in which a true state may be measured, per axis.
    """
    n, nothing, count = grid.box.size, np.zeros(grid.box.size), len(inputs)
    known = Remembered(winning[:, None], np.zeros(count, np.int64)) if remembered is None else remembered
    errors = nothing if error is None else np.asarray(error, dtype=np.float64)
    acts = inputs if known.acting is None else np.repeat(inputs[[known.acting]], count, axis=0)
    frame = Frame(grid, np.ascontiguousarray(acts, dtype=np.float64), errors)
    on = {j for i in range(n) for axes in (model.offset_axes[i], *model.jacobian_axes[i]) for j in axes}
    on |= set(range(n)) if gap_axes is None else set(gap_axes)
    others = tuple(j for j in range(n) if j not in on)
    shape = layout(grid.cells, grid.periodic)
    tables = np.empty((known.winning.shape[1], table_size(shape, n)), np.int32)
    for c in range(len(tables)):
        count_holes(np.ascontiguousarray(known.winning[:, c]).astype(np.uint8), shape, n, tables[c])
    header = frame.header
    free = header.copy()
    for j in others:
        free[2 * n + j], free[3 * n + j] = -np.inf, np.inf
    factor, extra = np.full(grid.size, np.nan), np.full((grid.size, n), np.nan)
    search = searcher(image(model.interval_kernel, model.jacobian_interval_kernel), gap)
    strides = np.array([int(np.prod(grid.cells[j + 1 :])) for j in range(n)])
    cells = _looked_at(grid, tuple(sorted(on)), others, known.layers)
    about = (frame.inputs, known.kind, shape, tables, winning.astype(np.uint8))
    seen = _measured(grid, mask, count, (0,) * n if reach is None else reach)
    search(cells, _offsets(grid, others), strides, free, header, *about, *seen, factor, extra)
    return Margins(_rounded_down(factor), _rounded_down(extra))


def _looked_at(
    grid: Grid, on: tuple[int, ...], others: tuple[int, ...], layers: NDArray[np.int64] | None
) -> NDArray[np.int64]:
    """Indices of the cells whose boxes are computed, (k, nx): 0 along the other axes, and some layers of the last."""
    cells = reduced_cells(grid, on)
    cells[:, list(others)] = 0
    return cells if layers is None or not on else cells[np.isin(cells[:, on[-1]], layers)]


def _measured(grid: Grid, mask: NDArray[np.uint8], inputs: int, reach: tuple[int, ...]) -> tuple[Any, ...]:
    """Inputs that all measurements of a cell admit, and those of each: (cells, bytes), reach, cells, (measured, bytes).

    An input that all of them admit serves whatever is measured; more is asked only where the others differ.
    """
    larger = padded(grid, reach)
    sizes = np.array(reach, np.int64), np.array(larger.cells, np.int64)
    if not any(reach):
        return (mask, *sizes, mask)
    common = crop(window_and(to_words(mask, inputs), larger, reach), grid, larger)
    return (to_bytes(common, inputs), *sizes, np.ascontiguousarray(mask))


def _rounded_down(values: Floats) -> NDArray[np.float32]:
    """Half the memory, never a larger number, whatever the shape (...)."""
    short = values.astype(np.float32)
    return np.where(short > values, np.nextafter(short, np.float32(0)), short)


def _offsets(grid: Grid, axes: tuple[int, ...]) -> NDArray[np.int64]:
    """Indices along `axes` of all cells that differ along these alone: (k, nx)."""
    ranges = [np.arange(c) if j in axes else np.zeros(1, np.int64) for j, c in enumerate(grid.cells)]
    return np.stack([m.reshape(-1) for m in np.meshgrid(*ranges, indexing="ij")], axis=-1).astype(np.int64)
