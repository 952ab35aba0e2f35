"""Check a certificate that simgap exported, without simgap: `python checker/check.py FOLDER`.

For every admissible pair of a cell and an input it computes the box of successors from the stated nominal map and the
stated bound of the gap, and verifies that every cell that this box touches wins. What else is verified stands in
`verify`. Exit status: 0 accepted, 1 rejected, 2 unreadable.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from pathlib import Path

import intervals
import numpy as np
import rationals
from boxes import MOST_TOUCHED, all_win, cell_box, cell_ends, touched
from certificate import Certificate, read
from expressions import Malformed, Place, exact

CHUNK = 50_000  # pairs at a time
DEPTH = 4  # halvings of a cell along every axis before its pair is refused


class Rejected(Exception):
    """What does not hold, with the cell."""


def rows(c: Certificate) -> list[tuple]:
    """Successor of each state as two expressions, lower and upper: the nominal map plus the gap."""
    found = []
    for s in c.states:
        gap = c.header["gap"][s]
        found.append((["+", c.header["nominal"][s], gap["lower"]], ["+", c.header["nominal"][s], gap["upper"]]))
    return found


def bound_rows(c: Certificate) -> list[tuple]:
    """For a simulator in closed form: (gap - lower, upper - gap) of each state, none of which may be negative."""
    known = c.header["simulator"]
    if not known:
        return []
    found = []
    for s in c.states:
        gap = c.header["gap"][s]
        d = ["+", known[s], ["*", -1, c.header["nominal"][s]]]
        found.append((["+", d, ["*", -1, gap["lower"]]], ["+", gap["upper"], ["*", -1, d]]))
    return found


def place(c: Certificate, box, mid, m: int, arithmetic) -> Place:
    names = {s: j for j, s in enumerate(c.states)}
    return Place(arithmetic, names, box, mid, dict(zip(c.input_names, c.inputs[m], strict=True)))


def holds(c: Certificate, cells: np.ndarray, m: int, part, parts: int) -> np.ndarray:
    """Whether pairs (cell, m) keep their promise from one part of the cells, in rounded intervals: (n,) bool."""
    index = np.unravel_index(cells, c.cells)
    box, mid = cell_box(c, index, part, parts, intervals)
    where, first, last, sound = place(c, box, mid, m, intervals), [], [], np.ones(len(cells), bool)
    for j, (lower, upper) in enumerate(rows(c)):
        a, b = touched(c, j, where.range(lower)[0], where.range(upper)[1], intervals)
        a, b = np.broadcast_to(a, len(cells)), np.broadcast_to(b, len(cells))
        near = (a <= b) & (b - a < MOST_TOUCHED) & (np.abs(a) < 2**40)  # False for what is no number
        sound &= near
        first.append(np.where(near, a, 0).astype(np.int64))
        last.append(np.where(near, b, 0).astype(np.int64))
    for below, above in bound_rows(c):
        sound &= (where.range(below)[0] >= 0) & (where.range(above)[0] >= 0)
    return sound & all_win(c, first, last)


def holds_exactly(c: Certificate, cell: int, m: int, part, parts: int) -> bool:
    """The same for one pair in rational numbers."""
    box, mid = cell_box(c, c.index(cell), part, parts, rationals)
    where, spans = place(c, box, mid, m, rationals), []
    for j, (lower, upper) in enumerate(rows(c)):
        a, b = touched(c, j, where.range(lower)[0], where.range(upper)[1], rationals)
        if b - a >= MOST_TOUCHED:
            return False
        spans.append(range(a, b + 1))
    if any(where.range(e)[0] < 0 for pair in bound_rows(c) for e in pair):
        return False
    for index in itertools.product(*spans):
        wrapped = [k % n if wraps else k for k, n, wraps in zip(index, c.cells, c.periodic, strict=True)]
        if any(not 0 <= k < n for k, n in zip(wrapped, c.cells, strict=True)):
            return False
        if not c.winning[np.ravel_multi_index(wrapped, c.cells)]:
            return False
    return True


def failing(c: Certificate, cells: np.ndarray, m: int) -> np.ndarray:
    """Those of the cells whose pair with input m is not verified, also in ever smaller parts: (n,) -> (k,)."""
    rest = cells[~holds(c, cells, m, (0,) * len(c.cells), 1)]
    for depth in range(1, DEPTH + 1):
        if not len(rest):
            break
        parts, good = 2**depth, np.ones(len(rest), bool)
        for part in itertools.product(range(parts), repeat=len(c.cells)):
            good[good] = holds(c, rest[good], m, part, parts)
            if not good.any():
                break
        rest = rest[~good]
    return rest


def fails_exactly(c: Certificate, cell: int, m: int) -> bool:
    """Whether one pair is not verified in rational numbers, also in parts."""
    for depth in range(DEPTH + 1):
        parts = itertools.product(range(2**depth), repeat=len(c.cells))
        if all(holds_exactly(c, cell, m, part, 2**depth) for part in parts):
            return False
    return True


def check_sets(c: Certificate) -> None:
    """Every promised cell has an input and is safe, no other cell has one; the bound holds on the whole grid.

    Raises:
        Rejected: naming the first cell that is not.
    """
    some = c.admissible.any(axis=1)
    spare = 8 * c.admissible.shape[1] - len(c.inputs)
    _refuse(c, (c.admissible[:, -1] >> (8 - spare)) > 0 if spare else np.zeros(c.size, bool), "admits no such input")
    _refuse(c, c.winning & ~some, "is promised and has no input")
    _refuse(c, ~c.winning & some, "has an input and no promise")
    for j, s in enumerate(c.states):
        a, b = (exact(v) for v in c.header["domain"][s])
        if not c.periodic[j] and not (a <= c.lo[j] and c.hi[j] <= b):
            raise Rejected(f"the grid leaves the domain of the bound along {s}")
        if c.periodic[j] and (a, b) != (c.lo[j], c.hi[j]):
            raise Rejected(f"the grid is periodic along {s} and not all of it")
        a, b = (exact(v) for v in c.header["safe"][s])
        outside = np.array([not (a <= lo and hi <= b) for lo, hi in cell_ends(c, j)])
        _refuse(c, c.winning & _along(c, j, outside), f"is not safe along {s}")


def _along(c: Certificate, j: int, flags: np.ndarray) -> np.ndarray:
    shape = [1] * len(c.cells)
    shape[j] = c.cells[j]
    return np.broadcast_to(flags.reshape(shape), c.cells).reshape(-1)


def _refuse(c: Certificate, wrong: np.ndarray, words: str) -> None:
    if wrong.any():
        raise Rejected(f"cell {c.index(int(np.argmax(wrong)))} {words}")


def verify(c: Certificate, sample: int | None, exactly: int, say=print) -> None:
    """All checks; `sample` pairs of each input (None: all), `exactly` pairs in rational numbers.

    Raises:
        Rejected: naming the first cell whose promise is not verified.
    """
    check_sets(c)
    say(f"sets: {int(c.winning.sum()):,} of {c.size:,} cells are promised, each with an input")
    pairs = 0
    for m in range(len(c.inputs)):
        cells = np.flatnonzero(c.admits(m))
        if sample is not None and len(cells) > sample:
            cells = cells[:: -(-len(cells) // sample)]
        for a in range(0, len(cells), CHUNK):
            bad = failing(c, cells[a : a + CHUNK], m)
            if len(bad):
                raise Rejected(_unverified(c, int(bad[0]), m))
        pairs += len(cells)
    say(f"intervals: {pairs:,} pairs of cell and input verified" + (" (every k-th of each input)" if sample else ""))
    chosen = _pairs(c, exactly)
    for cell, m in chosen:
        if fails_exactly(c, cell, m):
            raise Rejected(_unverified(c, cell, m) + " (in rational numbers)")
    say(f"rational numbers: {len(chosen):,} pairs verified exactly")


def _unverified(c: Certificate, cell: int, m: int) -> str:
    u = ", ".join(f"{name} = {float(v):g}" for name, v in zip(c.input_names, c.inputs[m], strict=True))
    also = " within the stated bound" if c.header["simulator"] else ""
    return f"cell {c.index(cell)} with input {m} ({u}): its successors are not shown to lie in winning cells{also}"


def _pairs(c: Certificate, count: int) -> list[tuple[int, int]]:
    """About `count` pairs, evenly spread over inputs and cells."""
    each, found = -(-count // len(c.inputs)), []
    for m in range(len(c.inputs) if count else 0):
        cells = np.flatnonzero(c.admits(m))
        found += [(int(k), m) for k in cells[:: max(1, -(-len(cells) // each))]]
    return found


def main(arguments: list[str] | None = None) -> int:
    """Read, verify, say so."""
    parser = argparse.ArgumentParser(description="Check a certificate of simgap.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sample", type=int, default=None, help="pairs of each input in intervals (all if not given)")
    parser.add_argument("--exact", type=int, default=500, help="pairs in rational numbers")
    given = parser.parse_args(arguments)
    if (given.sample is not None and given.sample < 1) or given.exact < 0:
        print("--sample is at least 1 and --exact at least 0")
        return 2
    began = time.process_time()
    try:
        with np.errstate(all="ignore"):
            c = read(given.folder)
            verify(c, given.sample, given.exact)
    except Rejected as reason:
        print(f"REJECTED: {reason}")
        return 1
    except Malformed as reason:
        print(f"UNREADABLE: {reason}")
        return 2
    except (ArithmeticError, RecursionError, MemoryError) as reason:
        print(f"UNREADABLE: its numbers or expressions are too large for this program: {type(reason).__name__}")
        return 2
    bound = "and the bound of the gap, against the simulator's equations" if c.header["simulator"] else ""
    print(f"ACCEPTED {bound}".strip())
    for text in c.header["not_covered"]:
        print(f"not covered: {text}")
    print(f"{time.process_time() - began:.0f} s of CPU")
    return 0


if __name__ == "__main__":
    sys.exit(main())
