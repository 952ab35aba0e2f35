"""Cells and boxes: the box of a cell, and which cells a box touches, in either arithmetic."""

from __future__ import annotations

import itertools
from fractions import Fraction
from math import floor, prod

import numpy as np
import rationals
from certificate import Certificate

MOST_TOUCHED = 4096  # cells that a box may touch; a larger one is split
DEPTH = 4  # halvings of a cell, along the axes where that may help, before it is refused
MARGIN = Fraction(1, 2**44)  # of the numbers on an axis: a controller finds the cell of a state in floating point


def margin(c: Certificate, j: int) -> Fraction:
    """How far a state may lie outside the cell that a controller finds for it, along axis j."""
    return MARGIN * (max(abs(c.lo[j]), abs(c.hi[j])) + c.hi[j] - c.lo[j])


def cell_ends(c: Certificate, j: int) -> list[tuple[Fraction, Fraction]]:
    """Exact ends of every cell along axis j."""
    width = (c.hi[j] - c.lo[j]) / c.cells[j]
    return [(c.lo[j] + width * k, c.lo[j] + width * (k + 1)) for k in range(c.cells[j])]


def parts_of(axes: set[int], count: int, depth: int):
    """A cell in 2^depth pieces along some of its axes: each as the place and the number of pieces by axis."""
    pieces = [2**depth if j in axes else 1 for j in range(count)]
    for place in itertools.product(*(range(n) for n in pieces)):
        yield list(zip(place, pieces, strict=True))


def unshown(count: int, axes: set[int], dimensions: int, holds) -> np.ndarray:
    """Places (k,), of `count` cells, at which `holds(places, part)` does not show it of all parts, however small."""
    rest = np.arange(count)
    for depth in range(DEPTH + 1):
        if not len(rest):
            break
        good = np.ones(len(rest), bool)
        for part in parts_of(axes, dimensions, depth):
            good[good] = holds(rest[good], part)
            if not good.any():
                break
        rest = rest[~good]
    return rest


def cell_box(c: Certificate, index, part, arithmetic) -> tuple[list, list]:
    """Box and centre of a part (`parts_of`) of one cell or of arrays of cells, with the margin."""
    box, mid = [], []
    for j, k in enumerate(index):
        width, slack = (c.hi[j] - c.lo[j]) / c.cells[j], margin(c, j)
        ends = []
        place, pieces = part[j]
        for offset, more in ((Fraction(place, pieces), -slack), (Fraction(place + 1, pieces), slack)):
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


def all_below(c: Certificate, first, last, after, below) -> np.ndarray:
    """Whether every cell of boxes of cells wins at a level below `below` (n,) with memory `after` (n,): -> (n,) bool.

    Boxes are lists of (n,) by axis; beyond the grid no cell wins.
    """
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
        level = c.level[flat, after]
        good &= ~counts | (inside & (level >= 0) & (level < below))
    return good
