"""Invariance when the controller sees a measurement with bounded error, of this sample or of the one before.

Let W be a set of cells of the true state and adm(k) the inputs that keep every successor of cell k in W. Whatever the
controller does, it knows that the true state is in W, since it kept it there. So with a measurement in cell y,

    latency 0:  any input in   I(y) = AND of adm(k) over the cells k of W within the error of y,
    latency 1:  any input in   I(y, p) = AND of adm(k'') over the boxes of (k, p), k within the error of y, p in adm(k),

where y is the measurement of the sample before and p the input applied since; in the first sample, before any
measurement has arrived, p is an input that the case names. If no I is empty, the true state stays in W for ever. Where
one is empty, latency 0 drops the cells that share it from W, and latency 1 forbids p in them; both repeat from a
maximal invariant set until nothing is empty. The result is sound; it need not be the largest, because such sets are not
closed under union.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.errors import UserError
from simgap.geometry import Grid
from simgap.specifications.solution import Solution
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.games.game import CellGame
from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.pending import NONE, common_inputs
from simgap.synthesis.input_sets import (
    LARGEST_TABLES,
    Words,
    crop,
    embed,
    every_input,
    margins,
    packed_width,
    padded,
    to_bytes,
    to_words,
    unpack,
    window_and,
    words_of,
)


@dataclass(frozen=True, eq=False)
class TrueGame(CellGame):
    """The game on cells of the true state, of which the controller knows a measurement: it can only hold sets.

    Attributes:
        blur: bound of the measurement error, (nx,), for which the boxes do not account.
        latency: whole samples between a measurement and its input; first: the input that acts until then.
    """

    blur: Floats = field(kw_only=True)
    latency: int = field(kw_only=True)
    first: int = 0

    def invariant(self, safe: Bools) -> Solution:
        """A controlled invariant set in (cells,) that measurements suffice to keep; sound, not always the largest."""
        return sensed_invariance(self.boxes[0], self.blur, self.latency, self.threads, safe, self.first)

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


def sensed_invariance(
    abstraction: Abstraction,
    error: Floats,
    latency: int,
    threads: int = 1,
    allowed: Bools | None = None,
    first: int = 0,
) -> Solution:
    """A controller for measurements within `error` (nx,) of the true state, `latency` 0 or 1 samples old.

    Args:
        abstraction: of the true state, without measurement error; its post holds every successor.
        error: bound of |measured - true| per state.
        latency: whole samples.
        threads: rows are shared among this many threads.
        allowed: true cells to stay in, (cells,); all of them when None.
        first: with latency 1, the input that acts in the first sample.

    Returns:
        Solution on a grid of measurements, larger than the abstraction's by the error. `winning` are cells of the true
        state in which a run may start. With latency 1, `memory` is M: the pending input.

    Raises:
        UserError: when the table of inputs would outgrow memory, or the latency is not supported.
    """
    grid, inputs = abstraction.grid, len(abstraction.inputs)
    if latency not in (0, 1):
        raise UserError(f"a latency of {latency} samples is not supported", key="sensing.latency", remedy="Use 0 or 1")
    if latency and grid.size * inputs * packed_width(inputs) > LARGEST_TABLES:
        raise UserError(
            f"{grid.size} cells with {inputs} pending inputs are too many for a controller with latency",
            key="synthesis.cells",
            remedy="Use fewer cells or inputs",
        )
    margin, safe = margins(grid, error), np.ones(grid.size, np.bool_) if allowed is None else allowed
    if latency:
        return _with_latency(abstraction, margin, threads, safe, first)
    return _without_latency(abstraction, margin, threads, safe)


def _shared(sets: Words, inside: Bools, grid: Grid, margin: tuple[int, ...], inputs: int) -> Words:
    """I(y) on the padded grid from the sets of the true cells; empty where no cell of W is near."""
    larger, full = padded(grid, margin), every_input(inputs)
    shared = window_and(embed(np.where(inside[:, None], sets, full), grid, larger, full), larger, margin)
    shared[~_near(inside, grid, margin)] = 0
    return shared


def _unserved(shared: Words, near: Bools, grid: Grid, margin: tuple[int, ...]) -> Bools:
    """True cells some of whose measurements leave no input, (cells,)."""
    larger = padded(grid, margin)
    served = (shared.any(axis=1) | ~near).astype(np.uint64)[:, None]
    return crop(window_and(served, larger, margin), grid, larger)[:, 0] == 0


def _near(inside: Bools, grid: Grid, margin: tuple[int, ...]) -> Bools:
    """Measured cells within the error of some cell of W, (padded cells,)."""
    larger = padded(grid, margin)
    far = embed((~inside[:, None]).astype(np.uint64), grid, larger, np.ones(1, np.uint64))
    return window_and(far, larger, margin)[:, 0] == 0


def _without_latency(abstraction: Abstraction, margin: tuple[int, ...], threads: int, free: Bools) -> Solution:
    grid, inputs = abstraction.grid, len(abstraction.inputs)
    larger = padded(grid, margin)
    safe, rounds = free, 0
    while True:
        rounds += 1
        found = invariance(abstraction, safe, threads)
        shared = _shared(to_words(found.mask), found.winning, grid, margin, inputs)
        bad = found.winning & _unserved(shared, _near(found.winning, grid, margin), grid, margin)
        if not bad.any():
            break
        safe = found.winning & ~bad
    return Solution(
        grid=larger,
        winning=_flags(found.winning, grid, larger),
        mask=to_bytes(shared, inputs),
        free=_flags(free, grid, larger),
        statistics={"rounds": rounds, "pairs": found.pairs},
    )


def _with_latency(abstraction: Abstraction, margin: tuple[int, ...], threads: int, free: Bools, first: int) -> Solution:
    grid, inputs = abstraction.grid, len(abstraction.inputs)
    larger, full = padded(grid, margin), every_input(inputs)
    allowed = to_words(invariance(abstraction, free, threads).mask)
    rounds = 0
    while True:
        rounds += 1
        after = _after(abstraction, allowed, threads).reshape(grid.size, -1)
        after = window_and(embed(after, grid, larger, np.tile(full, inputs)), larger, margin)
        served: Bools = np.any(after.reshape(larger.size, inputs, -1), axis=2)
        fine = crop(window_and(words_of(served), larger, margin), grid, larger)
        if np.array_equal(fine & allowed, allowed):
            break
        allowed &= fine
    possible = ~window_and(embed(~allowed, grid, larger, ~np.zeros_like(full)), larger, margin)
    table = after.reshape(larger.size, inputs, -1) * unpack(to_bytes(possible, inputs), inputs)[:, :, None]
    return Solution(
        grid=larger,
        winning=_flags(unpack(to_bytes(allowed, inputs), inputs)[:, first], grid, larger),
        mask=to_bytes(table.reshape(larger.size * inputs, -1), inputs),
        free=_flags(free, grid, larger),
        memory=inputs,
        first=first,
        late=True,
        statistics={"rounds": rounds},
        acting=to_bytes(embed(allowed, grid, larger, np.zeros(allowed.shape[1], np.uint64)), inputs),
    )


def _flags(values: Bools, grid: Grid, larger: Grid) -> Bools:
    return embed(values.astype(np.uint64)[:, None], grid, larger, np.zeros(1, np.uint64))[:, 0] == 1


def _after(abstraction: Abstraction, allowed: Words, threads: int) -> Words:
    """AND of `allowed` over the box of every (cell, allowed input), all inputs elsewhere: -> (cells, M, words)."""
    inputs = len(abstraction.inputs)
    sets = np.tile(every_input(inputs), (len(allowed), inputs, 1))
    todo = unpack(to_bytes(allowed, inputs), inputs).view(np.uint8)
    one_class, news = np.zeros(inputs, np.int64), np.ones((1, len(allowed)), np.uint8)
    state = common_inputs(abstraction, one_class, allowed[None], news, todo, sets, threads)
    sets[state == NONE] = 0
    return sets
