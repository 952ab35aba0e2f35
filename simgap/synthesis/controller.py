"""A synthesised controller, asked for an input at a state in one line.

    u = load_controller("controller.npz").input(x)          # simgap.io.controller_file

A controller with a sample of latency is told which input acts now, by its number; `input(x, pending)` is what to apply
one sample later. Without `pending` it is asked for the first time, while the input `first` acts.

Every admissible input keeps the promise of the specification, so which of them is applied is a matter of taste. The
default rule is `least_effort`: the input of smallest sum of squares, each input scaled by its largest magnitude, ties
broken by the order of the input set. `middle` takes the median of the admissible inputs in that order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.errors import BrokenPromise, UserError
from simgap.geometry import Grid
from simgap.specifications.solution import Progress, Solution
from simgap.synthesis.input_sets import preferred, unpack

RULES = ("least_effort", "middle")
FARTHEST = 1e9
"""Cells from the lower end of the box: an angle farther away is no measurement, whatever cell it would wrap into."""


@dataclass(frozen=True, eq=False)
class Controller:
    """Static map from measured states (and the pending input, if there is latency) to admissible inputs.

    Attributes:
        input_set: U, (M, nu).
        states, input_names: names in order.
        solution: winning domain, admissible inputs and, for reach-avoid, the value function.
        rule: how one admissible input is chosen.
        metadata: what made it; plain JSON values.
    """

    input_set: Floats
    states: tuple[str, ...]
    input_names: tuple[str, ...]
    solution: Solution
    rule: str
    metadata: dict[str, Any]

    def __post_init__(self) -> None:
        if self.solution.chosen is not None and self.rule != RULES[0]:
            raise UserError(f"one input a cell is recorded by the rule '{RULES[0]}', not by '{self.rule}'")
        if self.rule not in RULES:
            raise UserError(f"no selection rule '{self.rule}'", remedy=f"Known rules: {', '.join(RULES)}")

    @property
    def grid(self) -> Grid:
        """Cells of the measured state."""
        return self.solution.grid

    @property
    def memory(self) -> int:
        """1, or M where the pending input is part of the controller's state."""
        return self.solution.memory

    @property
    def first(self) -> int:
        """The memory before the first sample: the input that acts in it, where there is latency."""
        return self.solution.first

    @property
    def late(self) -> bool:
        """True if an input acts one sample after it is chosen."""
        return self.solution.late

    @property
    def progress(self) -> Progress | None:
        """What a task has come to, which is part of the memory; None for other specifications."""
        return self.solution.progress

    @property
    def kind(self) -> Ints | None:
        """Class of each input, (M,), where the class of the previous input is remembered."""
        return self.solution.kind

    @cached_property
    def choice(self) -> NDArray[np.int16]:
        """The input that the rule picks, (cells * memory,), -1 where there is none; row cell * memory + pending."""
        if self.solution.chosen is not None:
            return self.solution.chosen
        if self.solution.mask.shape[1] == 0:
            raise RuntimeError("the admissible inputs of this controller were not read")
        if self.rule == "middle":
            return _middle(self.solution.mask, len(self.input_set))
        return preferred(self.solution.mask, least_effort(self.input_set))

    def __getstate__(self) -> dict[str, Any]:
        """State that another process gets: the choices go along, so that they are made once."""
        return {**vars(self), "choice": self.choice}

    def cell(self, x: ArrayLike) -> Ints:
        """Cells of measured states: (n, nx) or (nx,) -> (n,), -1 outside, and farther away than turns can be counted.

        Raises:
            UserError: for another number of states than this controller has, or one that is no finite number.
        """
        points = np.atleast_2d(np.asarray(x, dtype=np.float64))
        if points.ndim != 2 or points.shape[1] != self.grid.box.size:
            names = ", ".join(self.states)
            raise UserError(f"a state is {self.grid.box.size} numbers ({names}), not of shape {np.shape(x)}")
        if not np.isfinite(points).all():
            raise UserError(
                f"a state must be finite numbers, not {points[~np.isfinite(points).all(axis=1)][0].tolist()}"
            )
        with np.errstate(over="ignore"):  # the operations of an export, in their order: both agree on every bit
            place = (points - self.grid.box.lo) / (2.0 * self.grid.h)
        far = np.any(np.abs(place) >= FARTHEST, axis=1, keepdims=True)
        return np.where(far[:, 0], -1, self.grid.index(np.where(far, self.grid.box.lo, points)))

    def rows(self, x: ArrayLike, pending: ArrayLike | None = None) -> Ints:
        """Rows of `choice` and of the mask: measured states (n, nx), pending inputs (n,) -> (n,), -1 outside.

        Without `pending`, nothing has been chosen yet.
        """
        cells = self.cell(x)
        known = np.asarray(self.first if pending is None else pending)
        if known.dtype.kind not in "iu":
            raise UserError(f"the pending input is the number of an input, not {pending!r:.60}")
        if not np.all((known >= 0) & (known < self.memory)):
            raise UserError(f"the pending input is a number from 0 to {self.memory - 1}, not {pending!r:.60}")
        return np.where(cells >= 0, cells * self.memory + known, -1)

    def lookup(self, x: ArrayLike, pending: ArrayLike | None = None) -> Ints:
        """Chosen input numbers: (n, nx), (n,) -> (n,), -1 where the controller has none."""
        rows = self.rows(x, pending)
        return np.where(rows >= 0, self.choice[rows], -1).astype(np.int64)

    def input(self, x: ArrayLike, pending: int | None = None) -> Floats:
        """The input to apply at the measured state (nx,) -> (nu,), a sample later where there is latency.

        Raises:
            BrokenPromise: outside the winning domain, or in the target, where the task is done.
            UserError: for what is no state of this controller.
        """
        m = int(self._of_one(x, self.lookup(x, pending)))
        if m < 0:
            raise BrokenPromise(
                f"the controller has no input at {np.asarray(x).tolist()}",
                "Where `lookup` gives -1 there is none.",
            )
        return self.input_set[m].copy()

    def step(self, x: ArrayLike, memory: int | None = None) -> tuple[Floats, int]:
        """The input of `input` at x (nx,), and the memory for the next sample; without `memory` at the first one.

        Raises:
            BrokenPromise, UserError: as `input`.
        """
        known = self.first if memory is None else memory
        chosen = self.input(x, known)
        _, after = self.solution.step(known, int(self.lookup(x, known)[0]), int(self.cell(x)[0]))
        return chosen, int(after)

    def inputs(self, x: ArrayLike, pending: int | None = None) -> Floats:
        """All admissible inputs at a measured state (nx,) -> (k, nu), k = 0 outside the winning domain."""
        row = int(self._of_one(x, self.rows(x, pending)))
        if row < 0:
            return self.input_set[:0]
        count = len(self.input_set)
        return self.input_set[unpack(self.solution.admitted(count, [row])[0], count)]

    def _of_one(self, x: ArrayLike, answers: Ints) -> np.int64:
        if np.ndim(x) != 1:
            raise UserError(
                f"one state is asked about, not an array of shape {np.shape(x)}", remedy="`lookup` takes many."
            )
        return np.int64(answers[0])

    def contains(self, x: ArrayLike) -> Bools:
        """True where a run may start, in the winning domain: measured states (n, nx) -> (n,)."""
        cells = self.cell(x)
        return np.where(cells >= 0, self.solution.winning[cells], False)

    def in_target(self, x: ArrayLike) -> Bools:
        """True where measured states are in a target cell, whatever is pending: (n, nx) -> (n,)."""
        cells, ended = self.cell(x), self.solution.ended
        return np.where(cells >= 0, ended[cells], False)

    def value(self, x: ArrayLike, pending: ArrayLike | None = None) -> Ints:
        """Worst-case steps to the target: (n, nx), pending inputs (n,) -> (n,), -1 where losing or outside."""
        if self.solution.value is None:
            raise UserError("an invariance controller has no value function")
        rows = self.rows(x, pending)
        return np.where(rows >= 0, self.solution.value[rows], -1).astype(np.int64)


def least_effort(inputs: Floats) -> Ints:
    """Input numbers from least to most effort: (M, nu) -> (M,)."""
    scale = np.maximum(np.abs(inputs).max(axis=0), 1e-300)
    effort = np.round(((inputs / scale) ** 2).sum(axis=1), 12)  # so that +u and -u tie whatever their last bits
    return np.argsort(effort, kind="stable")


def _middle(mask: NDArray[np.uint8], inputs: int) -> NDArray[np.int16]:
    out = np.full(len(mask), -1, np.int16)
    for first in range(0, len(mask), 65536):
        bits = unpack(mask[first : first + 65536], inputs)
        ranks, count = np.cumsum(bits, axis=1), bits.sum(axis=1)
        median = np.argmax(ranks >= ((count + 1) // 2)[:, None], axis=1)
        out[first : first + 65536] = np.where(count > 0, median, -1)
    return out
