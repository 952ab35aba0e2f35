"""Cells and boxes: the box of a cell, and which cells a box touches, in either arithmetic."""

from __future__ import annotations

import itertools
from fractions import Fraction
from math import floor, prod

import numpy as np
import rationals
from certificate import Certificate

MOST_TOUCHED = 4096  # cells that a box may touch; a larger one is split
MARGIN = Fraction(1, 2**44)  # of the numbers on an axis: a controller finds the cell of a state in floating point


def margin(c: Certificate, j: int) -> Fraction:
    """How far a state may lie outside the cell that a controller finds for it, along axis j."""
    return MARGIN * (max(abs(c.lo[j]), abs(c.hi[j])) + c.hi[j] - c.lo[j])


def cell_ends(c: Certificate, j: int) -> list[tuple[Fraction, Fraction]]:
    """Exact ends of every cell along axis j."""
    width = (c.hi[j] - c.lo[j]) / c.cells[j]
    return [(c.lo[j] + width * k, c.lo[j] + width * (k + 1)) for k in range(c.cells[j])]


def cell_box(c: Certificate, index, part, parts: int, arithmetic) -> tuple[list, list]:
    """Box and centre of part (k_1, ...) of `parts` along each axis of one cell or arrays of cells, with the margin."""
    box, mid = [], []
    for j, k in enumerate(index):
        width, slack = (c.hi[j] - c.lo[j]) / c.cells[j], margin(c, j)
        ends = []
        for offset, more in ((Fraction(part[j], parts), -slack), (Fraction(part[j] + 1, parts), slack)):
            at = arithmetic.add(_whole(k, arithmetic), arithmetic.number(offset))
            moved = arithmetic.mul(at, arithmetic.number(width))
            ends.append(arithmetic.add(moved, arithmetic.number(c.lo[j] + more)))
        box.append((ends[0][0], ends[1][1]))
        middle = (ends[0][0] + ends[1][1]) / 2
        mid.append((middle, middle))
    return box, mid


def _whole(k, arithmetic):
    return (Fraction(int(k)),) * 2 if arithmetic is rationals else (k.astype(np.float64),) * 2


def touched(c: Certificate, j: int, lo, hi, arithmetic):
    """First and last index along axis j that [lo, hi] touches, borders included."""
    per_cell = Fraction(c.cells[j]) / (c.hi[j] - c.lo[j])
    slack, n = margin(c, j), arithmetic.number
    q = arithmetic.mul(arithmetic.add((lo, hi), n(-c.lo[j])), n(per_cell))
    q = arithmetic.add(q, (n(-slack * per_cell)[0], n(slack * per_cell)[1]))
    if arithmetic is rationals:
        return floor(q[0]), floor(q[1])
    return np.floor(q[0]), np.floor(q[1])


def all_win(c: Certificate, first, last) -> np.ndarray:
    """Whether every cell of boxes of cells wins: lists of (n,) by axis -> (n,) bool; beyond the grid none does."""
    count = len(first[0])
    spans = [int((b - a).max(initial=0)) + 1 for a, b in zip(first, last, strict=True)]
    good = np.ones(count, bool)
    if prod(spans) > MOST_TOUCHED:
        return np.zeros(count, bool)
    for offset in itertools.product(*(range(s) for s in spans)):
        flat, inside, counts = np.zeros(count, dtype=np.int64), np.ones(count, bool), np.ones(count, bool)
        for j, (a, b) in enumerate(zip(first, last, strict=True)):
            k = a + offset[j]
            counts &= k <= b
            if c.periodic[j]:
                k = k % c.cells[j]
            inside &= (k >= 0) & (k < c.cells[j])
            flat = flat * c.cells[j] + np.where((k >= 0) & (k < c.cells[j]), k, 0)
        good &= ~counts | (inside & c.winning[flat])
    return good
