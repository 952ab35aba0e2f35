"""The game on an abstraction: the operators that specifications are solved by, whatever the controller may measure.

With a perfect measurement, and for whatever is to be reached, cells are of the measured state: a box of successors
holds every state that may be measured there. With a sample of latency a node is such a cell and the input that acts
meanwhile (`pending`); where the gap depends on the previous input, a cell and the class of that input. What is only to
be held is better solved on cells of the true state, with what the controller cannot tell apart taken into account
afterwards (`sensing`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.function import GapFunction
from simgap.geometry import Grid
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.post import Kernel
from simgap.synthesis.abstraction.swept import SweptCells
from simgap.synthesis.controller import least_effort
from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.layered import layered_invariance, no_layers
from simgap.synthesis.games.pending import Nodes, PendingGame
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.games.reach_rows import reach_by_rows
from simgap.synthesis.games.row_moves import RowSystem, with_common_sweeps
from simgap.synthesis.games.sensing import sensed_invariance
from simgap.synthesis.input_sets import margins, window_and


@dataclass(frozen=True, eq=False)
class MeasuredGame:
    """The game on cells of the measured state.

    Attributes:
        space: the states; abstraction: its boxes account for its `error`.
        stray: how far a path strays from its samples where clearance is to cover that, as in `Problem`.
        threads: for the kernels. one: whether to record the input of least effort of each cell instead of all.
        layers: sizes of cells by which a set to be held is found, on one thread where there are several.
    """

    space: Space
    abstraction: Abstraction
    stray: Floats
    threads: int = 1
    one: bool = False
    layers: int = 1

    @property
    def grid(self) -> Grid:
        """Cells of the measured state."""
        return self.abstraction.grid

    @property
    def error(self) -> Floats:
        """The measurement error, (nx,)."""
        return self.abstraction.error

    def invariant(self, safe: Bools) -> Solution:
        """The greatest fixed point of the controlled predecessor within the safe cells, (cells,) bool.

        Raises:
            UserError: where one input a cell is asked for; several layers for boxes that are not tabulated.
        """
        if self.one:
            raise one_input_only("a set that is to be held")
        if self.abstraction.swept is not None:
            raise BrokenPromise("swept boxes are not checked by the invariance kernel", "Let the clearance cover them.")
        wanted, asked = None if safe.all() else safe, dict[str, int]()
        if self.layers > 1:
            found, pairs = layered_invariance(self.abstraction, self.layers, wanted)
            asked = {f"pairs_asked_{2**k}": count for k, count in enumerate(reversed(pairs))}
        else:
            found = invariance(self.abstraction, wanted, self.threads)
        return Solution(
            grid=self.grid,
            winning=certified(found.winning, self.grid, self.error),
            mask=found.mask,
            free=safe,
            statistics={"passes": found.passes, "pairs": found.pairs, **asked},
        )

    def reach(self, target: Bools, free: Bools) -> Solution:
        """The least fixed point, its value function and all inputs that go down a level; sets are (cells,) bool.

        Raises:
            UserError: where several layers are asked for.
        """
        if self.layers > 1:
            raise no_layers("what is to be reached")
        order = least_effort(self.abstraction.inputs) if self.one else None
        found = reach_avoid(self.abstraction, target, free, self.threads, order=order)
        return Solution(
            grid=self.grid,
            winning=certified(found.winning, self.grid, self.error),
            mask=found.mask,
            free=free,
            value=found.value,
            target=target & free,
            statistics={"steps": found.steps, "backend": found.backend},
            chosen=found.chosen if self.one else None,
        )


def one_input_only(what: str) -> UserError:
    """For what one input a cell cannot be recorded."""
    return UserError(
        f"one input a cell cannot be recorded for {what}", key="synthesis.record", remedy="Set it to `all`."
    )


@dataclass(frozen=True, eq=False)
class LateGame:
    """The game on cells of the measured state and the input that acts until the one chosen there does.

    Attributes:
        space, stray: as for `MeasuredGame`; pending: its nodes; the boxes account for its `error`.
        first: number of the input that acts in the first sample, before any measurement has arrived.
        rest: class in which a run starts, where the plant remembers the input before.
    """

    space: Space
    pending: PendingGame
    stray: Floats
    first: int
    rest: int = 0

    @property
    def grid(self) -> Grid:
        """Cells of the measured state."""
        return self.pending.grid

    @property
    def error(self) -> Floats:
        """The measurement error, (nx,)."""
        return self.pending.boxes[0].error

    def invariant(self, safe: Bools) -> Solution:
        """The largest set of nodes of the safe cells (cells,) bool that can be held."""
        if any(a.swept is not None for a in self.pending.boxes):
            raise BrokenPromise("swept boxes are not checked where a set is held", "Let the clearance cover them.")
        return self._solution(self.pending.hold(safe), safe)

    def reach(self, target: Bools, free: Bools) -> Solution:
        """The least fixed point, levels and all inputs that go down a level.

        `target` is a set of cells (cells,) or of nodes (cells * memory,), `free` of cells, bool.
        """
        goal = self.pending.nodes(target) if target.size == self.grid.size else _by_class(target, self.pending)
        return self._solution(self.pending.reach(goal, free), free)

    def _solution(self, found: Nodes, free: Bools) -> Solution:
        memory = found.inside.size // self.grid.size
        began = found.inside[self.rest, :, self.first]
        value = None if found.value is None else np.moveaxis(found.value, 0, 2).reshape(-1)
        return Solution(
            grid=self.grid,
            winning=certified(began, self.grid, self.error),
            mask=found.mask(),
            free=free,
            value=value,
            target=None if value is None else value == 0,
            memory=memory,
            first=self.first * len(self.pending.boxes) + self.rest,
            late=True,
            kind=self.pending.kind if len(self.pending.boxes) > 1 else None,
            statistics={"rounds": found.rounds, "nodes": int(found.inside.sum())},
        )


def _by_class(nodes: Bools, game: PendingGame) -> Bools:
    """Nodes in the order of a controller's rows as (classes, cells, M)."""
    return np.moveaxis(nodes.reshape(game.grid.size, game.inputs, len(game.boxes)), 2, 0)


def certified(winning: Bools, grid: Grid, error: Floats) -> Bools:
    """True cells whose every measurement is in a winning cell (cells,); one beyond the grid is in none.

    Args:
        winning: measured cells, (cells,); grid: of both.
        error: bound of |measured - true|, (nx,).
    """
    margin = margins(grid, error)
    if not any(margin):
        return winning
    inside = winning.reshape(grid.cells).copy()
    for j, m in enumerate(margin):
        if m and j not in grid.periodic:
            ends = np.moveaxis(inside, j, 0)
            ends[:m], ends[-m:] = False, False
    kept = window_and(winning.astype(np.uint64)[:, None], grid, margin)[:, 0] == 1
    return np.asarray(kept & inside.reshape(-1))


@dataclass(frozen=True, eq=False)
class TrueGame:
    """The game on cells of the true state, of which the controller knows a measurement: it can only hold sets.

    Attributes:
        space: the states; abstraction: without measurement error.
        blur: bound of the measurement error, (nx,); latency: whole samples between a measurement and its input.
        stray, threads: as for `MeasuredGame`; first: as for `LateGame`, without meaning where there is no latency.
    """

    space: Space
    abstraction: Abstraction
    blur: Floats
    latency: int
    stray: Floats
    threads: int = 1
    first: int = 0

    @property
    def grid(self) -> Grid:
        """Cells of the true state."""
        return self.abstraction.grid

    @property
    def error(self) -> Floats:
        """None, (nx,) zeros: the cells are those of the state itself."""
        return np.zeros(self.space.size)

    def invariant(self, safe: Bools) -> Solution:
        """A controlled invariant set in (cells,) that measurements suffice to keep; sound, not always the largest."""
        return sensed_invariance(self.abstraction, self.blur, self.latency, self.threads, safe, self.first)

    def reach(self, target: Bools, free: Bools) -> Solution:
        """Not on these cells, whatever the sets, (cells,) bool each.

        Raises:
            UserError: always.
        """
        raise UserError(
            "a specification that is solved on cells of the true state has nothing to reach",
            key="synthesis.specification",
            remedy="Let its on_true_cells be False.",
        )


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
    """Result of the least fixed point over classes.

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
    value, mask, _ = reach_by_rows(with_common_sweeps(systems), kind, target, free, threads)
    return ClassReach(value, mask, int(value.max(initial=0)))
