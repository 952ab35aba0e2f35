"""The maximal controlled invariant set by cells of several sizes: the set and the inputs of `invariance`, bit for bit.

The set W begins as the safe cells, and cells are taken out of it in place, one node of a layer at a time. With the
boxes of `layer_tables`, and W as it is, of a node and an input is known:

    HOLDS  if `every` lies in W: each of its fine cells may use the input;
    FAILS  if `common` leaves the grid or meets a hole; or, if it is empty along some axes and `every` is taken along
           these, if no cell of that box is in W: each fine cell's box has a hole, now and ever after, as W shrinks;
    MAYBE  otherwise: its smaller nodes are asked. A fine cell's `every` is `common`, and it has no MAYBE.

A node of which every input fails is taken out with all its cells. Layers come in one after the other: until nothing
changes, the finest so far is only asked whether some input does not fail, so that most of what is lost goes in large
pieces; then a node is held by an input that holds, and its smaller nodes are looked at if none does. A node remembers
the input that it rests on, and is asked again only if cells near that box were lost since it was asked last.

Only cells are lost of which every input fails in a superset of the greatest fixed point, so that it is never cut. At
the end each cell of W lies in a node with an input that holds in W, so that W is a fixed point: it is the greatest one.

Cells of several sizes over one grid: what the successors of all fine cells of a coarse one have in common.

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

from simgap.arrays import Bools, Ints
from simgap.errors import UserError
from simgap.late import njit
from simgap.synthesis.abstraction.cells import MAX_AXES, Abstraction
from simgap.synthesis.abstraction.post import table_post
from simgap.synthesis.games.invariance import Invariance
from simgap.synthesis.input_sets import packed_width

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
    return [_layer_of(abstraction, 2**k) for k in range(count - 1, -1, -1)]


def no_layers(what: str) -> UserError:
    """For what cells of several sizes are not made."""
    return UserError(f"layers are not made for {what}", key="synthesis.layers", remedy="Leave the key out.")


def root(cells: Ints, inputs: int) -> Layer:
    """One node that holds every cell and is never decided: what the coarsest layer is part of."""
    one = np.ones(MAX_AXES, np.int64)
    nothing = np.zeros((MAX_AXES, MAX_AXES + 1), np.int64)
    return _unseen(one, cells, nothing, np.zeros((1, inputs, 4), np.int32), True)


def _layer_of(abstraction: Abstraction, side: int) -> Layer:
    grid, inputs = abstraction.grid, len(abstraction.inputs)
    n = grid.box.size
    front = MAX_AXES - n
    count = np.ones(MAX_AXES, np.int64)
    count[front:] = [-(-c // side) for c in grid.cells]
    rows = np.zeros((MAX_AXES, MAX_AXES + 1), np.int64)
    parts, first = [np.zeros((1, inputs, 4), np.int32)], 1  # the first row serves the axes of one cell
    for i in range(n):
        parts.append(_layer_table(abstraction, i, side))
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


def _layer_table(abstraction: Abstraction, i: int, side: int) -> Shorts:
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


BLOCK = 2
"""Cells a side of the blocks that losses are dated by: about the size of a successor box."""
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


class Board(NamedTuple):
    """A set of cells that only shrinks; axes of one cell stand before those of the grid.

    Attributes:
        cells: (4,) along each axis. words: of a row.
        bits: (rows * words,) uint64, bit 1 for a cell of the set, 0 beyond the end of a row.
        blocks: (4,) blocks along each axis. lost: (blocks,) int32 the last pass that took a cell out of each.
    """

    cells: Ints
    words: int
    bits: NDArray[np.uint64]
    blocks: Ints
    lost: NDArray[np.int32]


def board(shape: tuple[int, ...], inside: Bools) -> Board:
    """The board of a grid of at most 4 axes with the cells (cells,) of a set."""
    cells = np.ones(MAX_AXES, np.int64)
    cells[MAX_AXES - len(shape) :] = shape
    row = int(cells[-1])
    words = -(-row // 64)
    padded = np.zeros((inside.size // row, words * 64), np.uint8)
    padded[:, :row] = inside.reshape(-1, row)
    bits = np.packbits(padded, axis=1, bitorder="little").view("<u8").astype(np.uint64).reshape(-1)
    blocks = -(-cells // BLOCK)
    return Board(cells, words, bits, blocks, np.zeros(int(np.prod(blocks)), np.int32))


def members(made: Board) -> Bools:
    """The cells of the set, (cells,) bool."""
    flags = np.unpackbits(made.bits.astype("<u8").view(np.uint8).reshape(-1, 8 * made.words), axis=1, bitorder="little")
    return np.ascontiguousarray(flags[:, : made.cells[-1]]).reshape(-1).view(np.bool_)


@njit(cache=True, nogil=True)
def all_are(cells, words, bits, lo, hi, inside):  # type: ignore[no-untyped-def]
    """True if all cells of the box [lo, hi] (4,), which lies in the grid, are in the set (or none, if not `inside`).

    The innermost call of all: the board comes as its arrays, since unpacking a tuple takes longer than the rest.
    """
    w0, w1 = lo[3] >> 6, hi[3] >> 6
    m0, m1 = _ALL << np.uint64(lo[3] & 63), _ALL >> np.uint64(63 - (hi[3] & 63))
    if w0 == w1:
        m0 &= m1
    for i in range(lo[0], hi[0] + 1):
        for j in range(lo[1], hi[1] + 1):
            row = ((i * cells[1] + j) * cells[2] + lo[2]) * words
            for _ in range(lo[2], hi[2] + 1):
                for w in range(w0, w1 + 1):
                    word = ~bits[row + w] if inside else bits[row + w]
                    if w == w0:
                        word &= m0
                    elif w == w1:
                        word &= m1
                    if word != 0:
                        return False
                row += words
    return True


@njit(cache=True, nogil=True)
def take_out(board, lo, hi, now):  # type: ignore[no-untyped-def]
    """Take the cells of the box [lo, hi] (4,), which lies in the grid, out of the set in pass `now`."""
    for i in range(lo[0], hi[0] + 1):
        for j in range(lo[1], hi[1] + 1):
            for k in range(lo[2], hi[2] + 1):
                row = ((i * board.cells[1] + j) * board.cells[2] + k) * board.words
                for c in range(lo[3], hi[3] + 1):
                    board.bits[row + (c >> 6)] &= ~(np.uint64(1) << np.uint64(c & 63))
                    block = (i // BLOCK * board.blocks[1] + j // BLOCK) * board.blocks[2] + k // BLOCK
                    board.lost[block * board.blocks[3] + c // BLOCK] = now


@njit(cache=True, nogil=True)
def lost_since(cells, blocks, lost, lo, hi, since):  # type: ignore[no-untyped-def]
    """True if a cell of a block that the box [lo, hi] (4,) meets was lost in the pass `since` or later."""
    for i in range(max(lo[0], 0) // BLOCK, min(hi[0], cells[0] - 1) // BLOCK + 1):
        for j in range(max(lo[1], 0) // BLOCK, min(hi[1], cells[1] - 1) // BLOCK + 1):
            for k in range(max(lo[2], 0) // BLOCK, min(hi[2], cells[2] - 1) // BLOCK + 1):
                row = ((i * blocks[1] + j) * blocks[2] + k) * blocks[3]
                for c in range(max(lo[3], 0) // BLOCK, min(hi[3], cells[3] - 1) // BLOCK + 1):
                    if lost[row + c] >= since:
                        return True
    return False


UNSEEN, POSSIBLE, HELD, OPEN, LOST = range(5)
FAILS, MAYBE, HOLDS = range(3)


class Place(NamedTuple):
    """Scratch of a kernel, each (4,): a node's first fine cell, its rows of the table, a box."""

    first: Ints
    row: Ints
    lo: Ints
    hi: Ints


def layered_invariance(
    abstraction: Abstraction, layers: int, safe: Bools | None = None
) -> tuple[Invariance, list[int]]:
    """Largest set of safe cells in which some input keeps every successor, with all such inputs.

    Args:
        abstraction: cells, inputs and tables of offsets.
        layers: sizes of nodes, 2^(layers - 1) fine cells a side the largest.
        safe: cells to stay in, (cells,); all of them when None.

    Returns:
        The set, and for each layer from the coarsest how many pairs of node and input were asked about, those asked
        about again included.

    Raises:
        UserError: states that wrap; boxes that are not tabulated; more than 32,767 inputs.
    """
    grid, inputs = abstraction.grid, len(abstraction.inputs)
    if inputs > np.iinfo(np.int16).max:
        raise UserError(f"layers number at most {np.iinfo(np.int16).max} inputs, not {inputs}", key="synthesis.layers")
    made = board(grid.cells, np.ones(grid.size, np.bool_) if safe is None else safe)
    above = root(made.cells, inputs)
    above.status[:] = OPEN
    every = layers_of(abstraction, layers)
    parents = [above, *every]
    asked = np.zeros((layers, 1), np.int64)
    at = Place(*np.zeros((4, MAX_AXES), np.int64))
    now = 0
    for deepest in range(layers):
        lost = 1
        while lost:
            now, lost = now + 1, 0
            for k in range(deepest + 1):
                lost += _sweep(every[k], parents[k], made, at, k == deepest, k == layers - 1, now, asked[k])
    mask = np.zeros((grid.size, packed_width(inputs)), np.uint8)
    for k, layer in enumerate(every):
        _admit(layer, parents[k], made, at, k == layers - 1, mask, asked[k])
    pairs = int(np.bitwise_count(mask).sum(dtype=np.int64))
    return Invariance(members(made), mask, pairs, now), [int(count) for count in asked[:, 0]]


@njit(cache=True, nogil=True)
def _place(count, side, rows, parents, parent_side, node, first, row, lo):  # type: ignore[no-untyped-def]
    """Write the node's `first` fine cell and its rows of the table, (4,) each; returns its parent."""
    rest, above = node, 0
    for j in range(MAX_AXES - 1, -1, -1):
        lo[j] = rest % count[j]
        first[j] = lo[j] * side[j]
        rest //= count[j]
    for i in range(MAX_AXES):
        above = above * parents[i] + first[i] // parent_side[i]
        row[i] = rows[i, 0]
        for j in range(MAX_AXES):
            row[i] += rows[i, 1 + j] * lo[j]
    return above


@njit(cache=True, nogil=True)
def _judge(table, first, row, lo, hi, cells, words, bits, m, holds, finest):  # type: ignore[no-untyped-def]
    """FAILS, MAYBE or HOLDS of a node and the input `m`; whether it holds is asked only if `holds`."""
    inside, empty = True, False
    for i in range(MAX_AXES):
        r = row[i]
        if first[i] + table[r, m, 2] < 0 or first[i] + table[r, m, 3] >= cells[i]:
            return FAILS
        lo[i], hi[i] = first[i] + table[r, m, 0], first[i] + table[r, m, 1]
        inside = inside and lo[i] >= 0 and hi[i] < cells[i]
        empty = empty or table[r, m, 2] > table[r, m, 3]
    if finest:
        return HOLDS if all_are(cells, words, bits, lo, hi, True) else FAILS
    if holds and inside and all_are(cells, words, bits, lo, hi, True):
        return HOLDS
    for i in range(MAX_AXES):
        r = row[i]
        if table[r, m, 2] <= table[r, m, 3]:
            lo[i], hi[i] = first[i] + table[r, m, 2], first[i] + table[r, m, 3]
        lo[i], hi[i] = max(lo[i], 0), min(hi[i], cells[i] - 1)
    if empty:
        return FAILS if all_are(cells, words, bits, lo, hi, False) else MAYBE
    return MAYBE if all_are(cells, words, bits, lo, hi, True) else FAILS


@njit(cache=True, nogil=True)
def _decide(  # type: ignore[no-untyped-def]
    table, first, row, lo, hi, cells, words, bits, status, old, options, deepest, finest, asked
):  # fmt: skip
    """Status of a node and the input that it rests on, `old` before; failing inputs go out of `options`."""
    inputs, start = table.shape[1], old
    if finest or (status != OPEN and not deepest):
        for m in range(start, inputs):
            if options[m >> 3] >> (m & 7) & 1:
                asked[0] += 1
                verdict = _judge(table, first, row, lo, hi, cells, words, bits, m, True, finest)
                if verdict == HOLDS:
                    return HELD, m
                if verdict == FAILS:
                    options[m >> 3] &= np.uint8(~(1 << (m & 7)) & 255)
        if finest:
            return LOST, start
        start = 0
    for m in range(start, inputs):
        if options[m >> 3] >> (m & 7) & 1:
            asked[0] += 1
            if _judge(table, first, row, lo, hi, cells, words, bits, m, False, finest) == MAYBE:
                return (POSSIBLE if deepest else OPEN), m
            options[m >> 3] &= np.uint8(~(1 << (m & 7)) & 255)
    return LOST, start


@njit(cache=True, nogil=True)
def _quiet(table, first, row, lo, hi, cells, blocks, lost, m, since):  # type: ignore[no-untyped-def]
    """True if nothing was lost near the box of a node and the input `m` in the pass `since` and later."""
    for i in range(MAX_AXES):
        lo[i], hi[i] = first[i] + table[row[i], m, 0], first[i] + table[row[i], m, 1]
    return not lost_since(cells, blocks, lost, lo, hi, since)


@njit(cache=True, nogil=True)
def _sweep(layer, parent, made, at, deepest, finest, now, asked):  # type: ignore[no-untyped-def]
    """Ask all nodes of a layer whose parent is open; returns how many were lost by themselves.

    Tuples are unpacked here, once: an array taken out of one is counted, which in a loop costs more than the rest.
    """
    cells, words, bits, blocks, dated = made
    count, side, rows, table, status, remembered, alive = layer
    parents, parent_side, parent_status, parent_alive = parent.nodes, parent.side, parent.status, parent.alive
    first, row, lo, hi = at
    options = np.zeros(alive.shape[1], np.uint8)
    lost = 0
    for number in range(status.size):
        node = number if now & 1 else status.size - 1 - number  # both ways in turn: a loss travels far in one pass
        if status[node] == LOST:
            continue
        above = _place(count, side, rows, parents, parent_side, node, first, row, lo)
        if parent_status[above] == LOST:
            status[node] = LOST
        if parent_status[above] != OPEN:
            continue
        for b in range(options.size):
            options[b] = parent_alive[above, b] & (np.uint8(255) if finest else alive[node, b])
        m, old = np.int64(remembered[node]), status[node]
        asked_before = old != UNSEEN and (old != POSSIBLE or deepest) and options[m >> 3] >> (m & 7) & 1
        if asked_before and _quiet(table, first, row, lo, hi, cells, blocks, dated, m, now - 1):
            continue
        about = (table, first, row, lo, hi, cells, words, bits)
        status[node], remembered[node] = _decide(*about, old, m, options, deepest, finest, asked)
        for b in range(0 if finest else options.size):
            alive[node, b] = options[b]
        if status[node] == LOST:
            lost += 1
            for j in range(MAX_AXES):
                lo[j], hi[j] = first[j], min(first[j] + side[j], cells[j]) - 1
            take_out(made, lo, hi, now)
    return lost


@njit(cache=True, nogil=True)
def _admit(layer, parent, made, at, finest, mask, asked):  # type: ignore[no-untyped-def]
    """Write the inputs that hold of each node to its cells; those that may stay `alive` for its smaller nodes."""
    cells, words, bits, _, _ = made
    count, side, rows, table, status, _, alive = layer
    parents, parent_side, parent_alive = parent.nodes, parent.side, parent.alive
    first, row, lo, hi = at
    held, options = np.zeros(mask.shape[1], np.uint8), np.zeros(mask.shape[1], np.uint8)
    for node in range(status.size):
        above = _place(count, side, rows, parents, parent_side, node, first, row, lo)
        for j in range(MAX_AXES):
            lo[j], hi[j] = first[j], min(first[j] + side[j], cells[j]) - 1
        lost = status[node] == LOST or all_are(cells, words, bits, lo, hi, False)
        some = False
        for b in range(options.size):
            own = np.uint8(255) if finest else alive[node, b]
            held[b], options[b] = 0, np.uint8(0) if lost else parent_alive[above, b] & own
        for m in range(table.shape[1]):
            if options[m >> 3] >> (m & 7) & 1:
                asked[0] += 1
                verdict = _judge(table, first, row, lo, hi, cells, words, bits, m, True, finest)
                some = some or verdict == HOLDS
                if verdict == HOLDS:
                    held[m >> 3] |= np.uint8(1 << (m & 7))
                if verdict != MAYBE:
                    options[m >> 3] &= np.uint8(~(1 << (m & 7)) & 255)
        for b in range(0 if finest else options.size):
            alive[node, b] = options[b]
        if some:
            for j in range(MAX_AXES):
                lo[j], hi[j] = first[j], min(first[j] + side[j], cells[j]) - 1
            _give(cells, words, bits, lo, hi, held, mask)


@njit(cache=True, nogil=True)
def _give(cells, words, bits, lo, hi, held, mask):  # type: ignore[no-untyped-def]
    """Add the inputs `held` to those of the cells of the set in the box [lo, hi]."""
    for i in range(lo[0], hi[0] + 1):
        for j in range(lo[1], hi[1] + 1):
            for k in range(lo[2], hi[2] + 1):
                row = (i * cells[1] + j) * cells[2] + k
                for c in range(lo[3], hi[3] + 1):
                    if bits[row * words + (c >> 6)] >> np.uint64(c & 63) & np.uint64(1):
                        for b in range(held.size):
                            mask[row * cells[3] + c, b] |= held[b]
