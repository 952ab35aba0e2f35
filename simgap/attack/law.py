"""The choices of an adversary against a controller: which measurement, and which of the admissible inputs.

At every sample the adversary takes any corner of the error box (or its middle) as the measurement, and any input that
the controller admits there. If the controller has no input at one of these measurements, and is not at its end there,
the promise is broken already.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.specifications.solution import Solution
from simgap.synthesis.input_sets import unpack


@dataclass(frozen=True, eq=False)
class Options:
    """Choices of the adversary at one sample of n runs.

    Attributes:
        inputs: (n, M) admissible at some measurement. corner: (n, M) which measurement, the first that admits it.
        stuck: (n,) corner without an input that is not the end, -1 where there is none.
        ended: (n,) corner at which the run is over, -1 where there is none.
    """

    inputs: Bools
    corner: Ints
    stuck: Ints
    ended: Ints


@dataclass(frozen=True, eq=False)
class ControlLaw:
    """A solution with the error of what is measured, (nx,)."""

    solution: Solution
    inputs: Floats
    error: Floats

    @cached_property
    def corners(self) -> Floats:
        """The middle and the corners of the error box, (c, nx)."""
        signs = [(-1.0, 1.0) if e > 0 else (0.0,) for e in self.error]
        corners = np.array(list(itertools.product(*signs)), dtype=float) * self.error
        return np.unique(np.concatenate([np.zeros((1, len(self.error))), corners]), axis=0)

    @cached_property
    def _ended(self) -> Bools:
        """Measured cells at which a run is over, (cells,): asked for once, because it looks at all of them."""
        return self.solution.ended if self.solution.target is not None else np.zeros(self.solution.grid.size, np.bool_)

    def first(self, count: int) -> Ints:
        """The memory of `count` runs before their first sample."""
        return np.full(count, self.solution.first, dtype=np.int64)

    def acting(self, memory: Ints, last: Ints) -> Ints:
        """The input that acts now whatever is chosen, where inputs are late; else the `last` one, (n,) each."""
        return self.applied(memory, np.zeros_like(memory))[0] if self.solution.late else last

    def applied(self, memory: Ints, decided: Ints) -> tuple[Ints, Ints]:
        """Inputs that act now, and the memory afterwards: (n,), (n,) -> (n,), (n,)."""
        now, after = self.solution.step(memory, decided)
        return np.asarray(now, np.int64), np.asarray(after, np.int64)

    def options(self, x: Floats, memory: Ints) -> Options:
        """At true states (n, nx) and memories (n,)."""
        n, count = len(x), len(self.inputs)
        inputs, corner = np.zeros((n, count), np.bool_), np.zeros((n, count), np.int64)
        stuck, ended = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
        for c in range(len(self.corners) - 1, -1, -1):
            own, over = self._at(x + self.corners[c], memory)
            none = ~own.any(axis=1)
            stuck[none & ~over], ended[none & over] = c, c
            inputs |= own
            corner[own] = c
        return Options(inputs, corner, stuck, ended)

    def _at(self, y: Floats, memory: Ints) -> tuple[Bools, Bools]:
        """Admissible inputs (n, M) at measurements, and whether a run is over there (n,)."""
        s = self.solution
        cells = s.grid.index(y)
        known = cells >= 0
        rows = np.where(known, cells * s.memory + memory, 0)
        admitted = unpack(s.admitted(len(self.inputs), rows), len(self.inputs)) & known[:, None]
        return admitted, self._ended[np.where(known, cells, 0)] & known
