"""One-step margins: by how much gamma could grow at a winning cell before no admissible input keeps it there.

At a losing cell it is the other way round: how narrow gamma would have to be for it to win.

With gamma = [lo, hi] over the cell, half-width w = (hi - lo) / 2, and an admissible input m, the successor box of the
cell is that of f, moved by lo and hi (`post`). The margin of a cell is

    factor = max over m of the largest s such that the box, grown by (s - 1) w on both sides along every axis,

still covers winning cells only. Admissible are the controller's inputs: towards a target those that go down a level.
Where the class of the previous input is remembered, gamma and the inputs are those after an input of one class, and the
cells that are covered have to win after an input of the class of m. Where inputs are late, the box is that of the input
that acts now, and the cells that are covered have to win with m to act next.

A controller that keeps cells of the true state by measurements with an error takes an input of the measured cell,
whichever the measurement is. The margin of a true cell is then the least over the measured cells y that its states may
be measured in, with m admitted at y:

    factor = min over y of max over m of the largest s such that ...

A cell that loses has a factor below 1: the largest s for which the box of some input of U covers winning cells only.
Where there is none, not even at s = 0, gamma is not what loses the cell: the cell is too large if the box of its centre
alone would fit at s = 0; if that does not fit either, the cells that it leads to are lost. Where the box fits at s = 1,
the cell is lost to what is asked beside it: the path between samples, or what a measurement leaves open.

It is a statement about one cell and one step: gamma has grown at this cell alone and the winning domain is the old one.
Where gamma grows everywhere, cells may be lost sooner, since those that they rely on are lost first. What the path
between samples touches is not asked again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgap.arrays import Bools, Floats, Ints
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapFunction
from simgap.geometry import Grid, mesh
from simgap.late import njit
from simgap.model.compile import cached_kernel
from simgap.model.sampled import NominalModel
from simgap.plants.context import Context
from simgap.specifications.base import specification_of
from simgap.specifications.solution import Solution
from simgap.specifications.space import Space
from simgap.synthesis.abstraction.cells import count_holes, layout
from simgap.synthesis.abstraction.post import Frame, Kernel, cell_box, image, to_cells, without_ends
from simgap.synthesis.input_sets import (
    LARGEST_TABLES,
    crop,
    embed,
    every_input,
    padded,
    to_bytes,
    to_words,
    unpack,
    window_and,
)
from simgap.synthesis.input_sets import margins as cells_of_error

LARGEST_FACTOR = 1e4
"""Factors are looked for up to here; a margin that reaches it is at least that."""
RESOLUTION = 2e-3
"""Relative accuracy of a margin, which is rounded down."""
LAYERS = 3
"""Headings that are looked at where classes are remembered: each costs a robot 3 CPU s."""


@njit(inline="always", error_model="numpy")
def _grown(shape, n, tables, c, lo, hi, by, size, header, work):  # type: ignore[no-untyped-def]
    """True if the cells in which [lo, hi], grown by size * by on both sides, can be measured lie in the set c.

    `work` holds 2n numbers. Written into its callers: to pass so many arrays would cost more than the look-up.
    """
    fits = True
    for j in range(n):
        first, last = to_cells(lo[j] - size * by[j], hi[j] + size * by[j], j, n, header)
        cells = shape[0, j]
        if shape[1, j] == 0:
            if first < 0 or last >= cells:
                fits = False
                break
        elif last - first >= cells:
            first, last = 0, cells - 1
        else:
            turns = cells * (first // cells)
            first, last = first - turns, last - turns
        work[j], work[n + j] = first * shape[3, j], (last + 1) * shape[3, j]
    if fits:
        total = 0
        for corner in range(1 << n):
            sign, index = 1, 0
            for j in range(n):
                if corner >> j & 1:
                    sign = -sign
                    index += work[j]
                else:
                    index += work[n + j]
            total += sign * tables[c, index]
        fits = total == 0
    return fits


@njit(cache=True, nogil=True, error_model="numpy")
def _largest(shape, n, tables, c, lo, hi, by, best, most, header, work):  # type: ignore[no-untyped-def]
    """Largest size in (best, most] whose box fits, rounded down; `best` if none is larger by the resolution.

    A `best` below 0 says that nothing is known to fit, not even the box itself.
    """
    if best < 0.0 and not _grown(shape, n, tables, c, lo, hi, by, 0.0, header, work):
        return best
    low, high = max(max(best, 0.0) * (1.0 + RESOLUTION), most * 1e-9), most
    if not _grown(shape, n, tables, c, lo, hi, by, low, header, work):
        return max(best, 0.0)
    if _grown(shape, n, tables, c, lo, hi, by, most, header, work):
        return most
    while high > low * (1.0 + RESOLUTION):
        size = np.sqrt(low * high)
        if _grown(shape, n, tables, c, lo, hi, by, size, header, work):
            low = size
        else:
            high = size
    return low


@njit(inline="always", error_model="numpy")
def _placed(m, boxes, shift, spare):  # type: ignore[no-untyped-def]
    """The box of input m, moved to its cell."""
    for j in range(shift.size):
        spare[0, j], spare[1, j] = boxes[0, m, j] + shift[j], boxes[1, m, j] + shift[j]


@njit(cache=True, nogil=True, error_model="numpy")
def _of_inputs(  # type: ignore[no-untyped-def]
    most, admitted, liked, boxes, shift, spare, kind, shape, tables, header, work
):  # fmt: skip
    """Largest growth over the admitted inputs (bytes): what served the last cell best rarely leaves more to find.

    `liked` (1,) holds that input.
    """
    best, n = -1.0, shift.size
    for turn in range(-1, kind.size):
        m = liked[0] if turn < 0 else turn
        if (turn == liked[0]) or not admitted[m >> 3] >> (m & 7) & 1:
            continue
        _placed(m, boxes, shift, spare)
        own = _largest(shape, n, tables, kind[m], spare[0], spare[1], boxes[2, m], best, most, header, work)
        if own > best:
            best, liked[0] = own, m
        if best >= most:
            break
    return best


@njit(cache=True, nogil=True)
def _others(index, reach, wide, wraps, seen, common, rows):  # type: ignore[no-untyped-def]
    """Number of measurements of a cell; what each admits beyond what all of them do goes into `rows`.

    None where some measurement admits no more than that: the largest margin of the common inputs is then the cell's.
    """
    n, total = index.size, 1
    for j in range(n):
        total *= 2 * reach[j] + 1
    for number in range(total):
        rest, flat, stride = number, 0, 1
        for j in range(n - 1, -1, -1):
            off = rest % (2 * reach[j] + 1)
            rest //= 2 * reach[j] + 1
            at = (index[j] + off - reach[j]) % wide[j] if wraps[j] else index[j] + off
            flat += at * stride
            stride *= wide[j]
        some = False
        for b in range(common.size):
            rows[number, b] = seen[flat, b] & ~common[b]
            some |= rows[number, b] != 0
        if not some:
            return 0
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _worst_measurement(  # type: ignore[no-untyped-def]
    rows, found, best, most, boxes, shift, spare, kind, shape, tables, header, work, score
):  # fmt: skip
    """The least over measurements of the largest over their inputs, where `best` is that of the common inputs."""
    for m in range(kind.size):
        score[m] = -2.0
    worst = most
    for y in range(found):
        own = best
        for m in range(kind.size):
            if rows[y, m >> 3] >> (m & 7) & 1:
                if score[m] == -2.0:
                    _placed(m, boxes, shift, spare)
                    score[m] = _largest(
                        shape, shift.size, tables, kind[m], spare[0], spare[1], boxes[2, m], best, most, header,
                        work,
                    )  # fmt: skip
                own = max(own, score[m])
                if own >= worst:
                    break
        worst = min(worst, own)
    return worst


@cache
def searcher(image_of_box: Kernel, gap: Kernel) -> Any:
    """numba: the loop over cells; boxes are computed once for all cells that differ along axes that do not matter."""

    @cached_kernel
    def search(  # type: ignore[no-untyped-def]
        cells, rest, strides, free, header, inputs, kind, shape, tables, inside, mask, reach, wide, seen, base, whole,
        factor
    ):  # fmt: skip
        """`base`: 1 to grow gamma, 0 to grow it from its middle. `whole`: of the cells, or of their centres.

        `mask`: (cells, bytes), or one row for all of them.
        """
        n, count = cells.shape[1], inputs.shape[0]
        boxes, box, ranges = np.empty((3, count, n)), np.empty((3, n)), np.empty((2, n))
        work, spare, score = np.empty(2 * n, np.int64), np.empty((2, n)), np.empty(count)
        liked, index, shift = np.zeros(1, np.int64), np.empty(n, np.int64), np.empty(n)
        window, found, most = 1, 0, LARGEST_FACTOR - 1.0 if base > 0.0 else 1.0
        for j in range(n):
            window *= 2 * reach[j] + 1
        rows = np.empty((window, mask.shape[1]), np.uint8)
        for r in range(cells.shape[0]):
            cell_box(cells[r], n, free, box[0], box[1])
            if not whole:
                for j in range(n):
                    box[0, j] = box[1, j] = 0.5 * (box[0, j] + box[1, j])
            for m in range(count):
                image_of_box(box[0], box[1], inputs[m], n, boxes[0, m], boxes[1, m], box[2])
                gap(box[0], box[1], inputs[m], ranges[0], ranges[1])
                for j in range(n):
                    boxes[2, m, j] = 0.5 * (ranges[1, j] - ranges[0, j])
                    inward = 0.0 if base > 0.0 else boxes[2, m, j]
                    boxes[0, m, j] += ranges[0, j] + inward
                    boxes[1, m, j] += ranges[1, j] - inward
            for t in range(rest.shape[0]):
                flat = 0
                for j in range(n):
                    index[j] = cells[r, j] + rest[t, j]
                    shift[j] = header[n + j] * rest[t, j]
                    flat += index[j] * strides[j]
                if not inside[flat]:
                    continue
                own = mask[flat if mask.shape[0] > 1 else 0]
                if window > 1:
                    found = _others(index, reach, wide, shape[1], seen, own, rows)
                best = _of_inputs(most, own, liked, boxes, shift, spare, kind, shape, tables, header, work)
                if found:
                    best = _worst_measurement(
                        rows, found, best, most, boxes, shift, spare, kind, shape, tables, header, work, score
                    )
                if best >= 0.0:
                    factor[flat] = base + best

    return search


NOTHING, GAMMA, CELLS, AROUND, BESIDE, ASKED = range(6)
CAUSES = ("nothing", "gamma", "cells", "the cells around it", "path or measurement", "the specification")
"""What a cell is lost to: nothing, for one that wins, is forbidden or is not looked at; gamma, at its factor; the size
of the cells; the loss of cells that it leads to; what is asked beside one step from a cell; what a run must not begin
with."""


@dataclass(frozen=True, eq=False)
class Margins:
    """Margins of cells, NaN where a cell is the goal or forbidden.

    Attributes:
        factor: (cells,) on gamma's half-width, at most `LARGEST_FACTOR`; below 1 where a cell loses by gamma, NaN where
            it loses by something else.
        loses_by: (cells,) what a cell loses by, one of `CAUSES`.
        only: of which cells, where it is not all of them, as words.
    """

    factor: NDArray[np.float32]
    loses_by: NDArray[np.uint8]
    only: str = ""

    def joined(self, other: Margins) -> Margins:
        """These margins, and those of another one at the cells that these do not know."""
        new = np.isnan(self.factor) & (self.loses_by == NOTHING)
        return replace(
            self,
            factor=np.where(new, other.factor, self.factor),
            loses_by=np.where(new, other.loses_by, self.loses_by),
        )


@dataclass(frozen=True, eq=False)
class Remembered:
    """Memory of a controller: the class of the previous input, the input that acts now, or both.

    Attributes:
        winning: (cells, C) bool, sets of cells that win, each with something that is remembered there.
        kind: (M,) in which of them the successors have to be when an input was chosen.
        acting: the input that acts whatever is chosen, where inputs are late; None where the chosen one does.
    """

    winning: Bools
    kind: Ints
    acting: int | None = None


def shown_layers(cells: int, count: int = 6) -> Ints:
    """At most `count` indices spread over an axis of so many cells, the first included."""
    return np.unique((np.arange(count) * cells) // count)


def one_step_margins(
    model: NominalModel,
    grid: Grid,
    inputs: Floats,
    gap: Kernel,
    winning: Bools,
    mask: NDArray[np.uint8],
    gap_axes: Sequence[int] | None = None,
    error: ArrayLike | None = None,
    remembered: Remembered | None = None,
    reach: tuple[int, ...] | None = None,
    losing: Bools | None = None,
) -> Margins:
    """Margins of the cells that win and have an input, and what losing ones lose by.

    Args:
        model: nominal map f; grid: cells of the measured state, or of the true one with a `reach`.
        inputs: U, (M, nu).
        gap: kernel of the bound; gap_axes: state axes on which it depends, all when None.
        winning: (cells,) bool, those of which to find it; mask: (cells, ceil(M / 8)) packed admissible inputs, of the
            measured cells (`padded` by the reach) where there is one.
        error: bound of the measurement error that boxes account for, (nx,).
        remembered: where successors must win, if that is not where margins are asked for: gap, winning and mask are
            then of one thing that the controller may remember.
        reach: cells to either side in which a true state may be measured, per axis.
        losing: (cells,) bool, those of which to say what they lose by; none when None.
    """
    n, nothing, count = grid.box.size, np.zeros(grid.box.size), len(inputs)
    known = Remembered(winning[:, None], np.zeros(count, np.int64)) if remembered is None else remembered
    errors = nothing if error is None else np.asarray(error, dtype=np.float64)
    acts = inputs if known.acting is None else np.repeat(inputs[[known.acting]], count, axis=0)
    frame = Frame(grid, np.ascontiguousarray(acts, dtype=np.float64), errors)
    on = {j for i in range(n) for axes in (model.offset_axes[i], *model.jacobian_axes[i]) for j in axes}
    on |= set(range(n)) if gap_axes is None else set(gap_axes)
    others = tuple(j for j in range(n) if j not in on)
    shape = layout(grid.cells, grid.periodic)
    tables = np.stack([count_holes(own, shape, n) for own in known.winning.T])
    header = frame.header
    free = without_ends(header, np.array([j in on for j in range(n)]))
    search = searcher(image(model.interval_kernel, model.jacobian_interval_kernel), gap)
    strides = np.array([int(np.prod(grid.cells[j + 1 :])) for j in range(n)])
    cells = _looked_at(grid, others, winning if losing is None else winning | losing)
    about = cells, _offsets(grid, others), strides, free, header, frame.inputs, known.kind, shape, tables

    def found(inside: Bools, seen: tuple[Any, ...], base: float, whole: bool) -> Floats:
        factor = np.full(grid.size, np.nan)
        search(*about, inside.astype(np.uint8), *seen, base, whole, factor)
        return factor

    factor = found(winning, _measured(grid, mask, count, (0,) * n if reach is None else reach), 1.0, True)
    loses_by = np.full(grid.size, NOTHING, np.uint8)
    if losing is not None:
        every = _measured(grid, to_bytes(every_input(count)[None], count), count, (0,) * n)
        narrower = found(losing, every, 0.0, True)
        centres = found(losing & np.isnan(narrower), every, 0.0, False)
        loses_by[losing] = AROUND
        loses_by[centres >= 0.0] = CELLS
        loses_by[narrower >= 0.0] = GAMMA
        loses_by[narrower >= 1.0] = BESIDE
        factor = np.where(loses_by == GAMMA, narrower, factor)
    return Margins(_rounded_down(factor), loses_by)


def _looked_at(grid: Grid, others: tuple[int, ...], inside: Bools) -> Ints:
    """Indices of the cells whose boxes are computed, for all that differ along the `others` alone: (k, nx), 0 there."""
    some = inside.reshape(grid.cells).any(axis=others, keepdims=True)
    return np.stack(np.nonzero(some), axis=1)


def _measured(grid: Grid, mask: NDArray[np.uint8], inputs: int, reach: tuple[int, ...]) -> tuple[Any, ...]:
    """Inputs that all measurements of a cell admit, and those of each: (cells, bytes), reach, cells, (measured, bytes).

    An input that all of them admit serves whatever is measured; more is asked only where the others differ.
    """
    larger = padded(grid, reach)
    sizes = np.array(reach, np.int64), np.array(larger.cells, np.int64)
    if not any(reach):
        return (mask, *sizes, mask)
    common = crop(window_and(to_words(mask), larger, reach), grid, larger)
    return (to_bytes(common, inputs), *sizes, np.ascontiguousarray(mask))


def _rounded_down(values: Floats) -> NDArray[np.float32]:
    """Half the memory, never a larger number, whatever the shape (...)."""
    short = values.astype(np.float32)
    return np.where(short > values, np.nextafter(short, np.float32(0)), short)


def _offsets(grid: Grid, axes: tuple[int, ...]) -> Ints:
    """Indices along `axes` of all cells that differ along these alone: (k, nx)."""
    return mesh(*(np.arange(c if j in axes else 1) for j, c in enumerate(grid.cells)))


def margins_of(context: Context, gap: GapFunction, solution: Solution, cell: int | None = None) -> Margins | str:
    """Margins of the cells in which a run may start, those of some headings where classes of inputs are remembered.

    Of one cell alone where it is given. Where there are none, why: a sentence.
    """
    space, sensing = Space.of(context.case), context.case.sensing
    error = space.vector(sensing.error if sensing else {})
    sets = len(context.input_set) if solution.late else solution.memory
    needed = 4 * solution.grid.size * 2 ** len(solution.grid.periodic) * sets
    if needed > LARGEST_TABLES:
        return f"Counting how far each of {sets} sets of cells reaches would take {needed / 1e9:.1f} GB."
    blurred = bool(error.any()) or solution.late
    if blurred and specification_of(context.case).on_true_cells:
        return _of_true_cells(context, gap, solution, error)
    return _of_measured_cells(context, gap, solution, error, cell)


def _of_measured_cells(
    context: Context, gap: GapFunction, solution: Solution, error: Floats, cell: int | None
) -> Margins:
    """At what is remembered at a start: the class of a robot at rest, the input that acts first, a task's first state.

    The state of a task that follows depends on the cell, so that cells with the same one are looked at together.
    """
    grid, names, first = solution.grid, context.states, solution.first
    axes, looked_at, only = gap.domain.read, np.ones(grid.size, np.bool_), []
    if cell is not None:
        looked_at[:] = np.arange(grid.size) == cell
    elif solution.kind is not None and axes:
        layers = shown_layers(grid.cells[axes[-1]], LAYERS)
        looked_at &= np.isin(np.indices(grid.cells)[axes[-1]].reshape(-1), layers)
        only += [f"in {len(layers)} of {grid.cells[axes[-1]]} layers of {names[axes[-1]]}"]
    nodes = solution.served if solution.value is None else solution.value >= 0
    nodes = nodes.reshape(grid.size, solution.memory)
    rows = np.arange(grid.size) * solution.memory + first
    mask = np.ascontiguousarray(solution.admitted(len(context.input_set), rows))
    about = context.plant.sampled, grid, context.input_set, _after(gap, solution).kernel()
    begins = specification_of(context.case).fit(Space.of(context.case), grid, error)
    winning, losing = nodes[:, first] & looked_at, solution.free & begins & ~nodes[:, first] & looked_at
    states = np.zeros(grid.size, int) if solution.progress is None else solution.progress(first, np.arange(grid.size))
    parts = []
    for state in np.unique(states):
        own = states == state
        acts, after = solution.step(first, np.arange(len(context.input_set)), int(np.flatnonzero(own)[0]))
        remembered, kind = np.unique(after, return_inverse=True)
        late = int(acts) if solution.late else None
        known = Remembered(nodes[:, remembered], kind.reshape(-1).astype(np.int64), late)
        parts.append(one_step_margins(*about, winning & own, mask, axes, error, known, losing=losing & own))
    where = ["where the previous input is of the class of a robot at rest"] if solution.kind is not None else []
    where += [_first(context, late)] if late is not None else []
    where += ["where the task begins"] if solution.progress is not None else []
    found = reduce(Margins.joined, parts)
    found.loses_by[solution.free & ~begins & looked_at] = ASKED
    return replace(found, only=", ".join([" and ".join(where), *only] if where else only))


def _of_true_cells(context: Context, gap: GapFunction, solution: Solution, error: Floats) -> Margins | str:
    """Margins of cells of the true state that are kept by inputs of the measured ones."""
    larger, inputs = solution.grid, context.input_set
    reach = cells_of_error(larger, error)
    grid = _true_grid(context, larger, reach)
    winning, late = crop(solution.winning, grid, larger), None
    known = None
    if solution.late:
        if solution.acting is None:
            return "The controller file does not say which inputs may act from which cells: run the synthesis again."
        late = solution.first
        acting = unpack(crop(solution.acting, grid, larger), len(inputs)).astype(np.bool_)
        known = Remembered(acting, np.arange(len(inputs)), acting=late)
    mask = solution.mask.reshape(larger.size, solution.memory, -1)[:, solution.first]
    about = context.plant.sampled, grid, inputs, gap.kernel(), winning, np.ascontiguousarray(mask)
    losing = crop(solution.free, grid, larger) & ~winning
    found = one_step_margins(*about, gap.domain.read, None, known, reach, losing)
    only = "" if late is None else _first(context, late)

    factor, loses_by = found.factor[:, None], found.loses_by[:, None]
    factor, loses_by = embed(factor, grid, larger, np.nan), embed(loses_by, grid, larger, NOTHING)
    return Margins(factor[:, 0], loses_by[:, 0], only)


def _true_grid(context: Context, larger: Grid, reach: tuple[int, ...]) -> Grid:
    """The cells of the true state within those of its measurements."""
    space = Space.of(context.case)
    wide = [0 if j in larger.periodic else 2 * m for j, m in enumerate(reach)]
    region = specification_of(context.case).region(space)
    return space.grid(region, [c - w for c, w in zip(larger.cells, wide, strict=True)])


def _after(gap: GapFunction, solution: Solution) -> GapFunction:
    """The bound in the first sample: after an input of the class of a start, where there are classes."""
    if solution.kind is None or not isinstance(gap, BodyFrameGap) or gap.classes.count == 1:
        return gap
    return gap.after(solution.first % (int(solution.kind.max()) + 1))


def _first(context: Context, late: int) -> str:
    values = ", ".join(f"{n} = {u:g}" for n, u in zip(context.inputs, context.input_set[late], strict=True))
    return f"where the first input, {values}, acts"
