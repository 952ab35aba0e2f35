"""The game on an abstraction: the operators that specifications are solved by, whatever the controller may measure.

There is one game, on nodes (`nodes`): a cell and what is remembered there. With a perfect measurement, and for what is
to be reached, cells are of the measured state: a box of successors holds every state that may be measured there. What
is only to be held is better solved on cells of the true state, with what the controller cannot tell apart taken into
account afterwards:

Let W be a set of nodes and adm(k, p) the inputs that keep all that may follow in W. Whatever the controller does, it
knows that the node is in W, since it kept it there. So with a measurement in cell y,

    I(y, p) = AND of adm(k, p) over the nodes (k, p) of W with k within the error of y.

If no I is empty, W is never left. Where one is empty, all nodes that share it are dropped from W, and that repeats
from what can still be held until nothing is empty. The result is sound; it need not be the largest, because such sets
are not closed under union. Without an error nothing is shared, and it is the largest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

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
from simgap.synthesis.games.nodes import NONE, NodeStep, bytes_of_nodes
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.input_sets import (
    LARGEST_TABLES,
    Bytes,
    Words,
    crop,
    embed,
    every_input,
    margins,
    padded,
    to_bytes,
    to_words,
    unpack,
    window_and,
    words_of,
)


@dataclass(frozen=True, eq=False)
class NodeGame:
    """The game on nodes: a cell, the input that acts now where inputs are late, and the class of the one before.

    Attributes:
        boxes: one abstraction for each class of the previous input that the plant remembers, on the same cells.
        space: the states.
        stray: how far a path strays from its samples where clearance is to cover that, as in `SynthesisProblem`.
        threads: for the kernels.
        late: whether inputs act a sample after they are chosen. first: the input that acts in the first sample then.
        kind: (M,) class of each input; None where nothing is remembered. rest: class in which a run starts.
        one: whether to record the input of least effort of each node instead of all.
        after_any: makes the abstraction of the bound after any input, for what is to be held at once; the only one if
            None.
        blur: bound of the measurement error, (nx,), for cells of the true state, where boxes do not account for it:
            such a game can only hold sets. None for cells of the measured state.
    """

    boxes: tuple[Abstraction, ...]
    space: Space
    stray: Floats
    threads: int = 1
    late: bool = False
    first: int = 0
    kind: Ints | None = None
    rest: int = 0
    one: bool = False
    after_any: Callable[[], Abstraction] | None = None
    blur: Floats | None = None

    def __post_init__(self) -> None:
        inputs = len(self.boxes[0].inputs)
        needed = bytes_of_nodes(self.grid.size, inputs, len(self.boxes)) if self.late else 0
        if needed > LARGEST_TABLES:
            raise UserError(
                f"{self.grid.size} cells with {inputs} pending inputs are too many for a controller with latency: "
                f"{needed / 1e9:.1f} GB of nodes, at most {LARGEST_TABLES / 1e9:.1f} GB",
                key="synthesis.cells",
                remedy="Use fewer cells or inputs",
            )

    @property
    def grid(self) -> Grid:
        """The cells that sets are made of."""
        return self.boxes[0].grid

    @property
    def error(self) -> Floats:
        """The measurement error that the boxes account for, (nx,)."""
        return self.boxes[0].error

    def reach(self, target: Bools, free: Bools, through: Bools | None = None, steps: int | None = None) -> Solution:
        """The least fixed point over nodes, its value function and all inputs that go down a level.

        `target` is a set of cells (cells,) or of nodes (cells * memory,), `free` and `through` of cells, bool; these
        and `steps` are those of `reach_avoid`.

        Raises:
            UserError: on cells of the true state.
        """
        if self.blur is not None:
            raise UserError(
                "a specification that is solved on cells of the true state has nothing to reach",
                key="synthesis.specification",
                remedy="Let its on_true_cells be False.",
            )
        order = least_effort(self.boxes[0].inputs) if self.one else None
        how = self.threads, order, self.kind, self.late
        found = reach_avoid(self.boxes, target, free, *how, through=through, steps=steps)
        return Solution(
            winning=self._winning(np.moveaxis(found.winning.reshape(self.grid.size, -1, len(self.boxes)), 2, 0)),
            mask=found.mask,
            free=free,
            value=found.value,
            target=found.value == 0,
            statistics={"steps": found.steps, "backend": found.backend},
            chosen=found.chosen if self.one else None,
            **self._about(self.grid),
        )

    def certain(self, cells: Bools) -> Bools:
        """Cells (cells,) of which every measurement is in one of the given cells; one beyond the grid is in none."""
        margin = margins(self.grid, self.error)
        larger = padded(self.grid, margin)
        inside = embed(cells.astype(np.uint64)[:, None], self.grid, larger, 0)
        return crop(window_and(inside, larger, margin), self.grid, larger)[:, 0] == 1

    def invariant(self, safe: Bools) -> Solution:
        """The largest set of nodes of the safe cells (cells,) that can be held, by what is measured of them.

        Where inputs are late, `safe` may be nodes (cells * memory,) instead. With classes and inputs that act at once,
        one that can be held after any input: sound, not always the largest.

        Raises:
            UserError: where one input a cell is asked for.
        """
        if self.one:
            raise one_input_only("a set that is to be held")
        at_once = self.boxes[:1] if self.after_any is None else (self.after_any(),)
        boxes = self.boxes if self.late else at_once
        if any(a.swept is not None for a in boxes):
            raise BrokenPromise("swept boxes are not checked where a set is held", "Let the clearance cover them.")
        nodes = safe.reshape(self.grid.size, -1, len(self.boxes) if safe.size > self.grid.size else 1)
        safe = np.asarray(np.any(nodes, axis=(1, 2)))
        inside, mask, statistics = self._held(boxes, safe, np.moveaxis(nodes, 2, 0))
        repeats = len(self.boxes) // len(boxes)
        acting = None
        if self.late and self.blur is not None:
            acting = to_bytes(self._on_measurements(words_of(inside[0]), 0), inside.shape[2])
        return Solution(
            winning=self._flags(self._winning(inside)),
            mask=mask if repeats == 1 else np.repeat(mask, repeats, axis=0),
            free=self._flags(safe),
            statistics=statistics,
            acting=acting,
            **self._about(padded(self.grid, self._margin)),
        )

    def _held(
        self, boxes: tuple[Abstraction, ...], safe: Bools, nodes: Bools
    ) -> tuple[Bools, Bytes, dict[str, int | str]]:
        """Nodes that are held, (classes, cells, P), the inputs of the measured ones (nodes, bytes), and counts."""
        inputs = len(boxes[0].inputs)
        step = NodeStep(boxes, np.zeros(inputs, np.int64) if self.kind is None else self.kind, self.late, self.threads)
        inside, sets, passes = step.able(boxes, safe) & nodes, step.no_inputs(), 0
        if self.late and len(boxes) == 1:
            inside &= unpack(invariance(boxes[0], safe, self.threads).mask, inputs)
        lost = np.ones_like(inside)
        while True:
            if self.late:
                none = step(inside, lost, inside, sets) == NONE
                sets[none], served, passes, pairs = 0, ~none, passes + 1, int(inside.sum())
            else:
                found = invariance(boxes[0], None if inside.all() else inside[0, :, 0], self.threads)
                inside, sets = found.winning[None, :, None], found.mask[None, :, None]
                served, passes, pairs = inside, passes + found.passes, found.pairs
            shared = None
            if any(self._margin):
                shared, served = self._shared(inside[0], sets[0] if self.late else to_words(sets[0]))
            lost = inside & ~served
            if not lost.any():
                break
            inside = inside & served
        mask = step.flat(sets) if shared is None else to_bytes(self._near(inside[0], shared), inputs)
        return inside, mask, {"passes": passes, "pairs": pairs}

    def _shared(self, inside: Bools, sets: Words) -> tuple[Words, Bools]:
        """I(y, p) of the measured cells, (larger cells, P, words), and the nodes that always have one, (1, cells, P).

        From those that are held now (cells, P) and their inputs (cells, P, words). I is all inputs where none is near.
        """
        grid, margin, pending = self.grid, self._margin, inside.shape[1]
        larger, full = padded(grid, margin), every_input(len(self.boxes[0].inputs))
        own = np.where(inside[:, :, None], sets, full).reshape(grid.size, -1)
        shared = window_and(embed(own, grid, larger, np.tile(full, pending)), larger, margin)
        shared = shared.reshape(larger.size, pending, -1)
        served = crop(window_and(words_of(np.asarray(shared.any(axis=2))), larger, margin), grid, larger)
        return shared, unpack(to_bytes(served, pending), pending)[None]

    def _near(self, inside: Bools, shared: Words) -> Words:
        """Rows of `shared` (larger cells, P, words), emptied where no node of `inside` (cells, P) is near."""
        larger, pending = padded(self.grid, self._margin), inside.shape[1]
        far = window_and(self._on_measurements(~words_of(inside), ~np.uint64(0)), larger, self._margin)
        near = unpack(to_bytes(~far, pending), pending)
        return (shared * near[:, :, None]).reshape(larger.size * pending, -1)

    @cached_property
    def _margin(self) -> tuple[int, ...]:
        """Cells to either side of a true one in which it may be measured, per axis."""
        return margins(self.grid, np.zeros(self.grid.box.size) if self.blur is None else self.blur)

    def _on_measurements(self, words: Words, outside: Any) -> Words:
        """Words of cells (cells, k) on the cells that may be measured, which are more by the margin."""
        larger = padded(self.grid, self._margin)
        return embed(words, self.grid, larger, outside)

    def _flags(self, values: Bools) -> Bools:
        """Flags of cells on the cells that may be measured."""
        return self._on_measurements(values.astype(np.uint64)[:, None], 0)[:, 0] == 1 if any(self._margin) else values

    def _winning(self, nodes: Bools) -> Bools:
        """Cells (cells,) in which a run may start, from nodes (classes, cells, P), whatever is measured there."""
        first = nodes[self.rest if len(nodes) > 1 else 0, :, self.first if self.late else 0]
        return self.certain(first)

    def _about(self, grid: Grid) -> dict[str, Any]:
        """What a solution says of its nodes."""
        classes, pending = len(self.boxes), len(self.boxes[0].inputs) if self.late else 1
        first = (self.first if self.late else 0) * classes + self.rest
        kind = self.kind if classes > 1 or not self.late else None
        return {"grid": grid, "memory": pending * classes, "first": first, "late": self.late, "kind": kind}


def one_input_only(what: str) -> UserError:
    """For what one input a cell cannot be recorded."""
    return UserError(
        f"one input a cell cannot be recorded for {what}", key="synthesis.record", remedy="Set it to `all`."
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
