"""What a certificate says about whole sets of cells, on all of them."""

from __future__ import annotations

import numpy as np
from boxes import cell_ends
from certificate import Certificate
from expressions import exact
from formula import implies
from regions import along, cells_in, false_letters, forbidden
from repeats import unrepeated

CHUNK = 2**20  # nodes at a time


class Rejected(Exception):
    """What does not hold, with the cell."""


def check_sets(c: Certificate) -> None:
    """Every promised cell has an input and is where it should be, no other node has one; the bound holds everywhere,
    and what is said to wrap around repeats itself.

    Raises:
        Rejected: naming the first cell that is not.
    """
    if c.task is not None:
        _check_task(c)
    level, spare = c.level.reshape(-1), 8 * c.admissible.shape[1] - len(c.inputs)
    ended = "is in the target" if c.task is None else "has done the task"
    for a in range(0, c.level.size, CHUNK):
        own, rows = level[a : a + CHUNK], np.asarray(c.admissible[a : a + CHUNK])
        some, wins = rows.any(axis=1), own >= 0
        ends = wins & c.ended(np.arange(a, a + len(own)))
        unknown = (rows[:, -1] >> (8 - spare)) > 0 if spare else np.zeros(len(own), bool)
        refuse(c, unknown, "admits no such input", a)
        refuse(c, wins & ~ends & ~some, "is promised and has no input", a)
        refuse(c, ~wins & some, "has an input and no promise", a)
        refuse(c, ends & some, f"{ended} and has an input", a)
    for j, s in enumerate(c.states):
        a, b = (exact(v) for v in c.header["domain"][s])
        if not c.periodic[j] and not (a <= c.lo[j] and c.hi[j] <= b):
            raise Rejected(f"the grid leaves the domain of the bound along {s}")
        if c.periodic[j] and (a, b) != (c.lo[j], c.hi[j]):
            raise Rejected(f"the grid is periodic along {s} and not all of it")
    found = unrepeated(c)
    if found is not None:
        raise Rejected(found)
    if c.reach is None:
        _check_safe(c)
    else:
        _check_reach(c)


def _check_task(c: Certificate) -> None:
    """The automaton against the formula, letters against regions, and nodes against what was read before them."""
    if not implies(c.task.automaton, c.task.formula):
        raise Rejected("the automaton accepts runs that break the formula")
    bad, region, inside = false_letters(c)
    refuse(c, bad, f"counts as {'in' if inside else 'outside'} '{region}' and is not shown to be")
    for a in range(0, c.level.size, CHUNK):
        nodes = np.arange(a, min(a + CHUNK, c.level.size))
        own, (state, good) = c.level.reshape(-1)[nodes], c.moves(nodes)
        refuse(c, (own >= 0) & (state < 0), "is promised and the task is broken there", a)
        if not c.task.automaton.persists:
            refuse(c, (own == 0) & ~good & ~c.ended(nodes), "is at level 0 and its move is not good", a)


def _check_safe(c: Certificate) -> None:
    for j, s in enumerate(c.states):
        a, b = (exact(v) for v in c.header["safe"][s])
        outside = np.array([not (a <= lo and hi <= b) for lo, hi in cell_ends(c, j)])
        refuse(c, c.winning & along(c, {j: outside}), f"is not safe along {s}")


def _check_reach(c: Certificate) -> None:
    """Target, obstacles and walls against every cell that wins with some memory; a start is at rest, in state 0."""
    wins = (c.level >= 0).any(axis=1)
    if c.reach.target is not None:
        ended = c.level == 0
        refuse(c, ended.any(axis=1) & ~ended.all(axis=1), "is the target after some inputs only")
        refuse(c, ended.any(axis=1) & ~cells_in(c, c.reach.target), "is at level 0 and not in the target")
    refuse(c, wins & forbidden(c), "is too near to an obstacle or a wall")
    refuse(c, c.winning != (c.level[:, c.reach.at_rest] >= 0), "is promised without a level at rest, or the reverse")
    if c.reach.swept is not None and not ((c.reach.swept[0] <= 0) & (c.reach.swept[1] >= 0)).all():
        raise Rejected("the box of a path does not hold where the path begins")


def refuse(c: Certificate, bad: np.ndarray, why: str, first: int | None = None) -> None:
    """Name the first bad cell (cells,), or the first bad node of those from `first` on.

    Raises:
        Rejected: if there is one.
    """
    found = np.flatnonzero(bad)
    if len(found):
        place = int(found[0])
        raise Rejected(f"{f'cell {c.index(place)}' if first is None else node_name(c, first + place)} {why}")


def node_name(c: Certificate, node: int) -> str:
    """How a node is named."""
    cell, state, number = c.parts(node)
    of_task = f" in state {state} of the task" if c.task is not None else ""
    return f"cell {c.index(cell)}{of_task}" + (f" after an input of class {number}" if c.classes > 1 else "")
