"""The finite abstraction of a plant: cells, inputs, and for each pair a box of cells that holds every successor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Floats, Ints
from simgap.errors import UserError
from simgap.geometry import Grid
from simgap.late import njit
from simgap.synthesis.abstraction.holes import layout
from simgap.synthesis.abstraction.swept import SweptCells

MAX_AXES = 4


@dataclass(frozen=True, eq=False)
class Abstraction:
    """Cells x inputs -> boxes of cells, evaluated when asked for and never stored.

    Attributes:
        grid: cells of X, at most 4 axes.
        inputs: the finite input set U, (M, nu).
        post: compiled function of `pointers.POST`.
        meta, data, table: flat arrays that `post` reads.
        axes: for each dimension i, the state axes on which the offset f_i(x, u) - x_i and its spread depend.
        error: bound of the measurement error that the boxes account for, (nx,).
        group: neighbouring cells over which `post` may bound the gap at once, 1 if that would save nothing.
        swept: cells that the path between samples may touch, for each input; None where it does not matter.
    """

    grid: Grid
    inputs: Floats
    post: Any
    meta: Ints
    data: Floats
    table: NDArray[np.int32]
    axes: tuple[tuple[int, ...], ...]
    error: Floats
    swept: SweptCells | None = None
    group: int = 1

    def __post_init__(self) -> None:
        if self.grid.box.size > MAX_AXES:
            raise UserError(f"synthesis covers at most {MAX_AXES} states, not {self.grid.box.size}")
        if self.inputs.ndim != 2 or len(self.inputs) == 0:
            raise UserError("the input set is empty", remedy="Give at least one input value per input")

    @property
    def shape(self) -> Ints:
        """The grid as the kernels read it (`holes.layout`): (4, 4)."""
        return layout(self.grid.cells, self.grid.periodic)

    def boxes(self, cells: Ints, first: int = 0, last: int | None = None) -> NDArray[np.int32]:
        """Boxes of successors, not wrapped: flat cells (n,) -> (n, last - first, 2, nx) lower and upper indices."""
        last = len(self.inputs) if last is None else last
        k = np.stack(np.unravel_index(cells, self.grid.cells), axis=-1).astype(np.int64)
        out = np.zeros((len(k), last - first, 2, self.grid.box.size), dtype=np.int32)
        _boxes(self.post, np.ascontiguousarray(k), first, last, self.meta, self.data, self.table, out)
        return out


@njit(cache=True, nogil=True)
def _boxes(post, k, first, last, meta, data, table, out):  # type: ignore[no-untyped-def]
    for i in range(k.shape[0]):
        post(k[i].ctypes, 1, 1, first, last, meta.ctypes, data.ctypes, table.ctypes, out[i].ctypes)
