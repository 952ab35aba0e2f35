"""Cells of several sizes over one grid: what the successors of all fine cells of a coarse one have in common.

A *node* of a layer is a block of `side` fine cells along each axis. With [lo(c), hi(c)] the successor box of the fine
cell c and one input, two boxes are tabulated for each node and input, from the integer offsets of the fine cells alone:

    every:  [min lo, max hi] over its fine cells: holds all their boxes
    common: [max lo, min hi] over its fine cells: lies in each of their boxes; along an axis it may be empty

They are exact over the fine boxes, so that what is decided for a node is decided for each of its fine cells. A block
that the end of the grid cuts off counts as whole along its own axis: `every` is larger than it need be, `common`
smaller.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Ints
from simgap.errors import UserError
from simgap.synthesis.abstraction.cells import MAX_AXES, Abstraction
from simgap.synthesis.abstraction.tables import table_post
from simgap.synthesis.bits import packed_width

Shorts = NDArray[np.int32]


class Layer(NamedTuple):
    """The nodes of one size, and what is known of them; axes of one cell stand before those of the grid.

    Attributes:
        nodes, side: (4,) nodes along each axis; fine cells along each side of a node.
        rows: (4, 5) of each dimension the first row of `table` and how many rows a node further along each axis is.
        table: (rows, M, 4) of each dimension and input min lo, max hi, max lo, min hi, from the node's first fine cell.
        status: (nodes,) uint8, of `layered`. remembered: (nodes,) int16 the input that it rests on.
        alive: (nodes, ceil(M / 8)) packed inputs that some of the node's cells may use; none are kept of fine cells.
    """

    nodes: Ints
    side: Ints
    rows: Ints
    table: Shorts
    status: NDArray[np.uint8]
    remembered: NDArray[np.int16]
    alive: NDArray[np.uint8]


def layers_of(abstraction: Abstraction, count: int) -> list[Layer]:
    """Layers of nodes from the coarsest, of 2^(count - 1) fine cells a side, to the fine cells themselves.

    Raises:
        UserError: states that wrap; boxes that are not tabulated.
    """
    if abstraction.grid.periodic:
        raise no_layers("states that wrap")
    if abstraction.post is not table_post():
        raise no_layers("a gap or a model that depends on too many states for tables of so few cells")
    return [_layer(abstraction, 2**k) for k in range(count - 1, -1, -1)]


def no_layers(what: str) -> UserError:
    """For what cells of several sizes are not made."""
    return UserError(f"layers are not made for {what}", key="synthesis.layers", remedy="Leave the key out.")


def root(cells: Ints, inputs: int) -> Layer:
    """One node that holds every cell and is never decided: what the coarsest layer is part of."""
    one = np.ones(MAX_AXES, np.int64)
    nothing = np.zeros((MAX_AXES, MAX_AXES + 1), np.int64)
    return _unseen(one, cells, nothing, np.zeros((1, inputs, 4), np.int32), True)


def _layer(abstraction: Abstraction, side: int) -> Layer:
    grid, inputs = abstraction.grid, len(abstraction.inputs)
    n = grid.box.size
    front = MAX_AXES - n
    count = np.ones(MAX_AXES, np.int64)
    count[front:] = [-(-c // side) for c in grid.cells]
    rows = np.zeros((MAX_AXES, MAX_AXES + 1), np.int64)
    parts, first = [np.zeros((1, inputs, 4), np.int32)], 1  # the first row serves the axes of one cell
    for i in range(n):
        parts.append(_dimension(abstraction, i, side))
        rows[front + i, 0] = first
        stride = 1
        for j in sorted(abstraction.axes[i], reverse=True):
            rows[front + i, 1 + front + j] = stride
            stride *= int(count[front + j])
        first += stride
    sides = np.ones(MAX_AXES, np.int64)
    sides[front:] = side
    return _unseen(count, sides, rows, np.concatenate(parts), side > 1)


def _unseen(count: Ints, sides: Ints, rows: Ints, table: Shorts, keeps: bool) -> Layer:
    nodes, inputs = int(np.prod(count)), table.shape[1]
    every = np.packbits(np.ones(inputs, np.uint8), bitorder="little")
    alive = np.tile(every, (nodes if keeps else 1, 1)).reshape(-1, packed_width(inputs))
    status, remembered = np.zeros(nodes, np.uint8), np.zeros(nodes, np.int16)
    return Layer(count, sides, rows, table, status, remembered, alive)


def _dimension(abstraction: Abstraction, i: int, side: int) -> Shorts:
    """`Layer.table` of one dimension: (nodes over its axes, M, 4)."""
    grid, inputs, n = abstraction.grid, len(abstraction.inputs), abstraction.grid.box.size
    own = sorted(abstraction.axes[i])
    shape = [grid.cells[j] for j in own]
    first, size = int(abstraction.meta[2 + i * (n + 1)]), 2 * inputs * int(np.prod(shape))
    offsets = abstraction.table[first : first + size].reshape(*shape, inputs, 2)
    step = np.zeros(1, np.int32)
    if i in own:  # from the node's first cell, not from each fine cell
        step = (np.arange(grid.cells[i], dtype=np.int32) % side).reshape([-1 if j == i else 1 for j in own] + [1])
    least_lo = most_lo = offsets[..., 0] + step
    least_hi = most_hi = offsets[..., 1] + step
    for axis, j in enumerate(own):
        starts = np.arange(0, grid.cells[j], side)
        least_lo, least_hi = (np.minimum.reduceat(a, starts, axis=axis) for a in (least_lo, least_hi))
        most_lo, most_hi = (np.maximum.reduceat(a, starts, axis=axis) for a in (most_lo, most_hi))
    along = np.int32(0 if i in own else side - 1)
    both = np.stack([least_lo, most_hi + along, most_lo + along, least_hi], axis=-1)
    return np.asarray(both.reshape(-1, inputs, 4), dtype=np.int32)
