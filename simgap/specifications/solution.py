"""Solution of a specification: winning domain, admissible inputs, value function."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.geometry import Grid


@dataclass(frozen=True, eq=False)
class Progress:
    """What a task has come to: the state of its automaton, which every measurement moves on.

    Attributes:
        after: (cells, Q) int16, the state after a sample in a cell, from the one before it. base: memories of the
            plant's own game beside it; a memory is state * base + its own.
        persists: whether the task is to stay at its goal in the end: the value then never rises. Otherwise it rises
            from 0, to begin the next round.
        awaits: of each state, the regions that it waits for: 'a and b', '' where that is no one thing.
    """

    after: NDArray[np.int16]
    base: int
    persists: bool = False
    awaits: tuple[str, ...] = ()

    def __call__(self, memory: Any, cells: Any) -> Any:
        """States after samples in `cells`, numbers or (n,), from the memories before them."""
        return self.after[cells, memory // self.base]


@dataclass(frozen=True, eq=False)
class Solution:
    """Winning domain and all admissible inputs.

    Attributes:
        grid: cells of the measured state.
        winning: (cells,) bool, where a run may start (cells of the true state); target cells included.
        mask: (cells * memory, ceil(M / 8)) uint8, bit m % 8 of byte m // 8 is input m; empty where a run ends.
        value: worst-case steps to the target, (cells * memory,) int32, -1 where losing; None where nothing is to be
            reached.
        target: (cells * memory,) bool, nodes that are the goal: where a run ends, or stays; None where there is none.
        free: (cells,) bool, cells that the specification allows at all; winning fractions are of these.
        memory: discrete states of the controller: 1, or C where it remembers the class of the previous input, or M C
            where it remembers first which input acts until its next one does.
        statistics: counts such as passes, steps and admissible pairs, and the backend that was used.
        first: memory before the first sample. late: whether the input that is remembered acts now and the chosen one a
            sample later. kind: (M,) class of each input, 0 to C - 1; None for one class.
        chosen: (cells * memory,) int16, -1 for none: the one input of each node, where one alone is recorded; `mask`
            has then no columns, and readers ask `admitted`.
        progress: of a task, whose state is part of the memory; None for what needs none. Its `value` is a bound of the
            steps until the next good move, and `target` are nodes at one.
        acting: (cells, ceil(M / 8)) uint8, inputs that may act from cells of the true state; None but for a controller
            that keeps such cells by late measurements, which does not know them itself.
    """

    grid: Grid
    winning: Bools
    mask: NDArray[np.uint8]
    free: Bools
    value: NDArray[np.int32] | None = None
    target: Bools | None = None
    memory: int = 1
    statistics: dict[str, int | str] = field(default_factory=dict)
    first: int = 0
    late: bool = False
    kind: Ints | None = None
    acting: NDArray[np.uint8] | None = None
    chosen: NDArray[np.int16] | None = None
    progress: Progress | None = None

    @property
    def fraction(self) -> float:
        """Winning cells over free cells."""
        return float(self.winning.sum() / max(1, self.free.sum()))

    @cached_property
    def served(self) -> Bools:
        """Nodes (measured cell, memory) at which the controller has an input, (cells * memory,); looked up once."""
        if self.chosen is not None:
            return np.asarray(self.chosen >= 0)
        if self.mask.shape[1] == 0:
            raise RuntimeError("the admissible inputs of this controller were not read")
        wide = self.mask.shape[1] % 8 == 0 and self.mask.flags.c_contiguous
        flags: Bools = np.any(self.mask.view(np.uint64) if wide else self.mask, axis=1)
        return flags

    def admitted(self, inputs: int, rows: Any = slice(None)) -> NDArray[np.uint8]:
        """Admissible inputs, of all nodes or of some rows, as `mask` has them, of `inputs` there are: (k, bytes)."""
        if self.chosen is None:
            return self.mask[rows]
        own = self.chosen[rows]
        bits = np.zeros((len(own), (inputs + 7) // 8), np.uint8)
        some = np.flatnonzero(own >= 0)
        bits[some, own[some] >> 3] = np.uint8(1) << (own[some] & 7).astype(np.uint8)
        return bits

    @cached_property
    def ended(self) -> Bools:
        """Measured cells that are the goal whatever the memory, (cells,); looked up once."""
        if self.target is None:
            return np.zeros(self.grid.size, np.bool_)
        flags: Bools = np.all(self.target.reshape(self.grid.size, self.memory), axis=1)
        return flags

    @property
    def beginnings(self) -> Ints:
        """Winning cells in which a run does not end at once, (k,)."""
        begin = self.winning if self.target is None else self.winning & self.at_first(self.served)
        return np.flatnonzero(begin)

    @property
    def useful(self) -> bool:
        """True if a run can start anywhere but where it ends at once."""
        return bool((self.winning & self.at_first(self.served)).any())

    def levels(self, measured: Floats, memory: Ints | None = None) -> Ints:
        """Worst-case steps to the target at what is measured (n, nx) and remembered (n,): (n,), -1 where losing.

        Without `memory`, at that of a start.
        """
        cells = self.grid.index(measured)
        if self.value is None:
            return np.full(len(cells), -1)
        rows = cells * self.memory + (self.first if memory is None else memory)
        return np.where(cells >= 0, self.value[rows], -1).astype(np.int64)

    def step(self, memory: Any, chosen: Any, cells: Any) -> tuple[Any, Any]:
        """The input that is applied and the memory after it, numbers or (n,): from the memory and the input chosen.

        `cells` are those that were measured; only the state of a task depends on them.
        """
        return after_choice(self.kind, self.late, memory, chosen, self.progress, cells)

    def at_first(self, nodes: NDArray[Any]) -> NDArray[Any]:
        """Values of nodes (cells * memory,) at the memory of a start: -> (cells,)."""
        return nodes.reshape(self.grid.size, self.memory)[:, self.first]

    def followed_by(self, other: Solution) -> Solution:
        """This solution with the inputs of another one, on the same grid, in the target: what a run does from there."""
        if self.target is None:
            return self
        statistics = self.statistics | {f"held_{name}": count for name, count in other.statistics.items()}
        return replace(self, mask=np.where(self.target[:, None], other.mask, self.mask), statistics=statistics)


def after_choice(
    kind: Ints | None, late: bool, memory: Any, chosen: Any, progress: Progress | None = None, cells: Any = 0
) -> tuple[Any, Any]:
    """Applied input and memory after a choice, of a controller with classes `kind` (M,) or None, acting late or not.

    With a task's `progress`, the cells (numbers or (n,)) in which the choice was made move its state on.
    """
    if progress is not None:
        applied, after = after_choice(kind, late, memory % progress.base, chosen)
        return applied, progress(memory, cells).astype(np.int64) * progress.base + after
    if kind is None:
        return (memory, chosen) if late else (chosen, 0 * chosen)
    classes = int(kind.max()) + 1
    if late:
        applied = memory // classes
        return applied, chosen * classes + kind[applied]
    return chosen, kind[chosen]
