"""Boxes of cells on a set that only shrinks, kept as rows of bits along the last axis: 64 cells a machine word."""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from simgap.synthesis.abstraction import MAX_AXES

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

    cells: NDArray[np.int64]
    words: int
    bits: NDArray[np.uint64]
    blocks: NDArray[np.int64]
    lost: NDArray[np.int32]


def board(shape: tuple[int, ...], inside: NDArray[np.bool_]) -> Board:
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


def members(made: Board) -> NDArray[np.bool_]:
    """The cells of the set, (cells,) bool."""
    flags = np.unpackbits(made.bits.astype("<u8").view(np.uint8).reshape(-1, 8 * made.words), axis=1, bitorder="little")
    return np.ascontiguousarray(flags[:, : made.cells[-1]]).reshape(-1).view(np.bool_)


@nb.njit(cache=True, nogil=True)
def all_are(cells, words, bits, lo, hi, inside):  # type: ignore[no-untyped-def]
    """Whether all cells of the box [lo, hi] (4,), which lies in the grid, are in the set (or none, if not `inside`).

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


@nb.njit(cache=True, nogil=True)
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


@nb.njit(cache=True, nogil=True)
def lost_since(cells, blocks, lost, lo, hi, since):  # type: ignore[no-untyped-def]
    """Whether a cell of a block that the box [lo, hi] (4,) meets was lost in the pass `since` or later."""
    for i in range(max(lo[0], 0) // BLOCK, min(hi[0], cells[0] - 1) // BLOCK + 1):
        for j in range(max(lo[1], 0) // BLOCK, min(hi[1], cells[1] - 1) // BLOCK + 1):
            for k in range(max(lo[2], 0) // BLOCK, min(hi[2], cells[2] - 1) // BLOCK + 1):
                row = ((i * blocks[1] + j) * blocks[2] + k) * blocks[3]
                for c in range(max(lo[3], 0) // BLOCK, min(hi[3], cells[3] - 1) // BLOCK + 1):
                    if lost[row + c] >= since:
                        return True
    return False
