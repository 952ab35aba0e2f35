"""Objective of the adversary on the gap, and the record of its search."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from simgap.arrays import Floats

KEPT = 10  # witnesses of one search
_NARROW = 1e-300


def share(least: Floats, largest: Floats, lo: Floats, hi: Floats) -> Floats:
    """Distance of a gap beyond its bound, in widths of the bound: max_i max(d_i - hi_i, lo_i - d_i) / (hi_i - lo_i).

    -0.5 in the middle of the bound, 0 on it, positive outside; a gap that is no number counts as outside.

    Args:
        least, largest: (n, nx) range of the gap, equal where it is one number. lo, hi: (n, nx) its bounds.
    """
    excess = np.maximum(largest - hi, lo - least)
    relative = (excess / np.maximum(hi - lo, _NARROW)).max(axis=1)
    return np.where(np.isnan(relative), np.inf, relative)


@dataclass(frozen=True, eq=False)
class GapStep:
    """One step that the gap's bound was held against.

    Attributes:
        share: see `share`; x, u: (nx,), (nu,); d, lo, hi: (nx,) gap and bound, of a robot in its own frame.
        history: (k, nu) inputs before it from rest, and heading (rad) there, where the simulator remembers them.
    """

    share: float
    x: Floats
    u: Floats
    d: Floats
    lo: Floats
    hi: Floats
    history: Floats | None = None
    heading: float | None = None


@dataclass
class SearchRecord:
    """Record of a search over the gap.

    Attributes:
        evaluations: steps of the simulator that were held against the bound; violations: those outside.
        worst: the worst step; outside: the first few that lie outside, in the order in which they were found.
        by: evaluations of each kind of search.
    """

    evaluations: int = 0
    violations: int = 0
    worst: GapStep | None = None
    outside: list[GapStep] = field(default_factory=list)
    by: Counter[str] = field(default_factory=Counter)

    def see(self, kind: str, shares: Floats, step: Callable[[int], GapStep]) -> None:
        """Take note of evaluations, (n,) shares; `step(k)` describes the k-th."""
        self.evaluations += len(shares)
        self.by[kind] += len(shares)
        bad = np.flatnonzero(shares > 0.0)
        self.violations += len(bad)
        self.outside += [step(int(k)) for k in bad[: KEPT - len(self.outside)]]
        if len(shares):
            best = int(np.argmax(shares))
            if self.worst is None or shares[best] > self.worst.share:
                self.worst = step(best)

    @staticmethod
    def joined(parts: Sequence[SearchRecord]) -> SearchRecord:
        """Searches side by side."""
        out = SearchRecord()
        for part in parts:
            out.evaluations += part.evaluations
            out.violations += part.violations
            out.outside += part.outside[: KEPT - len(out.outside)]
            if part.worst is not None and (out.worst is None or part.worst.share > out.worst.share):
                out.worst = part.worst
            out.by.update(part.by)
        return out
