"""What a level of reach-while-avoid found (`row_waves`), word by word: levels, admissible inputs, what is left to win.

Entries of `spread` hold 64 cells of one input. They are sorted by word, gathered as words of cells, one an input, and
turned into words of inputs, one a cell, as a controller keeps them; or the first of some order is picked for each cell.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from simgap.synthesis.row_waves import lowest


@nb.njit(cache=True, nogil=True)
def place(entries, count, ends, placed):  # type: ignore[no-untyped-def]
    """The entries in the order of their words; `ends`, how many each word has, becomes where those of a word end."""
    total = 0
    for i in range(ends.size):
        number = ends[i]
        ends[i] = total
        total += number
    for n in range(count):
        to = np.int64(entries[n, 0] >> np.uint64(32))
        placed[ends[to], 0], placed[ends[to], 1] = entries[n, 0], entries[n, 1]
        ends[to] += 1


@nb.njit(cache=True, nogil=True)
def settle(  # type: ignore[no-untyped-def]
    moves, fresh, ends, placed, every, won, todo, news, base, stride, level, order, value, mask, chosen, first, last
):
    """Win the fresh cells of the words first..last of every slab and class: level, inputs, sets, news; 0.

    fresh: (workers, classes * slabs, words of a slab), emptied. placed, ends: (workers, n, 2), (workers, words).
    value (cells, classes), mask (cells, classes, bytes); chosen (cells, classes), of the inputs in `order`, if any.
    """
    rows, words, _ = moves.size
    slabs, classes = base.size // rows, value.shape[1]
    inputs = np.zeros((max(8 * mask.shape[2], order.size) + 63) // 64 * 64, np.uint64)
    sets = np.zeros((64, inputs.size // 64), np.uint64)
    packed = sets.view(np.uint8)
    for q in range(first, last):
        for slab in range(slabs):  # cells that differ in it lie near each other in `mask`
            start = base[slab * rows + q // words] + 64 * (q % words) * stride
            for c in range(classes):
                to, new = c * slabs + slab, np.uint64(0)
                for worker in range(fresh.shape[0]):
                    new |= fresh[worker, to, q]
                    fresh[worker, to, q] = 0
                if new == 0:
                    continue
                news[c, slab] = 1
                won[c, slab, q] |= new
                todo[to, q] &= ~new
                if every:
                    for worker in range(fresh.shape[0]):
                        at = to * (rows * words) + q
                        _collect(moves.inputs_from, moves.inputs, placed[worker], ends[worker], at, inputs)
                    if order.size:
                        _choose(inputs, order, new, c, start, stride, chosen)
                    else:
                        _turn(inputs, sets)
                _write(new, c, start, stride, level, packed, value, mask)
    return 0


@nb.njit(cache=True, nogil=True)
def _write(new, c, start, stride, level, sets, value, mask):  # type: ignore[no-untyped-def]
    """Give the cells of a word their level and their inputs (64, bytes)."""
    while new:
        j = lowest(new)
        new &= new - np.uint64(1)
        value[start + j * stride, c] = level
        mask[start + j * stride, c] = sets[j, : mask.shape[2]]


@nb.njit(cache=True, nogil=True)
def _choose(inputs, order, left, c, start, stride, chosen):  # type: ignore[no-untyped-def]
    """Give each cell of a word the first of its inputs; inputs (M,), words of cells, are emptied."""
    for m in order:
        own = inputs[m] & left
        left &= ~own
        inputs[m] = 0
        while own:
            chosen[start + lowest(own) * stride, c] = m
            own &= own - np.uint64(1)


@nb.njit(cache=True, nogil=True)
def _collect(inputs_from, input_of, placed, ends, at, cells):  # type: ignore[no-untyped-def]
    """Add what the entries of a word hold to the cells of their inputs (M,)."""
    for n in range(ends[at - 1] if at else 0, ends[at]):
        v = np.int64(placed[n, 0] & np.uint64(0xFFFFFFFF))
        for i in range(inputs_from[v], inputs_from[v + 1]):
            cells[input_of[i]] |= placed[n, 1]


@nb.njit(cache=True, nogil=True)
def _turn(inputs, sets):  # type: ignore[no-untyped-def]
    """Words of cells, one an input (64 k,), into words of inputs, k a cell (64, k); the first are emptied."""
    for k in range(sets.shape[1]):
        square, seen = inputs[64 * k : 64 * k + 64], np.uint64(0)
        for i in range(64):
            seen |= square[i]
        if seen:
            _swap(square, 32, np.uint64(0x00000000FFFFFFFF))
            _swap(square, 16, np.uint64(0x0000FFFF0000FFFF))
            _swap(square, 8, np.uint64(0x00FF00FF00FF00FF))
            _swap(square, 4, np.uint64(0x0F0F0F0F0F0F0F0F))
            _swap(square, 2, np.uint64(0x3333333333333333))
            _swap(square, 1, np.uint64(0x5555555555555555))
        for i in range(64):
            sets[i, k] = square[i]
            square[i] = 0


@nb.njit(cache=True, nogil=True, inline="always")
def _swap(square, by, lower):  # type: ignore[no-untyped-def]
    """One of six steps that transpose a square of bits (Warren, Hacker's Delight, section 7-3)."""
    for block in range(0, 64, 2 * by):
        for i in range(block, block + by):
            differ = (square[i] >> np.uint64(by) ^ square[i + by]) & lower
            square[i] ^= differ << np.uint64(by)
            square[i + by] ^= differ
