"""Pairs of a node and an input: where they lead, in rounded intervals or in rational numbers.

The promise of a pair: every cell that the box of successors touches wins with the memory that follows, at a level that
`Certificate.below` says; with a box of the path, the path keeps the clearance; with equations, the bound holds.
"""

from __future__ import annotations

import itertools

import intervals
import numpy as np
import rationals
from boxes import DEPTH, MOST_TOUCHED, all_below, cell_box, parts_of, touched, unshown
from regions import path_is_clear
from successors import Steps, hull


def holds(steps: Steps, nodes: np.ndarray, ms: np.ndarray, part) -> np.ndarray:
    """Whether pairs (node, input) keep their promise from one part of the cells, in rounded intervals: (n,) bool."""
    c, count = steps.c, len(nodes)
    cells, _, classes = c.parts(nodes)
    box, mid = cell_box(c, np.unravel_index(cells, c.cells), part, intervals)
    where, first, last, sound = steps.place(box, mid, classes, ms, intervals), [], [], np.ones(count, bool)
    for j, expressions in enumerate(steps.ends):
        a, b = touched(c, j, *hull(where, expressions), intervals)
        a, b = np.broadcast_to(a, count), np.broadcast_to(b, count)
        near = (a <= b) & (b - a < MOST_TOUCHED) & (np.abs(a) < 2**40)  # False for what is no number
        sound &= near
        first.append(np.where(near, a, 0).astype(np.int64))
        last.append(np.where(near, b, 0).astype(np.int64))
    for e in steps.within:
        sound &= where.range(e)[0] >= 0
    if steps.path:
        sound &= path_is_clear(c, {j: hull(where, e) for j, e in steps.path.items()}, intervals)
    return sound & all_below(c, first, last, c.after(nodes, ms), c.below(nodes))


def holds_exactly(steps: Steps, node: int, m: int, part) -> bool:
    """The same for one pair in rational numbers."""
    c, (cell, _, of_node) = steps.c, steps.c.parts(node)
    box, mid = cell_box(c, c.index(cell), part, rationals)
    where, spans = steps.place(box, mid, of_node, m, rationals), []
    for j, expressions in enumerate(steps.ends):
        a, b = touched(c, j, *hull(where, expressions), rationals)
        if b - a >= MOST_TOUCHED:
            return False
        spans.append(range(a, b + 1))
    if any(where.range(e)[0] < 0 for e in steps.within):
        return False
    if steps.path and not path_is_clear(c, {j: hull(where, e) for j, e in steps.path.items()}, rationals):
        return False
    after, most = int(c.after(np.array(node), m)), int(c.below(np.array(node)))
    for index in itertools.product(*spans):
        wrapped = [k % n if wraps else k for k, n, wraps in zip(index, c.cells, c.periodic, strict=True)]
        if any(not 0 <= k < n for k, n in zip(wrapped, c.cells, strict=True)):
            return False
        if not 0 <= c.level[np.ravel_multi_index(wrapped, c.cells), after] < most:
            return False
    return True


def failing(steps: Steps, nodes: np.ndarray, ms: np.ndarray) -> np.ndarray:
    """Places of the pairs (n,), (n,) that are not verified, also in ever smaller parts: -> (k,)."""
    whole = steps.split, len(steps.c.cells)
    return unshown(len(nodes), *whole, lambda left, part: holds(steps, nodes[left], ms[left], part))


def fails_exactly(steps: Steps, node: int, m: int) -> bool:
    """Whether one pair is not verified in rational numbers, also in parts."""
    for depth in range(DEPTH + 1):
        if all(holds_exactly(steps, node, m, part) for part in parts_of(steps.split, len(steps.c.cells), depth)):
            return False
    return True
