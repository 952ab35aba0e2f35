"""Judgement of closed-loop runs: the gap bound at every step, the specification at every sample."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.gap.bounds.function import GapFunction
from simgap.model.sampled import NominalModel
from simgap.simulators.body_samples import REST
from simgap.specifications.monitor import Monitor, Outcome, Run, Verdict
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space

LEFT = "left what is certified"
"""How a run ends that did what was asked, but not by way of what the controller's certificate says."""
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
    def outside(self) -> Bools:
        """Steps at which gamma did not hold: (k,) bool."""
        return ~np.all((self.lo <= self.d) & (self.d <= self.hi), axis=1)


@dataclass(frozen=True, eq=False)
class Judge:
    """Bound and specification that the runs of one controller must keep.

    Attributes:
        space: the states; monitor: of the specification; steps: samples that a run has.
        inputs: U, (M, nu); model, gap: f and the bound that the controller was made for.
        certificate: what a controller proves of this plant; a run that leaves it counts as a violation even if it comes
            back. None for a controller that proves nothing of it: the specification alone is judged.
        tolerant: whether the case tolerates steps outside gamma, so that a run with one is judged like that too.
    """

    space: Space
    monitor: Monitor
    steps: int
    inputs: Floats
    model: NominalModel
    gap: GapFunction
    certificate: Solution | None = None
    tolerant: bool = False

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
        previous = np.concatenate([np.array([REST, *r.inputs[:-1]], np.int64)[: len(r.inputs)] for r in runs])
        lo, hi = self.gap.bounds_after(x, u, previous)
        return GapAudit(following - self.model.step(x, u), lo, hi)

    def certified(self, verdict: Verdict, outside: int) -> Verdict:
        """The verdict, or that of a run that left its certificate: steps outside gamma, or states it does not hold."""
        if self.certificate is None or not verdict.outcome.kept or (outside and self.tolerant):
            return verdict
        if not outside and not strays(self.certificate, verdict.run):
            return verdict
        return replace(verdict, outcome=replace(verdict.outcome, end=LEFT, kept=False))

    def count(
        self, runs: Iterable[Run], numbers: Iterable[int], keep: int, again: Collection[int] = ()
    ) -> tuple[dict[str, Any], dict[int, Verdict]]:
        """Judge and audit every run: -> figures as plain data, the runs to look at by the numbers of their starts.

        Args:
            runs: from starts with these `numbers`.
            keep: how many to look at; again: starts that another controller or plant was looked at from: if any of them
                is among the numbers, these are kept, and the first other one that breaks what its certificate promises.
        """
        numbers = list(numbers)
        wanted = set(again) & set(numbers)
        tally, kept = Tally(), dict[int, Verdict]()
        promised, broken = self.certificate is not None, False
        following, number = iter(runs), iter(numbers)
        while batch := [self.verdict(run) for run in islice(following, BATCH)]:
            outside = split_by_run(self.audit([v.run for v in batch]).outside, [v.run for v in batch])
            for verdict, count in zip(batch, outside, strict=True):
                held, start = self.certified(verdict, count), next(number)
                tally.add(held.outcome, count)
                if start in wanted:
                    kept[start] = held
                elif not wanted:
                    keep_some(kept, start, held, keep)
                elif not held.outcome.kept and promised and not broken:  # what breaks a promise is always to be seen
                    kept[start], broken = held, True
        return self.monitor.summary(tally.outcomes) | tally.to_json(), kept


def strays(certificate: Solution, run: Run) -> int:
    """Steps of a run after which it is not where the certificate says.

    Towards a target: the level at what is measured and pending falls with every step, and stays 0 once it is. To stay:
    the state is in a winning cell, or in one from which the pending input may act. A controller of measured cells that
    remembers the pending input has no such set of states: it is held by having an input at every sample, without which
    a run is stuck.
    """
    grid, value = certificate.grid, certificate.value
    if value is None:
        cells = grid.index(run.x)
        if not certificate.late:
            inside = certificate.winning[cells]
        elif certificate.acting is not None and run.memory is not None:
            inside = (certificate.acting[cells, run.memory >> 3] >> (run.memory & 7) & 1) == 1
        else:
            return 0
        return int((~inside | (cells < 0))[1:].sum())
    levels = certificate.levels(run.measured, run.memory)
    before, after = levels[:-1], levels[1:]
    kept = (after >= 0) & ((after < before) | ((before == 0) & (after == 0)))
    return int((~kept).sum())


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


def keep_some(kept: dict[int, Verdict], number: int, verdict: Verdict, count: int) -> None:
    """Keep the first runs; the first that failed takes the last place if none of them did, so that it can be seen."""
    if len(kept) >= count and not verdict.outcome.kept and all(v.outcome.kept for v in kept.values()):
        kept.popitem()
    if len(kept) < count:
        kept[number] = verdict


def steps_of(runs: Sequence[Run], inputs: Floats) -> tuple[Floats, Floats, Floats]:
    """All steps of some runs under each other, `inputs` (M, nu): x (k, nx), u (k, nu), x+ (k, nx)."""
    x = np.concatenate([r.x[: len(r.inputs)] for r in runs])
    u = inputs[np.concatenate([r.inputs for r in runs])]
    return x, u, np.concatenate([r.x[1 : len(r.inputs) + 1] for r in runs])


def split_by_run(flags: Sequence[bool] | Bools, runs: Sequence[Run]) -> list[int]:
    """How many flagged steps each run has: (k,) bool, the steps of all runs under each other."""
    ends = np.cumsum([len(r.inputs) for r in runs])
    counts = np.concatenate([[0], np.cumsum(np.asarray(flags, dtype=np.int64))])
    return np.diff(counts[np.concatenate([[0], ends])]).astype(int).tolist()
