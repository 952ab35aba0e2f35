"""The game on an abstraction: the operators that specifications are solved by, whatever the controller may measure.

With a perfect measurement, and for whatever is to be reached, cells are of the measured state: a box of successors
holds every state that may be measured there. With a sample of latency a node is such a cell and the input that acts
meanwhile (`pending`). What is only to be held is better solved on cells of the true state, with what the controller
cannot tell apart taken into account afterwards (`sensing`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.errors import BrokenPromise, UserError
from simgap.geometry import Grid
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.controller import least_effort
from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.layer_tables import no_layers
from simgap.synthesis.games.layered import layered_invariance
from simgap.synthesis.games.pending import Nodes, PendingGame
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.games.sensing import sensed_invariance
from simgap.synthesis.games.windows import margins, window_and


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
    kept = window_and(winning.astype(np.uint32)[:, None], grid, margin)[:, 0] == 1
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
