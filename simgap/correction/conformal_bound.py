"""How far residuals reach: one bound for all transitions, or one near rest and one in motion.

Where dry friction sticks, what is left is larger, and the rest of X need not pay for it. Mondrian conformal prediction
(Vovk, Gammerman and Shafer 2005, sec. 4.5): transitions that begin slowly and those that do not are two classes, each
with a bound of its own. Which velocity tells them apart, and below which size, is chosen on the transitions that were
fitted, so that the held-out ones set the bounds alone.

Transitions of one recording follow one another, and what a model lacks there lasts: a hundred residuals that correlate
by 0.98 are one or two pieces and not a hundred. What counts are independent pieces: blocks as long as the integrated
autocorrelation time, by the initial positive sequence (Geyer 1992), and at least by the first autocorrelation, freed of
the bias that a short record has (Kendall 1954). Where runs differ by more than their blocks do, a run is one piece.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.thresholds import MATTERS, RUNS_DIFFER
from simgap.late import scipy
from simgap.statistics import attained, fewest, reach

_SHARES = np.arange(0.05, 0.65, 0.05)
"""Of the fitted transitions, the shares that may be slow."""
_OUTWARD = 1.0 + 4.0 * np.finfo(np.float64).eps  # a score is a quotient: its residual is not left outside


@dataclass(frozen=True)
class NearRest:
    """Where |velocity| <= below: state -> bound of what is left; own: whether held-out slow transitions set it."""

    velocity: str
    below: float
    by: Mapping[str, float]
    own: bool


@dataclass(frozen=True, eq=False)
class Sizes:
    """Transitions: sizes of their residuals (n, k), for each velocity of a coordinate its size at their start, and to
    which independent piece they belong, (n,); each is one by itself where that is not given."""

    residual: Floats
    speed: Mapping[str, Floats]
    piece: Ints | None = None

    def part(self, which: Bools) -> Sizes:
        """Some of them."""
        piece = None if self.piece is None else self.piece[which]
        return Sizes(self.residual[which], {n: v[which] for n, v in self.speed.items()}, piece)

    @property
    def count(self) -> int:
        """How many independent pieces they are."""
        return len(self.residual) if self.piece is None else len(np.unique(self.piece))

    def enough(self, level: float) -> bool:
        """Whether they would suffice for a quantile of this level, were each a piece by itself."""
        return len(self.residual) >= fewest(level)


@dataclass(frozen=True, eq=False)
class Split:
    """Bounds (k,) below and above a speed; own: whether held-out transitions of its class set the first; pieces: how
    many independent ones of the class that has fewer set them."""

    velocity: str
    below: float
    slow: Floats
    fast: Floats
    own: bool
    pieces: int


def bound(fitted: Sizes, fresh: Sizes, level: float) -> Floats:
    """The split-conformal bound of residuals, (k,): all states at once inside with this probability, or with what the
    number of pieces leaves of it; infinite if even the held-out transitions are fewer than this level asks for.

    The score of a transition is the largest share of what the fitted ones leave at this level in a state. The bound is
    never narrower than that of the fitted ones: it covers what a few held-out minutes did not happen to hold.
    """
    own = fitted if len(fitted.residual) else fresh
    size = np.quantile(own.residual, level, axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    scores = np.max(fresh.residual / scale, axis=1)
    factors = [reach(scores, attained(fresh.count, level), fresh.piece) if fresh.enough(level) else np.inf]
    if own.enough(level):
        factors.append(reach(np.max(own.residual / scale, axis=1), level))
    return np.asarray(scale * max(factors) * _OUTWARD, dtype=np.float64)


def slow_and_fast(fitted: Sizes, fresh: Sizes, level: float, widest: Mapping[str, float]) -> Split | None:
    """The split that narrows the mean bound over X most; None if none does by a tenth or is wider near rest.

    Slow transitions of which too few were held out take the bound of all, widened to that of the fitted slow ones.

    Args:
        fitted: transitions that choose the split; fresh: held-out ones, which set the bounds.
        level: coverage asked for in each class.
        widest: velocity -> its largest size in X, symmetric; the largest that was fitted where not given.
    """
    if not (fitted.enough(level) and fresh.enough(level)):
        return None
    everywhere = bound(fitted, fitted, level)
    options = []
    for velocity, speed in fitted.speed.items():
        top = max(widest.get(velocity, 0.0) or float(speed.max()), 1e-300)
        for below in np.unique(np.quantile(speed, _SHARES)).tolist():
            near, far = fitted.part(speed <= below), fitted.part(speed > below)
            if near.enough(level) and far.enough(level) and fresh.part(fresh.speed[velocity] > below).enough(level):
                share = min(below / top, 1.0)
                mean = share * bound(near, near, level) + (1.0 - share) * bound(far, far, level)
                options.append((float(np.mean(mean / everywhere)), velocity, below))
    if not options or min(options)[0] > 1.0 - MATTERS:  # two classes need twice the held-out data
        return None
    _, velocity, below = min(options)
    return _split(fitted, fresh, level, velocity, below)


def _split(fitted: Sizes, fresh: Sizes, level: float, velocity: str, below: float) -> Split | None:
    near, far = (fitted.part((fitted.speed[velocity] <= below) == slow) for slow in (True, False))
    slow, fast = (fresh.part((fresh.speed[velocity] <= below) == slow) for slow in (True, False))
    in_motion = bound(far, fast, level)
    own = slow.enough(level)
    at_rest = bound(near, slow, level) if own else np.maximum(bound(near, near, level), bound(fitted, fresh, level))
    at_rest = np.maximum(at_rest, in_motion)  # what holds near rest stands beside what holds everywhere
    least = min(slow.count, fast.count) if own else fast.count
    return Split(velocity, below, at_rest, in_motion, own, least) if np.any(at_rest > in_motion) else None


def pieces(residual: Floats, run: Ints, step: Ints, held_out: Bools) -> tuple[Ints, bool]:
    """The piece (n,) that each transition belongs to, and whether that is its run, because runs differ.

    Args:
        residual: (n, k) signed, each column in a unit of its own size.
        run: (n,) of each; step: (n,) how many steps since the begin of the run.
        held_out: (n,) which were never fitted.
    """
    score = np.abs(residual).max(axis=1)
    block = _blocks(run, step, held_out, max(memory(x, run, step) for x in (*residual.T, score)))
    return (run, True) if _differ(score, run, block) else (block, False)


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


def _blocks(run: Ints, step: Ints, held_out: Bools, length: float) -> Ints:
    """Stretches of each run that are at least `length` steps long, or that many steps from the next."""
    block, count = np.zeros(len(run), dtype=np.int64), 0
    sides = 2 * np.unique(run, return_inverse=True)[1] + held_out
    for side in np.unique(sides):
        own = np.flatnonzero(sides == side)
        own = own[np.argsort(step[own], kind="stable")]
        for part in np.split(own, np.flatnonzero(np.diff(step[own]) >= length) + 1):
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
