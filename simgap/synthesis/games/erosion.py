"""Erosion of bit rows by boxes of rows, axis by axis.

The erosion by a box is that by its edges, one axis after the other, and one edge of n rows takes log2(n) passes of
64 cells a word: AND of the set with itself, moved by 1, 2, 4, ... rows. Boxes share the passes they have in common.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Ints
from simgap.late import njit
from simgap.synthesis.games.threads import over_items

Rows = NDArray[np.uint64]


class BoxErosion:
    """Erodes sets of rows (rows, words) by many boxes (k, 4) of extents: three row axes, then along the rows.

    The result for a box is anchored at its lower corner: a cell is in it when the whole box that starts there lies in
    the set. Beyond an axis that ends there are no cells; periodic axes wrap.
    """

    def __init__(self, lengths: Ints, periodic: Ints, boxes: Ints) -> None:
        self._axes = lengths, periodic
        self._boxes = boxes[:, [3, 0, 1, 2]]  # along the rows first: most boxes share that pass
        order = np.lexsort(self._boxes.T[::-1])
        starts = np.flatnonzero(np.diff(self._boxes[order, 0])) + 1
        self._groups = np.split(order, starts) if len(order) else []

    def __call__(self, source: Rows, eroded: Rows, grew: NDArray[np.uint8], threads: int = 1) -> None:
        """Write the erosions (k, rows, words) of `source`, and `grew` (k, rows) = 1 where they are new."""
        over_items(lambda group: self._erode(group, source, eroded, grew), self._groups, threads)

    def _erode(self, group: Ints, source: Rows, eroded: Rows, grew: NDArray[np.uint8]) -> None:
        stage, spare, last = [np.empty_like(source) for _ in range(4)], np.empty_like(source), np.zeros(4, np.int64)
        erode_along_rows(source, self._boxes[group[0], 0], stage[0])
        for s in group:
            box, stale = self._boxes[s], False
            for k in range(1, 4):
                stale = stale or box[k] != last[k]
                if stale:
                    _erode_axis(*self._axes, k - 1, box[k], stage[k - 1], stage[k], spare)
            last = box
            _replace(stage[3], eroded[s], grew[s])


@njit(cache=True, nogil=True)
def _erode_axis(lengths, periodic, axis, extent, source, out, spare):  # type: ignore[no-untyped-def]
    """out row i = AND of rows i .. i + extent - 1 of `source` along one axis, by doubling; `spare` is overwritten."""
    n, inner = lengths[axis], source.shape[1]
    for j in range(axis + 1, 3):
        inner *= lengths[j]
    a, b = out.reshape(-1), spare.reshape(-1)
    a[:] = source.reshape(-1)
    have = 1
    while have < extent:
        by = min(have, extent - have)
        b[:] = a
        for outer in range(a.size // (n * inner)):
            first = outer * n * inner
            for i in range(n):
                here, there = first + i * inner, first + (i + by) % n * inner
                if i + by < n or periodic[axis]:
                    for q in range(inner):
                        a[here + q] = b[here + q] & b[there + q]
                else:
                    a[here : here + inner] = 0
        have += by


@njit(cache=True, nogil=True)
def _replace(new, old, grew):  # type: ignore[no-untyped-def]
    """old = new, with a flag for every row that differs."""
    for r in range(new.shape[0]):
        grew[r] = 0
        for w in range(new.shape[1]):
            if old[r, w] != new[r, w]:
                old[r, w] = new[r, w]
                grew[r] = 1


def dilate(flags: NDArray[np.uint8], lengths: Ints, periodic: Ints, lower: Ints, upper: Ints) -> NDArray[np.uint8]:
    """Rows r such that some flagged row lies in r + [lower, upper] along every row axis, (rows,)."""
    out = flags.reshape(tuple(lengths))
    for axis in range(3):
        out = _dilate_axis(np.moveaxis(out, axis, 0), bool(periodic[axis]), int(lower[axis]), int(upper[axis]), axis)
    return np.ascontiguousarray(out.reshape(-1))


def _dilate_axis(flags: NDArray[np.uint8], wraps: bool, lower: int, upper: int, axis: int) -> NDArray[np.uint8]:
    n = len(flags)
    out = np.zeros_like(flags)
    if wraps and upper - lower >= n:
        lower, upper = 0, n - 1
    for by in range(lower, upper + 1):
        if wraps:
            out |= np.roll(flags, -by, axis=0)
        elif abs(by) < n:
            out[max(0, -by) : n - max(0, by)] |= flags[max(0, by) : n + min(0, by)]
    return np.moveaxis(out, 0, axis)


@njit(cache=True, nogil=True)
def erode_along_rows(bits, width, out):  # type: ignore[no-untyped-def]
    """out bit j = AND of bits j .. j + width - 1 of the same row; beyond the row there are no cells."""
    words = bits.shape[1]
    for r in range(bits.shape[0]):
        for w in range(words):
            total = bits[r, w]
            for k in range(1, width):
                total &= _shifted(bits, r, w, k, words)
            out[r, w] = total


@njit(cache=True, nogil=True)
def _shifted(bits, r, w, by, words):  # type: ignore[no-untyped-def]
    """Word `w` of row `r` moved so that its bit j is bit j + by of the row; zero beyond both ends."""
    word, bit = w + (by >> 6), np.uint64(by & 63)
    low = bits[r, word] if 0 <= word < words else np.uint64(0)
    if bit == 0:
        return low
    high = bits[r, word + 1] if 0 <= word + 1 < words else np.uint64(0)
    return (low >> bit) | (high << (np.uint64(64) - bit))
