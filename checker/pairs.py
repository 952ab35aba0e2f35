"""Pairs of a node and an input: where they lead, in rounded intervals or in rational numbers.

The promise of a pair: every cell that the box of successors touches wins, towards a target at a lower level and in the
class of the input; with a box of the path, the path keeps the clearance; with equations, the bound holds.
"""

from __future__ import annotations

import itertools

import intervals
import numpy as np
import rationals
from boxes import MOST_TOUCHED, all_below, cell_box, parts_of, touched
from certificate import Certificate
from regions import path_is_clear
from successors import Steps, hull

DEPTH = 4  # halvings of a cell, along the axes where that may help, before its pair is refused


def below(c: Certificate, nodes):
    """Successors win at a level less than this: that of the node, or any level of an invariance."""
    return c.level.reshape(-1)[nodes] if c.reach is not None else np.ones_like(nodes)


def holds(steps: Steps, nodes: np.ndarray, ms: np.ndarray, part) -> np.ndarray:
    """Whether pairs (node, input) keep their promise from one part of the cells, in rounded intervals: (n,) bool."""
    c, count = steps.c, len(nodes)
    cells, classes = np.divmod(nodes, c.classes)
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
    return sound & all_below(c, first, last, c.of_input[ms], below(c, nodes))


def holds_exactly(steps: Steps, node: int, m: int, part) -> bool:
    """The same for one pair in rational numbers."""
    c, (cell, of_node) = steps.c, divmod(node, steps.c.classes)
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
    most = int(below(c, np.array(node)))
    for index in itertools.product(*spans):
        wrapped = [k % n if wraps else k for k, n, wraps in zip(index, c.cells, c.periodic, strict=True)]
        if any(not 0 <= k < n for k, n in zip(wrapped, c.cells, strict=True)):
            return False
        if not 0 <= c.level[np.ravel_multi_index(wrapped, c.cells), c.of_input[m]] < most:
            return False
    return True


def failing(steps: Steps, nodes: np.ndarray, ms: np.ndarray) -> np.ndarray:
    """Places of the pairs (n,), (n,) that are not verified, also in ever smaller parts: -> (k,)."""
    rest = np.arange(len(nodes))
    for depth in range(DEPTH + 1):
        if not len(rest):
            break
        good = np.ones(len(rest), bool)
        for part in parts_of(steps.split, len(steps.c.cells), depth):
            left = rest[good]
            good[good] = holds(steps, nodes[left], ms[left], part)
            if not good.any():
                break
        rest = rest[~good]
    return rest


def fails_exactly(steps: Steps, node: int, m: int) -> bool:
    """Whether one pair is not verified in rational numbers, also in parts."""
    for depth in range(DEPTH + 1):
        if all(holds_exactly(steps, node, m, part) for part in parts_of(steps.split, len(steps.c.cells), depth)):
            return False
    return True
