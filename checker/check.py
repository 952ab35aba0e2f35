"""Check a certificate that simgap exported, without simgap: `python checker/check.py FOLDER`.

For every admissible pair of a cell and an input it computes the box of successors from the stated nominal map and the
stated bound of the gap, and verifies that every cell that this box touches wins; towards a target at a lower level, in
the class of that input, and without touching anything on the way; for a task nearer to its next good move, in the state
that follows. What is verified of whole sets stands in `sets`, of a formula in `formula`.
Exit status: 0 accepted, 1 rejected, 2 unreadable.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from certificate import Certificate, read
from expressions import Malformed
from pairs import failing, fails_exactly
from repeats import on_trust
from sets import Rejected, check_sets, node_name
from successors import Steps

CHUNK = 50_000  # pairs at a time
NODES = 500  # of which all pairs are looked up at a time


def verify(c: Certificate, sample: int | None, exactly: int, seed: int = 0, say=print) -> None:
    """All checks.

    Args:
        c: the certificate.
        sample: of an invariance pairs of each input, towards a target cells, each with all its classes and inputs;
            None: all. seed: of that draw.
        exactly: pairs in rational numbers.
        say: where a line of words goes.

    Raises:
        Rejected: naming the first cell whose promise is not verified.
    """
    check_sets(c)
    ends = "done" if c.task is not None else "in the target"
    promised = "each with an input" if c.reach is None else f"each with an input or {ends}, and clear"
    say(f"sets: {int(c.winning.sum()):,} of {c.size:,} cells are promised, {promised}")
    if c.task is not None:
        count = len(c.task.automaton.step)
        say(f"task: '{c.task.text}' holds of every run that the automaton accepts ({count:,} states)")
    steps = Steps(c)
    if c.reach is None:
        _by_input(steps, sample, say)
        chosen = _pairs(c, exactly)
    else:
        chosen = _by_node(steps, sample, exactly, seed, say)
    for node, m in chosen:
        if fails_exactly(steps, node, m):
            raise Rejected(_unverified(c, node, m) + " (in rational numbers)")
    say(f"rational numbers: {len(chosen):,} pairs verified exactly")


def _by_input(steps: Steps, sample: int | None, say) -> None:
    """Pairs of an invariance, one input after the other."""
    c, pairs = steps.c, 0
    for m in range(len(c.inputs)):
        cells = np.flatnonzero(c.admits(m))
        if sample is not None and len(cells) > sample:
            cells = cells[:: -(-len(cells) // sample)]
        _all_hold(steps, cells, np.full(len(cells), m))
        pairs += len(cells)
    say(f"intervals: {pairs:,} pairs of cell and input verified" + (" (every k-th of each input)" if sample else ""))


def _by_node(steps: Steps, sample: int | None, exactly: int, seed: int, say) -> list[tuple[int, int]]:
    """Pairs of cells on their way to a target, cell after cell: -> about `exactly` of them."""
    c, rng, kept, pairs = steps.c, np.random.default_rng(seed), [], 0
    cells = np.flatnonzero((c.level >= (1 if c.task is None else 0)).any(axis=1))
    drawn = sample is not None and len(cells) > sample
    total = len(cells)
    if drawn:
        cells = np.sort(rng.choice(cells, sample, replace=False))
    nodes = (cells[:, None] * c.memories + np.arange(c.memories)).reshape(-1)
    nodes = nodes[(c.level.reshape(-1)[nodes] >= 0) & ~c.ended(nodes)]
    share = max(1, len(nodes) // exactly) if exactly else 0
    for a in range(0, len(nodes), NODES):
        own = nodes[a : a + NODES]
        bits = np.unpackbits(c.admissible[own], axis=1, count=len(c.inputs), bitorder="little").astype(bool)
        row, m = np.nonzero(bits)
        _all_hold(steps, own[row], m)
        pairs += len(row)
        if share:
            kept += [
                (int(own[i]), int(rng.choice(np.flatnonzero(bits[i])))) for i in range(-a % share, len(own), share)
            ]
    which = f"all inputs of {len(cells):,} of {total:,} cells, drawn with seed {seed}" if drawn else f"{total:,} cells"
    say(f"intervals: {pairs:,} pairs of node and input verified ({which}; {len(nodes):,} nodes)")
    return kept[:exactly]


def _all_hold(steps: Steps, nodes: np.ndarray, ms: np.ndarray) -> None:
    for a in range(0, len(nodes), CHUNK):
        some, inputs = nodes[a : a + CHUNK], ms[a : a + CHUNK]
        bad = failing(steps, some, inputs)
        if len(bad):
            raise Rejected(_unverified(steps.c, int(some[bad[0]]), int(inputs[bad[0]])))


def _unverified(c: Certificate, node: int, m: int) -> str:
    u = ", ".join(f"{name} = {float(v):g}" for name, v in zip(c.input_names, c.inputs[m], strict=True))
    also = " within the stated bound" if c.header["simulator"] else ""
    where = "winning cells" if c.reach is None else "winning cells of lower levels, its path not clear of everything"
    return f"{node_name(c, node)} with input {m} ({u}): its successors are not shown to lie in {where}{also}"


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
    parser.add_argument(
        "--sample", type=int, default=None,
        help="pairs of each input of an invariance, cells of a reach-while-avoid; all if not given",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of the cells that are drawn")
    parser.add_argument("--exact", type=int, default=500, help="pairs in rational numbers")
    given = parser.parse_args(arguments)
    if (given.sample is not None and given.sample < 1) or given.exact < 0 or given.seed < 0:
        print("--sample is at least 1, --exact and --seed at least 0")
        return 2
    began = time.process_time()
    try:
        with np.errstate(all="ignore"):
            c = read(given.folder)
            verify(c, given.sample, given.exact, given.seed)
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
    for text in on_trust(c):
        print(f"not covered: {text}")
    print(f"{time.process_time() - began:.0f} s of CPU")
    return 0


if __name__ == "__main__":
    sys.exit(main())
