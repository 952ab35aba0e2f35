"""Rows of cells as bits of machine words: packing, unpacking into sets of inputs, and which boxes are worth trying."""

from __future__ import annotations

import numba as nb
import numpy as np


@nb.njit(cache=True, nogil=True)
def pack_rows(cells, base, stride, count, bits):  # type: ignore[no-untyped-def]
    """Pack flags of cells (flat uint8) into rows (rows, words) uint64; cell j of a row is `base[row] + j stride`."""
    for r in range(base.size):
        for w in range(bits.shape[1]):
            bits[r, w] = np.uint64(0)
        for j in range(count):
            if cells[base[r] + j * stride]:
                bits[r, j >> 6] |= np.uint64(1) << np.uint64(j & 63)


@nb.njit(cache=True, nogil=True)
def smallest_boxes(lower, extent, keep, number):  # type: ignore[no-untyped-def]
    """Per layer the inputs whose boxes hold no other input's boxes: what any input wins, one of these wins.

    lower, extent (layers, M, k), one or more boxes beside each other -> keep (layers, M) input numbers in front,
    number (layers,) how many.
    """
    inputs = lower.shape[1]
    for layer in range(lower.shape[0]):
        number[layer] = 0
        for m in range(inputs):
            smallest = True
            for o in range(inputs):
                inside = o != m
                same = True
                for j in range(lower.shape[2]):
                    a, b = lower[layer, m, j], lower[layer, o, j]
                    c, d = a + extent[layer, m, j], b + extent[layer, o, j]
                    inside = inside and b >= a and d <= c
                    same = same and a == b and c == d
                if inside and (not same or o < m):
                    smallest = False
                    break
            if smallest:
                keep[layer, number[layer]] = m
                number[layer] += 1


@nb.njit(cache=True, nogil=True)
def _transposed(x):  # type: ignore[no-untyped-def]
    """Bit 8 a + b of a word to bit 8 b + a (Warren, Hacker's Delight, section 7-3)."""
    t = (x ^ (x >> np.uint64(7))) & np.uint64(0x00AA00AA00AA00AA)
    x ^= t ^ (t << np.uint64(7))
    t = (x ^ (x >> np.uint64(14))) & np.uint64(0x0000CCCC0000CCCC)
    x ^= t ^ (t << np.uint64(14))
    t = (x ^ (x >> np.uint64(28))) & np.uint64(0x00000000F0F0F0F0)
    return x ^ t ^ (t << np.uint64(28))


@nb.njit(cache=True, nogil=True)
def scatter(inputs, new, start, stride, mask):  # type: ignore[no-untyped-def]
    """Turn words of cells, one per input, into bytes of inputs, one row per cell in `new`, eight by eight."""
    for group in range(8):
        cells = new >> np.uint64(8 * group) & np.uint64(255)
        if cells == 0:
            continue
        for byte in range(mask.shape[1]):
            square = np.uint64(0)
            for m in range(8 * byte, min(8 * byte + 8, inputs.size)):
                square |= (inputs[m] >> np.uint64(8 * group) & np.uint64(255)) << np.uint64(8 * (m & 7))
            if square == 0:
                continue
            square = _transposed(square)
            for j in range(8):
                if cells >> np.uint64(j) & np.uint64(1):
                    mask[start + (8 * group + j) * stride, byte] = square >> np.uint64(8 * j) & np.uint64(255)
