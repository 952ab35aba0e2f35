"""Erosion along rows of bits, 64 cells a machine word."""

from __future__ import annotations

import numba as nb
import numpy as np


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
