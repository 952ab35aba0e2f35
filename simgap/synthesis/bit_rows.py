"""Rows of cells as bits of machine words, and which boxes are worth trying."""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

COMPARED = 256


@nb.njit(cache=True, nogil=True)
def pack_rows(cells, base, stride, count, bits):  # type: ignore[no-untyped-def]
    """Pack flags of cells (flat uint8) into rows (rows, words) uint64; cell j of a row is `base[row] + j stride`."""
    for r in range(base.size):
        for w in range(bits.shape[1]):
            bits[r, w] = np.uint64(0)
        for j in range(count):
            if cells[base[r] + j * stride]:
                bits[r, j >> 6] |= np.uint64(1) << np.uint64(j & 63)


def smallest_boxes(lower: NDArray[np.int32], upper: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Inputs without most of those whose boxes hold another one's: what any input wins, one of these wins.

    lower, upper (layers, M, k), one or more boxes beside each other -> (layers, M). Every box is held against the
    `COMPARED` smallest that are left, so that it takes a time linear in the inputs.
    """
    kept = np.zeros(lower.shape[:2], np.bool_)
    order = np.argsort((upper.astype(np.int64) - lower).sum(axis=2), axis=1, kind="stable")
    _smallest(lower, upper, order, kept)
    return kept


@nb.njit(cache=True, nogil=True)
def _smallest(lower, upper, order, kept):  # type: ignore[no-untyped-def]
    smallest = np.zeros(COMPARED, np.int64)
    for layer in range(lower.shape[0]):
        number = 0
        for m in order[layer]:
            found = False
            for i in range(number):
                o, inside = smallest[i], True
                for j in range(lower.shape[2]):
                    if lower[layer, o, j] < lower[layer, m, j] or upper[layer, o, j] > upper[layer, m, j]:
                        inside = False
                        break
                if inside:
                    found = True
                    break
            if not found:
                kept[layer, m] = True
                if number < COMPARED:
                    smallest[number] = m
                    number += 1
