"""The game of a plant whose gap depends on the previous input: the controller remembers the class of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.errors import UserError
from simgap.geometry import Grid
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.nominal import BoxBounds
from simgap.synthesis.abstraction.product import Kernel
from simgap.synthesis.abstraction.swept import SweptCells
from simgap.synthesis.games.game import MeasuredGame, certified
from simgap.synthesis.games.reach_rows import RowSystem, reach_by_rows, with_common_sweeps


@dataclass(frozen=True, eq=False)
class PreviousBounds:
    """What is known after a previous input of each class.

    Attributes:
        kind: (M,) class of each input. rest: class in which a run starts.
        gaps: the gap's bound in each class; swept: cells that the path may touch, None where that is nothing.
    """

    kind: Ints
    rest: int
    gaps: tuple[Kernel | BoxBounds, ...]
    swept: tuple[SweptCells | None, ...]


@dataclass(frozen=True, eq=False)
class PreviousGame:
    """The game on nodes (measured cell, class of the previous input).

    Attributes:
        space: the states; stray: what clearance is to cover of the path between samples, as in `Problem`.
        boxes: one abstraction a class. whole: makes that of the bound after any input, for what is to be held.
        kind: (M,) class of each input. rest: class in which a run starts.
        threads: for the kernels.
    """

    space: Space
    boxes: tuple[Abstraction, ...]
    whole: Callable[[], Abstraction]
    kind: Ints
    rest: int
    stray: Floats
    threads: int = 1

    @property
    def grid(self) -> Grid:
        """Cells of the measured state."""
        return self.boxes[0].grid

    @property
    def error(self) -> Floats:
        """The measurement error, (nx,)."""
        return self.boxes[0].error

    def invariant(self, safe: Bools) -> Solution:
        """A set of the safe cells (cells,) that can be held after any input: sound, not always the largest."""
        found = MeasuredGame(self.space, self.whole(), self.stray, self.threads).invariant(safe)
        classes = len(self.boxes)
        return replace(
            found, mask=np.repeat(found.mask, classes, axis=0), memory=classes, first=self.rest, kind=self.kind
        )

    def reach(self, target: Bools, free: Bools) -> Solution:
        """The least fixed point over nodes; `target` is a set of cells (cells,) or of nodes, `free` of cells, bool."""
        classes = len(self.boxes)
        goal = np.asarray(target.reshape(self.grid.size, -1).all(axis=1))  # what is held is held after any input
        found = reach_by_classes(self.boxes, self.kind, goal, free, self.threads)
        value = found.value.reshape(-1)
        return Solution(
            grid=self.grid,
            winning=certified(found.value[:, self.rest] >= 0, self.grid, self.error),
            mask=found.mask.reshape(self.grid.size * classes, -1),
            free=free,
            value=value,
            target=value == 0,
            memory=classes,
            first=self.rest,
            kind=self.kind,
            statistics={"steps": found.steps, "backend": "bit_rows", "classes": classes},
        )


@dataclass(frozen=True, eq=False)
class ClassReach:
    """What the fixed point found.

    Attributes:
        value: (cells, classes) int32 worst-case steps to the target, -1 where losing.
        mask: (cells, classes, ceil(M / 8)) uint8 admissible inputs, none in the target.
        steps: the largest value.
    """

    value: NDArray[np.int32]
    mask: NDArray[np.uint8]
    steps: int


def reach_by_classes(
    boxes: Sequence[Abstraction], kind: Ints, target: Bools, free: Bools, threads: int = 1
) -> ClassReach:
    """Nodes from which the target is reached in bounded time through free cells, whatever the disturbance does.

    Args:
        boxes: one abstraction a class of the previous input, on the same cells and inputs.
        kind: (M,) class of each input.
        target, free: (cells,); target cells that are not free do not count.
        threads: slabs are shared among this many threads; the result does not depend on it.

    Raises:
        UserError: where no axis allows bit rows, or there are too many boxes.
    """
    found = [RowSystem.of(a) for a in boxes]
    systems = [own for own in found if own is not None]
    if len(systems) < len(found):
        raise UserError(
            "classes of the previous input need a gap that does not depend on the position, and boxes of few sizes",
            key="hidden_state.classes",
            remedy="Leave the classes out, or use fewer cells",
        )
    value, mask, _ = reach_by_rows(with_common_sweeps(systems), kind, target, free, threads, masks=True)
    return ClassReach(value, mask, int(value.max(initial=0)))
