"""What closed-loop runs are held against: the gap bound at every step, the specification at every sample."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.gap.function import GapFunction
from simgap.geometry import Floats
from simgap.model.sampled import NominalModel
from simgap.specifications.monitor import Monitor, Outcome, Run, Verdict
from simgap.specifications.space import Space

BATCH = 100  # runs whose steps are held against the bound at once


@dataclass(frozen=True, eq=False)
class GapAudit:
    """`lo(x, u) <= x+ - f(x, u) <= hi(x, u)` at every step of some runs.

    Attributes:
        d, lo, hi: (k, nx) gap and its bounds at each step.
        outside: (k,) steps at which some dimension leaves its bound.
    """

    d: Floats
    lo: Floats
    hi: Floats

    @property
    def outside(self) -> NDArray[np.bool_]:
        """Steps at which gamma did not hold: (k,) bool."""
        return ~np.all((self.lo <= self.d) & (self.d <= self.hi), axis=1)


@dataclass(frozen=True, eq=False)
class Judge:
    """What the runs of one controller are held against.

    Attributes:
        space: the states; monitor: of the specification; steps: samples that a run has.
        inputs: U, (M, nu); model, gap: f and the bound that the controller was made for.
    """

    space: Space
    monitor: Monitor
    steps: int
    inputs: Floats
    model: NominalModel
    gap: GapFunction

    def verdict(self, run: Run) -> Verdict:
        """How a run ended."""
        return self.monitor.judge(run, self.steps)

    def audit(self, runs: Sequence[Run]) -> GapAudit:
        """All steps of some runs, one under the other, against the bound; periodic states are brought into X."""
        x, u, following = steps_of(runs, self.inputs)
        if len(x) == 0:
            empty = np.empty((0, self.space.size))
            return GapAudit(empty, empty, empty)
        x, following = self.space.unwound(x, following)
        lo, hi = self.gap.bounds(x, u)
        return GapAudit(following - self.model.step(x, u), lo, hi)

    def count(self, runs: Iterable[Run], keep: int) -> tuple[dict[str, Any], list[Verdict]]:
        """Judge and audit every run: -> figures as plain data, the `keep` runs to look at."""
        tally, kept = Tally(), list[Verdict]()
        following = iter(runs)
        while batch := [self.verdict(run) for run in islice(following, BATCH)]:
            outside = split_by_run(self.audit([v.run for v in batch]).outside, [v.run for v in batch])
            for verdict, count in zip(batch, outside, strict=True):
                tally.add(verdict.outcome, count)
                keep_some(kept, verdict, keep)
        return self.monitor.summary(tally.outcomes) | tally.to_json(), kept


@dataclass
class Tally:
    """Counts over runs."""

    outcomes: list[Outcome] = field(default_factory=list)
    outside_gamma: int = 0

    def add(self, outcome: Outcome, outside: int = 0) -> None:
        """Count one run with the number of its steps outside gamma."""
        self.outcomes.append(outcome)
        self.outside_gamma += outside

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        failed = [o.steps for o in self.outcomes if not o.kept]
        ends = [o.end for o in self.outcomes]
        return {
            "runs": len(self.outcomes),
            "steps": sum(o.steps for o in self.outcomes),
            "runs_that_kept_the_specification": len(self.outcomes) - len(failed),
            "runs_that_violated_it": len(failed),
            "ends": {end: ends.count(end) for end in sorted(set(ends))},
            "steps_outside_gamma": self.outside_gamma,
            "median_steps_until_violation": float(np.median(failed)) if failed else None,
        }


def keep_some(kept: list[Verdict], verdict: Verdict, count: int) -> None:
    """Keep the first runs; the first that failed takes the last place if none of them did, so that it can be seen."""
    if len(kept) < count:
        kept.append(verdict)
    elif not verdict.outcome.kept and all(v.outcome.kept for v in kept):
        kept[-1] = verdict


def steps_of(runs: Sequence[Run], inputs: Floats) -> tuple[Floats, Floats, Floats]:
    """All steps of some runs under each other, `inputs` (M, nu): x (k, nx), u (k, nu), x+ (k, nx)."""
    x = np.concatenate([r.x[: len(r.inputs)] for r in runs])
    u = inputs[np.concatenate([r.inputs for r in runs])]
    return x, u, np.concatenate([r.x[1 : len(r.inputs) + 1] for r in runs])


def split_by_run(flags: Sequence[bool] | NDArray[np.bool_], runs: Sequence[Run]) -> list[int]:
    """How many flagged steps each run has: (k,) bool, the steps of all runs under each other."""
    ends = np.cumsum([len(r.inputs) for r in runs])
    counts = np.concatenate([[0], np.cumsum(np.asarray(flags, dtype=np.int64))])
    return np.diff(counts[np.concatenate([[0], ends])]).astype(int).tolist()
