"""Abstraction whose growth bound is given by the caller: integer tables on reduced axes.

Reissig, Weber and Rungger (2017), "Feedback refinement relations for the synthesis of symbolic controllers".

The box of a cell with centre c and half-width r under u is `step(c, u) -/+ growth(r, u)`. Nothing here checks that the
growth bound is one; `simgap.synthesis.abstraction.cells` derives its own and rounds outward.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.geometry import Grid
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.post import reduced_cells, reduced_size, table_meta, table_post

ENLARGEMENT = 1e-10  # of a cell, before the growth and again after it
TOGETHER = 1 << 18  # pairs of cell and input that are tabulated in one call
TOLERANCE = 1e-9  # of a cell: a post that only touches the next cell counts as reaching it


def growth_abstraction(
    grid: Grid,
    inputs: Floats,
    step: Callable[[Floats, Floats], Floats],
    growth: Callable[[Floats, Floats], Floats],
    axes: tuple[tuple[int, ...], ...],
) -> Abstraction:
    """Tabulate `step(x, u) - x` and `growth(r, u)` on the axes they depend on.

    Args:
        grid: cells of X.
        inputs: U, (M, nu).
        step: x (n, nx), u (n, nu) -> (n, nx).
        growth: r (n, nx) half-widths, u (n, nu) -> (n, nx) half-widths.
        axes: for each dimension i, the axes on which f_i(x, u) - x_i depends.

    Raises:
        UserError: if the tables would need more than a few numbers per cell.
    """
    pairs = sum(reduced_size(grid, own) for own in axes) * len(inputs)
    if pairs > 8 * grid.size + 100_000:
        raise UserError(
            f"a caller-given growth bound needs {pairs} table entries on {grid.size} cells",
            remedy="Name for each dimension only the axes on which f - x depends",
        )
    meta, total = table_meta(grid, len(inputs), axes)
    table = np.empty((total, 2), dtype=np.int32)
    width = 2.0 * grid.h
    radius = np.tile(grid.h + ENLARGEMENT * width, (len(inputs), 1))
    spread = growth(radius, inputs) + ENLARGEMENT * width
    starts = np.cumsum([0, *(reduced_size(grid, own) * len(inputs) for own in axes)])
    for own in dict.fromkeys(axes):  # dimensions on the same axes share every evaluation
        alike = [i for i, other in enumerate(axes) if other == own]
        centre, at = grid.box.lo + grid.h * (2.0 * reduced_cells(grid, own) + 1.0), 0
        for x in np.array_split(centre, -(-len(centre) * len(inputs) // TOGETHER)):
            points, chosen = np.repeat(x, len(inputs), axis=0), np.tile(inputs, (len(x), 1))
            following = step(points, chosen)
            for i in alike:
                offset, wide = following[:, i] - points[:, i], np.tile(spread[:, i], len(x))
                lo, hi = (offset - wide) / width[i] + 0.5, (offset + wide) / width[i] + 0.5
                table[starts[i] + at : starts[i] + at + len(points)] = cell_offsets(lo, hi, TOLERANCE)
            at += len(points)
    return Abstraction(
        grid=grid,
        inputs=np.ascontiguousarray(inputs, dtype=np.float64),
        post=table_post(),
        meta=meta,
        data=np.zeros(1),
        table=table.reshape(-1),
        axes=axes,
        error=np.zeros(grid.box.size),
    )


def cell_offsets(lo: Floats, hi: Floats, slack: float) -> NDArray[np.int32]:
    """Cells covered by the interval [lo, hi], in cell widths from the cell's lower face, widened by `slack` cells.

    lo, hi (...,) -> (..., 2) int32 of floor.
    """
    return np.stack([np.floor(lo - slack), np.floor(hi + slack)], axis=-1).astype(np.int32)
