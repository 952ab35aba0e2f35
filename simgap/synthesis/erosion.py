"""Bit rows: predecessor boxes as erosions of rows of cells, 64 cells a machine word.

When no offset depends on some axis, the cells along that axis form rows that all use the same boxes. A cell of a row
reaches into the set with an input exactly when the set, eroded by the box and shifted by its offset, holds the cell.
Boxes of equal size share one erosion; each input then costs one shifted load for 64 cells.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from simgap.synthesis.bit_rows import scatter


@nb.njit(cache=True, nogil=True)
def erode_along_rows(bits, width, out):  # type: ignore[no-untyped-def]
    """out bit j = AND of bits j .. j + width - 1 of the same row; beyond the row there are no cells."""
    words = bits.shape[1]
    for r in range(bits.shape[0]):
        for w in range(words):
            total = bits[r, w]
            for k in range(1, width):
                total &= _shifted(bits, r, w, k, words)
            out[r, w] = total


@nb.njit(cache=True, nogil=True)
def _shifted(bits, r, w, by, words):  # type: ignore[no-untyped-def]
    """Word `w` of row `r` moved so that its bit j is bit j + by of the row; zero beyond both ends."""
    word, bit = w + (by >> 6), np.uint64(by & 63)
    low = bits[r, word] if 0 <= word < words else np.uint64(0)
    if bit == 0:
        return low
    high = bits[r, word + 1] if 0 <= word + 1 < words else np.uint64(0)
    return (low >> bit) | (high << (np.uint64(64) - bit))


@nb.njit(cache=True, nogil=True)
def _row(n0, n1, n2, p0, p1, p2, b0, b1, b2):  # type: ignore[no-untyped-def]
    """Row of the indices b along the row axes; -1 beyond an axis that ends. Scalars only, so that it is inlined."""
    if (b0 < 0 or b0 >= n0) and p0:
        b0 %= n0
    if (b1 < 0 or b1 >= n1) and p1:
        b1 %= n1
    if (b2 < 0 or b2 >= n2) and p2:
        b2 %= n2
    if b0 < 0 or b0 >= n0 or b1 < 0 or b1 >= n1 or b2 < 0 or b2 >= n2:
        return -1
    return (b0 * n1 + b1) * n2 + b2


@nb.njit(cache=True, nogil=True)
def _word(sets, s, row, w, by, words):  # type: ignore[no-untyped-def]
    """Word `w` of a row of set `s`, moved so that its bit j is bit j + by of the row; zero beyond both ends."""
    word, bit = w + (by >> 6), np.uint64(by & 63)
    low = sets[s, row, word] >> bit if 0 <= word < words else np.uint64(0)
    if bit and 0 <= word + 1 < words:
        low |= sets[s, row, word + 1] << (np.uint64(64) - bit)
    return low


@nb.njit(cache=True, nogil=True)
def predecessors(  # type: ignore[no-untyped-def]
    lengths, periodic, layer, rel, shape_of, eroded, swept, swept_of, clear,
    keep, number, changed, near, won, free, fresh, first, last,
):  # fmt: skip
    """Newly won bits of the rows first..last; returns how many rows gained some.

    Args:
        layer: (rows,) which entry of `rel` a row uses; keep, number: the inputs to try.
        rel: (layers, M, 4) int32 lower offsets of the three row axes and of the bit axis; shape_of: (layers, M) which
            erosion; eroded: (shapes, rows, words).
        swept, swept_of, clear: the same for the swept box between samples, eroded from the free cells; no shapes
            where it does not matter.
        changed: (shapes, rows): an erosion that did not grow wins nothing new.
    """
    words, checked = won.shape[1], clear.shape[0] > 0
    n0, n1, n2 = lengths
    p0, p1, p2 = periodic
    gained = 0
    for r in range(first, last):
        missing = np.uint64(0)
        for w in range(words):
            fresh[r, w] = 0
            missing |= free[r, w] & ~won[r, w]
        if missing == 0 or not near[r]:
            continue
        a0, a1, a2 = r // (n1 * n2), r // n2 % n1, r % n2
        t = layer[r]
        for i in range(number[t]):
            m = keep[t, i]
            s = shape_of[t, m]
            other = _row(n0, n1, n2, p0, p1, p2, a0 + rel[t, m, 0], a1 + rel[t, m, 1], a2 + rel[t, m, 2])
            if other < 0 or not changed[s, other]:
                continue
            along = 0
            if checked:
                along = _row(n0, n1, n2, p0, p1, p2, a0 + swept[t, m, 0], a1 + swept[t, m, 1], a2 + swept[t, m, 2])
            if along < 0:
                continue
            for w in range(words):
                low = _word(eroded, s, other, w, rel[t, m, 3], words)
                if checked:
                    low &= _word(clear, swept_of[t, m], along, w, swept[t, m, 3], words)
                fresh[r, w] |= low
        any_new = np.uint64(0)
        for w in range(words):
            fresh[r, w] &= free[r, w] & ~won[r, w]
            any_new |= fresh[r, w]
        gained += any_new != 0
    return gained


@nb.njit(cache=True, nogil=True)
def _successor_words(lengths, periodic, r, w, t, rel, shape_of, eroded, words, out):  # type: ignore[no-untyped-def]
    """For every input, AND into `out` (M,) which cells of word `w` of row `r` its box keeps in the eroded sets."""
    n0, n1, n2 = lengths
    p0, p1, p2 = periodic
    a0, a1, a2 = r // (n1 * n2), r // n2 % n1, r % n2
    for m in range(out.size):
        other = _row(n0, n1, n2, p0, p1, p2, a0 + rel[t, m, 0], a1 + rel[t, m, 1], a2 + rel[t, m, 2])
        out[m] &= _word(eroded, shape_of[t, m], other, w, rel[t, m, 3], words) if other >= 0 else np.uint64(0)


@nb.njit(cache=True, nogil=True)
def record(  # type: ignore[no-untyped-def]
    lengths, periodic, layer, rel, shape_of, eroded, swept, swept_of, clear,
    won, fresh, base, stride, level, value, mask, first, last,
):  # fmt: skip
    """Give the fresh cells of the rows first..last their level and the bits of their inputs, then count them as won."""
    words = won.shape[1]
    inputs = np.zeros(rel.shape[1], np.uint64)
    for r in range(first, last):
        for w in range(words):
            new = fresh[r, w]
            if new == 0:
                continue
            won[r, w] |= new
            start = base[r] + 64 * w * stride
            for j in range(64):
                if new >> np.uint64(j) & np.uint64(1):
                    value[start + j * stride] = level
            if mask.shape[1] > 0:
                for m in range(inputs.size):
                    inputs[m] = new
                _successor_words(lengths, periodic, r, w, layer[r], rel, shape_of, eroded, words, inputs)
                if clear.shape[0] > 0:
                    _successor_words(lengths, periodic, r, w, layer[r], swept, swept_of, clear, words, inputs)
                scatter(inputs, new, start, stride, mask)
    return 0
