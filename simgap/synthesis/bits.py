"""Packed sets of inputs: bit m % 8 of byte m // 8 is input m."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Ints
from simgap.late import njit

Bytes = NDArray[np.uint8]


def packed_width(inputs: int) -> int:
    """Bytes that hold one bit per input."""
    return (inputs + 7) // 8


def unpack(mask: Bytes, inputs: int) -> Bools:
    """(..., ceil(M / 8)) -> (..., M)."""
    return np.unpackbits(mask, axis=-1, count=inputs, bitorder="little").view(np.bool_)


def preferred(mask: Bytes, order: Ints) -> NDArray[np.int16]:
    """The first input of `order` that each set holds, -1 for the empty set: (n, bytes), (M,) -> (n,)."""
    out = np.empty(len(mask), np.int16)
    _preferred(mask, order, out)
    return out


@njit(cache=True, nogil=True)
def _preferred(mask, order, out):  # type: ignore[no-untyped-def]
    for i in range(mask.shape[0]):
        out[i] = -1
        for m in order:
            if mask[i, m >> 3] >> (m & 7) & 1:
                out[i] = m
                break
