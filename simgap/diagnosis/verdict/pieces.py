"""How many independent pieces transitions are: blocks longer than what is left remembers, or whole runs.

Transitions of one recording follow one another, and what a model lacks there lasts: a hundred residuals that correlate
by 0.98 are one or two pieces and not a hundred. Blocks are as long as the integrated autocorrelation time, by the
initial positive sequence (Geyer 1992), and at least by the first autocorrelation, freed of the bias that a short record
has (Kendall 1954). Where runs differ by more than their blocks do, a run is one piece.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.thresholds import RUNS_DIFFER
from simgap.late import scipy


@dataclass(frozen=True, eq=False)
class Left:
    """What transitions leave: signed residuals (n, k), each column in a unit of its own size; the run (n,) and the
    number of the step since its begin (n,) at which each stands; held_out: (n,) which were never fitted."""

    residual: Floats
    run: Ints
    step: Ints
    held_out: Bools


def pieces(left: Left) -> tuple[Ints, bool]:
    """The piece (n,) that each transition belongs to, and whether that is its run, because runs differ."""
    score = np.abs(left.residual).max(axis=1)
    length = max(memory(x, left.run, left.step) for x in (*left.residual.T, score))
    block = _blocks(left, length)
    return (left.run, True) if _differ(score, left.run, block) else (block, False)


def memory(x: Floats, run: Ints, step: Ints) -> float:
    """Integrated autocorrelation time of x (n,) in steps, over all runs; 1 for noise that forgets at once."""
    longest = int(step.max()) + 1
    size = 1 << (2 * longest - 1).bit_length()
    products, counts = np.zeros(longest), np.zeros(longest)
    for own in np.unique(run):
        here = run == own
        series, there = np.zeros((2, longest))
        series[step[here]], there[step[here]] = x[here] - x[here].mean(), 1.0
        for total, values in ((products, series), (counts, there)):
            spectrum = np.fft.rfft(values, size)
            total += np.fft.irfft(spectrum * spectrum.conj(), size)[:longest]
    seen = np.rint(counts) > 0
    last = len(seen) if seen.all() else int(np.argmin(seen))
    if products[0] <= 0.0 or last < 2:
        return 1.0
    correlation = products[:last] / products[0] * (counts[0] / counts[:last]) * (1.0 - np.arange(last) / last)
    pairs = correlation[0 : last - 1 : 2] + correlation[1:last:2]
    positive = len(pairs) if (pairs > 0.0).all() else int(np.argmin(pairs > 0.0))
    first = correlation[1] / (1.0 - 1.0 / last)
    first = min(first + (1.0 + 4.0 * first) / (counts[0] / len(np.unique(run))), 1.0 - 1.0 / counts[0])
    return float(max(1.0, 2.0 * pairs[:positive].sum() - 1.0, (1.0 + first) / (1.0 - first)))


def _blocks(left: Left, length: float) -> Ints:
    """Stretches of each run that are at least `length` steps long, or that many steps from the next."""
    block, count = np.zeros(len(left.run), dtype=np.int64), 0
    for run in np.unique(left.run):
        for held_out in (False, True):
            own = np.flatnonzero((left.run == run) & (left.held_out == held_out))
            own = own[np.argsort(left.step[own], kind="stable")]
            for part in np.split(own, np.flatnonzero(np.diff(left.step[own]) >= length) + 1) if len(own) else ():
                n = max(1, int(len(part) // length))
                block[part] = count + np.arange(len(part)) * n // len(part)
                count += n
    return block


def _differ(score: Floats, run: Ints, block: Ints) -> bool:
    """Whether the sizes of runs differ by more than those of their blocks: analysis of variance of their logarithms."""
    _, first, own = np.unique(block, return_index=True, return_inverse=True)
    sizes = np.log(np.maximum(np.bincount(own, score) / np.bincount(own), 1e-300))
    _, of = np.unique(run[first], return_inverse=True)
    runs, blocks = of.max() + 1, len(sizes)
    if runs == 1 or blocks == runs:
        return False
    means = np.bincount(of, sizes) / np.bincount(of)
    within = float(np.sum((sizes - means[of]) ** 2)) / (blocks - runs)
    between = float(np.sum((means[of] - sizes.mean()) ** 2)) / (runs - 1)  # a block, one term
    return within == 0.0 or bool(scipy.special.fdtrc(runs - 1, blocks - runs, between / within) < RUNS_DIFFER)
