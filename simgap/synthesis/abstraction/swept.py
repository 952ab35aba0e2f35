"""The path between two samples as a swept box of cells: an input may be used only where all of them are free.

This is tighter than keeping a uniform clearance, because each input and heading has its own box: a slow input may be
used near a wall where a fast one may not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats
from simgap.gap.bounds.body_frame import rotated_box
from simgap.geometry import Grid
from simgap.late import njit
from simgap.specifications.space import SHRINK


@dataclass(frozen=True, eq=False)
class SweptCells:
    """Offsets of the touched cells from the cell of the start.

    Attributes:
        axis: the one axis on which they depend.
        lower, upper: (cells along that axis, M, nx) int32.
    """

    axis: int
    lower: NDArray[np.int32]
    upper: NDArray[np.int32]


def planar_swept_cells(
    grid: Grid, lower: Floats, upper: Floats, pose: tuple[int, int, int] = (0, 1, 2), error: Floats | None = None
) -> SweptCells:
    """From boxes in the robot's frame to cells, for every heading of a layer and every start in a cell.

    Where cells are of a measured state, the box is the path's as seen from the measured place: the headings are those
    that the robot may have, and a free cell keeps the error of its place from everything anyway (`Specification.free`).

    Args:
        grid: cells; pose: which axes are x, y and heading.
        lower, upper: (M, 2) box that holds the path of each input, the start at the origin included, m.
        error: bound of the measurement error, (nx,); None for cells of the true state.
    """
    i, j, k = pose
    width, off = 2.0 * grid.h, 0.0 if error is None else float(error[k])
    low = np.zeros((grid.cells[k], len(lower), 3), np.int32)
    high = np.zeros_like(low)
    box = np.ascontiguousarray(np.stack([lower[:, 0], upper[:, 0], lower[:, 1], upper[:, 1]], axis=1), np.float64)
    _sweep(box, float(grid.box.lo[k]), float(width[k]), off, i, j, float(width[i]), float(width[j]), low, high)
    return SweptCells(k, low, high)


@njit(cache=True, error_model="numpy")
def _sweep(box, first, step, off, i, j, width_i, width_j, low, high):  # type: ignore[no-untyped-def]
    for layer in range(low.shape[0]):
        t0 = first + step * layer
        for m in range(low.shape[1]):
            x0, x1, y0, y1 = rotated_box(t0 - off, t0 + step + off, box[m, 0], box[m, 1], box[m, 2], box[m, 3])
            low[layer, m, i], high[layer, m, i] = _cells(x0, x1, width_i)
            low[layer, m, j], high[layer, m, j] = _cells(y0, y1, width_j)


@njit(cache=True, error_model="numpy")
def _cells(a, b, width):  # type: ignore[no-untyped-def]
    return np.int32(np.floor(a / width + SHRINK)), np.int32(np.ceil(1.0 + b / width - SHRINK) - 1)
