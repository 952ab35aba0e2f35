"""Target, obstacles, walls and regions against cells and paths; along a periodic axis a box stands for all its copies.

Faces that coincide up to rounding count as coinciding: what is allowed to reach into an obstacle, or out of the target,
is `TOUCH` of a cell's width. Everything else is exact or rounded outward. A cell counts as outside a region only where
none of its faces touches it.
"""

from __future__ import annotations

from fractions import Fraction
from functools import reduce
from math import ceil, floor
from typing import Any

import intervals
import numpy as np
import rationals
from boxes import cell_box, cell_ends, margin, unshown
from certificate import Certificate
from expressions import Place

CHUNK = 200_000  # cells at a time
TOUCH = Fraction(1, 2**28)
Interval = tuple[Fraction, Fraction]


def tolerance(c: Certificate, j: int) -> Fraction:
    return TOUCH * (c.hi[j] - c.lo[j]) / c.cells[j]


def copies(c: Certificate, j: int, ends: Interval) -> list[Interval]:
    """The copies of an interval that may meet anything within one period of the grid; itself where an axis ends.

    Those of an interval that is a period long are all of the axis.
    """
    if not c.periodic[j]:
        return [ends]
    period = c.hi[j] - c.lo[j]
    if ends[1] - ends[0] >= period:
        return [(c.lo[j] - 2 * period, c.hi[j] + 2 * period)]
    first, last = floor((c.lo[j] - ends[1]) / period) - 1, ceil((c.hi[j] - ends[0]) / period) + 1
    return [(ends[0] + n * period, ends[1] + n * period) for n in range(first, last + 1)]


def along(c: Certificate, flags: dict[int, np.ndarray]) -> np.ndarray:
    """Cells that satisfy flags (cells along the axis,) of every named axis: -> (cells,)."""
    each = [flags.get(j, np.ones(n, bool)) for j, n in enumerate(c.cells)]
    return reduce(np.logical_and.outer, each).reshape(-1)


def cells_in(c: Certificate, box: dict[int, Interval]) -> np.ndarray:
    """Cells inside a box, (cells,) bool."""
    flags = {}
    for j, ends in box.items():
        tol = tolerance(c, j)
        every = copies(c, j, ends)
        flags[j] = np.array([any(a + tol >= lo and b - tol <= hi for lo, hi in every) for a, b in cell_ends(c, j)])
    return along(c, flags)


def cells_meeting(c: Certificate, box: dict[int, Interval], keep: list[Fraction]) -> np.ndarray:
    """Cells nearer than `keep` to a box, (cells,) bool."""
    flags = {}
    for j, ends in box.items():
        tol, every = tolerance(c, j), copies(c, j, (ends[0] - keep[j], ends[1] + keep[j]))
        flags[j] = np.array([any(b - tol > lo and a + tol < hi for lo, hi in every) for a, b in cell_ends(c, j)])
    return along(c, flags)


def cells_touching(c: Certificate, box: dict[int, Interval]) -> np.ndarray:
    """Cells of which a state may lie in a box, its faces included, (cells,) bool."""
    flags = {}
    for j, ends in box.items():
        slack, every = margin(c, j), copies(c, j, ends)
        flags[j] = np.array([any(b + slack >= lo and a - slack <= hi for lo, hi in every) for a, b in cell_ends(c, j)])
    return along(c, flags)


def forbidden(c: Certificate) -> np.ndarray:
    """Cells that are nearer to an obstacle or a wall than samples may be, (cells,) bool."""
    keep, walls = c.reach.keep, c.reach.keep_from_walls
    inner = {j: (c.lo[j] + walls[j], c.hi[j] - walls[j]) for j in range(len(c.cells)) if not c.periodic[j]}
    bad = ~cells_in(c, inner)
    for box in c.reach.obstacles:
        bad |= cells_meeting(c, box, keep)
    return bad


def path_is_clear(c: Certificate, path: dict[int, tuple], arithmetic):
    """Whether paths within boxes, by the axes x and y, keep the clearance: ends (n,) or rational -> (n,) bool or bool.

    An obstacle that also bounds the heading counts as one for every heading: what a path turns through is not known.
    """
    reach, good, n = c.reach, True, lambda value, end: arithmetic.number(value)[end]
    for j, (a, b) in path.items():
        tol, width = tolerance(c, j), c.hi[j] - c.lo[j]
        lo, hi = c.lo[j] + reach.clearance[j] - tol, c.hi[j] - reach.clearance[j] + tol
        if c.periodic[j]:
            lo, hi = c.lo[j] - width, c.hi[j] + width  # beyond it copies are not looked for
        good &= (a >= n(lo, 1)) & (b <= n(hi, 0))
    for box in reach.obstacles:
        meets = True
        for j, (a, b) in path.items():
            if j not in box:
                continue
            near = False
            for lo, hi in copies(c, j, (box[j][0] - reach.clearance[j], box[j][1] + reach.clearance[j])):
                tol = tolerance(c, j)
                near |= (b > n(lo + tol, 0)) & (a < n(hi - tol, 1))
            meets &= near
        good &= ~meets if arithmetic is not rationals else not meets
    return good


def false_letters(c: Certificate) -> tuple[np.ndarray, str, bool]:
    """Cells, (cells,) bool, whose letter is not shown to be true of all of them, with the region and the side."""
    task, none = c.task, np.zeros(c.size, bool)
    for name, inside in sorted({literal for letter in task.automaton.letters for literal in letter}):
        has = np.array([(name, inside) in letter for letter in task.automaton.letters])
        said = has[task.letter]
        shown = [_shown(c, part, inside, np.flatnonzero(said)) for part in task.regions[name]]
        bad = said & ~(np.any(shown, axis=0) if inside else np.all(shown, axis=0))
        if bad.any():
            return bad, name, inside
    return none, "", False


def _shown(c: Certificate, part: Any, inside: bool, cells: np.ndarray) -> np.ndarray:
    """Which of these cells lie in a part of a region, or clear of it: (cells of the grid,) bool."""
    if isinstance(part, dict):
        return cells_in(c, part) if inside else ~cells_touching(c, part)
    found = np.zeros(c.size, bool)
    for a in range(0, len(cells), CHUNK):
        own = cells[a : a + CHUNK]

        def holds(places, piece, own=own):
            box, mid = cell_box(c, np.unravel_index(own[places], c.cells), piece, intervals)
            lo, hi = Place(intervals, {s: j for j, s in enumerate(c.states)}, box, mid, {}).range(part)
            return np.broadcast_to(hi <= 0 if inside else lo > 0, len(places))

        found[own] = True
        found[own[unshown(len(own), {*range(len(c.cells))}, len(c.cells), holds)]] = False
    return found
