"""The game on an abstraction: the operators that specifications are solved by, whatever the controller may measure.

With a perfect measurement, and for whatever is to be reached, cells are of the measured state: a box of successors
holds every state that may be measured there. With a sample of latency a node is such a cell and the input that acts
meanwhile (`pending`); where the gap depends on the previous input, a cell and the class of that input. What is only to
be held is better solved on cells of the true state, with what the controller cannot tell apart taken into account
afterwards (`sensing`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.function import GapFunction
from simgap.geometry import Grid
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.intersample import SweptCells
from simgap.synthesis.abstraction.post import Kernel
from simgap.synthesis.controller import least_effort
from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.input_sets import crop, embed, margins, padded, window_and


@dataclass(frozen=True, eq=False)
class CellGame:
    """Base of the games on cells.

    Attributes:
        space: the states.
        boxes: one abstraction for each class of the previous input that the plant remembers, on the same cells.
        stray: how far a path strays from its samples where clearance is to cover that, as in `SynthesisProblem`.
        threads: for the kernels.
        kind: (M,) class of each input; None where nothing is remembered. rest: class in which a run starts.
    """

    space: Space
    boxes: tuple[Abstraction, ...]
    stray: Floats
    threads: int = 1
    kind: Ints | None = None
    rest: int = 0

    @property
    def grid(self) -> Grid:
        """The cells that sets are made of."""
        return self.boxes[0].grid

    @property
    def error(self) -> Floats:
        """The measurement error that the boxes account for, (nx,)."""
        return self.boxes[0].error


@dataclass(frozen=True, eq=False)
class MeasuredGame(CellGame):
    """The game on nodes: a cell of the measured state and the class of the previous input, if the plant remembers it.

    Attributes:
        one: whether to record the input of least effort of each node instead of all.
        after_any: makes the abstraction of the bound after any input, for what is to be held; the only one if None.
    """

    one: bool = False
    after_any: Callable[[], Abstraction] | None = None

    def invariant(self, safe: Bools) -> Solution:
        """The greatest fixed point of the controlled predecessor within the safe cells, (cells,) bool.

        With classes, a set that can be held after any input: sound, not always the largest.

        Raises:
            UserError: where one input a cell is asked for.
        """
        if self.one:
            raise one_input_only("a set that is to be held")
        abstraction = self.boxes[0] if self.after_any is None else self.after_any()
        if abstraction.swept is not None:
            raise BrokenPromise("swept boxes are not checked by the invariance kernel", "Let the clearance cover them.")
        found = invariance(abstraction, None if safe.all() else safe, self.threads)
        classes = len(self.boxes)
        return Solution(
            grid=self.grid,
            winning=certified(found.winning, self.grid, self.error),
            mask=found.mask if classes == 1 else np.repeat(found.mask, classes, axis=0),
            free=safe,
            memory=classes,
            first=self.rest,
            kind=self.kind,
            statistics={"passes": found.passes, "pairs": found.pairs},
        )

    def reach(self, target: Bools, free: Bools) -> Solution:
        """The least fixed point over nodes, its value function and all inputs that go down a level.

        `target` is a set of cells (cells,) or of nodes, `free` of cells, bool.
        """
        classes, order = len(self.boxes), least_effort(self.boxes[0].inputs) if self.one else None
        known = {} if self.kind is None else {"classes": classes}
        goal = np.asarray(target.reshape(self.grid.size, -1).all(axis=1))  # what is held is held after any input
        found = reach_avoid(self.boxes, goal, free, self.threads, order=order, kind=self.kind)
        return Solution(
            grid=self.grid,
            winning=certified(found.winning.reshape(-1, classes)[:, self.rest], self.grid, self.error),
            mask=found.mask,
            free=free,
            value=found.value,
            target=found.value == 0,
            memory=classes,
            first=self.rest,
            kind=self.kind,
            statistics={"steps": found.steps, "backend": found.backend, **known},
            chosen=found.chosen if self.one else None,
        )


def one_input_only(what: str) -> UserError:
    """For what one input a cell cannot be recorded."""
    return UserError(
        f"one input a cell cannot be recorded for {what}", key="synthesis.record", remedy="Set it to `all`."
    )


def certified(winning: Bools, grid: Grid, error: Floats) -> Bools:
    """True cells whose every measurement is in a winning cell (cells,); one beyond the grid is in none.

    Args:
        winning: measured cells, (cells,); grid: of both.
        error: bound of |measured - true|, (nx,).
    """
    margin = margins(grid, error)
    larger = padded(grid, margin)
    inside = embed(winning.astype(np.uint64)[:, None], grid, larger, np.zeros(1, np.uint64))
    return crop(window_and(inside, larger, margin), grid, larger)[:, 0] == 1


@dataclass(frozen=True, eq=False)
class PreviousBounds:
    """Bounds after a previous input of each class.

    Attributes:
        kind: (M,) class of each input. rest: class in which a run starts.
        gaps: the gap's bound in each class; swept: cells that the path may touch, None where that is nothing.
    """

    kind: Ints
    rest: int
    gaps: tuple[Kernel | GapFunction, ...]
    swept: tuple[SweptCells | None, ...]
