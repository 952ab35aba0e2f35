"""The game over nodes (cell, memory) in which the input that is chosen acts one sample later.

A node is a cell k of the measured state, the input p that acts now, and the class c of the input before p where the
plant remembers it (one class where it does not). The controller chooses the next input u before it knows more:

    (k, p, c)  --u-->  (k', u, class of p)   for every k' in the box of (k, p) in class c.

Write A(c, k) for the inputs p with (k, p, c) in a set of nodes. One step stays in the set with exactly the inputs in

    AND of A(class of p, k') over k' in the box of (k, p) in class c.

To reach: level 0 are the nodes of the target; any other node is won at level l when its cell is free, the path of p
from it is clear, and that AND over the nodes of levels below l is not empty. Its admissible inputs are that AND at its
own level. To hold: the largest set of nodes in the safe cells for which none of these ANDs is empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simgap.errors import UserError
from simgap.geometry import Grid
from simgap.synthesis.abstraction import Abstraction
from simgap.synthesis.pending_boxes import NONE, SOME, Bytes, Words, bytes_of, clear_paths, common_inputs, words_of

Flags = NDArray[np.bool_]
LARGEST_NODES = 1_500_000_000
"""Most bytes of the nodes' sets of inputs, levels and flags together."""


def bytes_of_nodes(cells: int, inputs: int, classes: int = 1) -> int:
    """Memory that a game takes: sets of inputs, levels and flags."""
    return classes * cells * inputs * (8 * (-(-inputs // 64)) + 8)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Sets of nodes and their inputs.

    Attributes:
        inside: (classes, cells, M) bool, nodes of the set.
        sets: (classes, cells, M, words) admissible inputs of each node, meaningless outside.
        value: (classes, cells, M) int32 levels, -1 outside; None where nothing is to be reached.
        rounds: levels, or passes until nothing changed.
    """

    inside: Flags
    sets: Words
    value: NDArray[np.int32] | None
    rounds: int

    def mask(self) -> Bytes:
        """Admissible inputs as packed bytes, row (cell * M + pending) * classes + class: none in the target."""
        classes, cells, inputs = self.inside.shape
        rows = np.moveaxis(self.sets, 0, 2).reshape(cells * inputs * classes, -1)
        mask = bytes_of(rows, inputs)
        serving = self.inside if self.value is None else self.value > 0
        mask[~np.moveaxis(serving, 0, 2).reshape(-1)] = 0
        return mask


@dataclass(frozen=True, eq=False)
class PendingGame:
    """Boxes of a plant whose inputs act one sample late.

    Attributes:
        boxes: abstractions on the same cells and inputs, one for each class of the input before the pending one.
        kind: (M,) class of each input.
        threads: rows are shared among this many threads; results do not depend on it.
    """

    boxes: tuple[Abstraction, ...]
    kind: NDArray[np.int64]
    threads: int = 1

    @staticmethod
    def of(abstraction: Abstraction, threads: int = 1) -> PendingGame:
        """A plant that remembers no input."""
        return PendingGame((abstraction,), np.zeros(len(abstraction.inputs), np.int64), threads)

    def __post_init__(self) -> None:
        needed = bytes_of_nodes(self.grid.size, self.inputs, len(self.boxes))
        if needed > LARGEST_NODES:
            raise UserError(
                f"{self.grid.size} cells with {self.inputs} pending inputs are too many for a controller with latency: "
                f"{needed / 1e9:.1f} GB of nodes, at most {LARGEST_NODES / 1e9:.1f} GB",
                key="synthesis.cells",
                remedy="Use fewer cells or inputs",
            )

    @property
    def grid(self) -> Grid:
        """The cells."""
        return self.boxes[0].grid

    @property
    def inputs(self) -> int:
        """M."""
        return len(self.boxes[0].inputs)

    @cached_property
    def _shape(self) -> tuple[int, int, int]:
        return len(self.boxes), self.grid.size, self.inputs

    def nodes(self, cells: Flags) -> Flags:
        """All nodes of some cells: (cells,) -> (classes, cells, M)."""
        return np.broadcast_to(cells[None, :, None], self._shape).copy()

    def able(self, free: Flags) -> Flags:
        """Nodes in free cells whose pending input takes a clear path from there: (cells,) -> (classes, cells, M)."""
        out = self.nodes(free)
        for own, a in zip(out, self.boxes, strict=True):
            if a.swept is not None:
                own &= clear_paths(a.grid, a.shape, a.swept, free)
        return out

    def reach(self, target: Flags, free: Flags) -> Nodes:
        """Nodes from which `target` (classes, cells, M) is reached through free cells (cells,), level by level."""
        able = self.able(free)
        value = np.where(target & free[None, :, None], 0, -1).astype(np.int32)
        allowed = words_of(value == 0)
        news: Flags = np.any(allowed, axis=-1)
        sets = np.zeros((*self._shape, allowed.shape[-1]), np.uint64)
        level = 0
        while news.any():
            level += 1
            new = self._state(allowed, news, able & (value < 0), sets) == SOME
            value[new] = level
            added = words_of(new)
            allowed |= added
            news = np.any(added, axis=-1)
        return Nodes(value >= 0, sets, value, int(value.max(initial=0)))

    def hold(self, safe: Flags) -> Nodes:
        """The largest set of nodes of safe cells (cells,) that can be held for ever."""
        inside = self.able(safe)
        news = np.ones(self._shape[:2], np.bool_)
        sets = np.zeros((*self._shape, -(-self.inputs // 64)), np.uint64)
        rounds = 0
        while news.any():
            rounds += 1
            lost = self._state(words_of(inside), news, inside, sets) == NONE
            inside &= ~lost
            news = lost.any(axis=-1)
        return Nodes(inside, sets, None, rounds)

    def _state(self, allowed: Words, news: Flags, todo: Flags, sets: Words) -> NDArray[np.uint8]:
        flags, look = news.view(np.uint8), todo.view(np.uint8)
        every = zip(self.boxes, look, sets, strict=True)
        return np.stack([common_inputs(a, self.kind, allowed, flags, own, s, self.threads) for a, own, s in every])
