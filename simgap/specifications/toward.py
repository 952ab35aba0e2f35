"""What watches a run towards a target: the level of the value function, and how near it comes to anything."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.geometry import Box
from simgap.specifications.monitor import Monitor, Outcome, Run, Verdict
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.specifications.surroundings import Surroundings, first_touch

LATE = "out of time"


@dataclass(frozen=True, eq=False)
class Toward(Monitor):
    """Judges runs towards a target.

    Attributes:
        space: the states; target: the box to be in, infinite along states that do not matter.
        surroundings: what must not be touched; solution: of the controller, whose value falls with every step.
    """

    space: Space
    target: Box
    surroundings: Surroundings
    solution: Solution

    measures_clearance = True

    def clearance(self, path: Floats) -> float:
        """Least distance to obstacles and walls along a path (k, nx)."""
        return self.surroundings.least(path)

    def levels(self, run: Run) -> Ints:
        """Worst-case steps to the target at each sample, from what was measured and remembered: (k + 1,), -1 where
        losing."""
        return self.solution.levels(run.seen, run.memory)

    def arrived(self, seen: Floats) -> bool:
        """Whether what is measured (nx,) is the end of a run, whatever is pending."""
        cell = self._find(seen)
        return cell >= 0 and self._ended[cell]

    def in_target(self, x: Floats) -> Bools:
        """Whether states are in the target's box: (n, nx) -> (n,); along periodic states in any of its copies."""
        inside = np.ones(len(x), np.bool_)
        for j in range(self.space.size):
            lo, hi = self.target.lo[j], self.target.hi[j]
            if j in self.space.periodic and np.isfinite(lo):
                period = self.space.box.hi[j] - self.space.box.lo[j]
                inside &= np.mod(x[:, j] - lo, period) <= hi - lo
            else:
                inside &= (x[:, j] >= lo) & (x[:, j] <= hi)
        return inside

    def judge(self, run: Run, steps: int) -> Verdict:
        """Cut the run where it touches something, or ask how it ended."""
        if run.clearance is None:  # no path between samples was recorded
            near = self.surroundings.along_chords(run.x)
            run = replace(run, clearance=near)
        assert run.clearance is not None
        hit = first_touch(run.clearance) if len(run.inputs) else None
        run = run if hit is None else run.until(hit)
        levels = self.levels(run)
        end, kept = (self.surroundings.touched, False) if hit is not None else self.ended(run, levels, steps)
        safe = (np.arange(len(run.x)) < len(run.x) - (hit is not None)) & self.unbroken(run, levels)
        figures = self.measured(run, levels, hit is not None)
        return Verdict(Outcome(end, kept, len(run.inputs), figures), run, safe)

    @abstractmethod
    def ended(self, run: Run, levels: Ints, steps: int) -> tuple[str, bool]:
        """How a run ended that touched nothing, and whether that is what was asked for; levels (k + 1,)."""

    def unbroken(self, run: Run, levels: Ints) -> Bools:
        """Samples up to which nothing but a touch could have violated what was asked for: (k + 1,)."""
        return np.ones(len(run.x), np.bool_)

    def measured(self, run: Run, levels: Ints, hit: bool) -> dict[str, float]:
        """Steps until the target, steps that left the certified box, and the least clearance; levels (k + 1,)."""
        arrived = np.flatnonzero(levels == 0)
        last = int(arrived[0]) if len(arrived) else len(levels) - 1 - hit
        falls = (levels[1 : last + 1] >= 0) & (levels[1 : last + 1] < levels[:last])
        near = run.clearance if run.clearance is not None else np.array([np.inf])
        return {
            "to_target": float(arrived[0]) if len(arrived) else np.nan,
            "climbs": float((~falls).sum()),
            "clearance": float(near.min()),
        }

    def summary(self, outcomes: Sequence[Outcome]) -> dict[str, Any]:
        """Steps to the target of the runs that kept the specification, and the worst over all of them."""
        near = min((o.figures["clearance"] for o in outcomes), default=np.inf)
        key = "least_clearance" if self.surroundings.round else "least_clearance_in_widths_of_X"
        return {
            "steps_to_target": [int(o.figures["to_target"]) for o in outcomes if o.kept],
            "steps_that_left_the_certified_box": int(sum(o.figures["climbs"] for o in outcomes)),
            key: near,
        }

    @cached_property
    def _find(self) -> Any:
        return self.solution.grid.finder()

    @cached_property
    def _ended(self) -> list[bool]:
        return self.solution.ended.tolist()  # a list answers faster than an array, one element at a time
