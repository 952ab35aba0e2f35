"""Samples of the gap on a grid of states times a finite set of inputs, all dimensions or one, made of roll-outs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.gap.bounds.body_frame import nominal_motion
from simgap.gap.bounds.enclosures import CellRanges, ClosedFormGap
from simgap.gap.bounds.function import GapDomain
from simgap.gap.bounds.previous import PreviousClasses
from simgap.gap.sampling.borders import Directed
from simgap.gap.sampling.points import (
    AFTER_PREVIOUS,
    HISTORY,
    SEQUENCE,
    Columns,
    Points,
    body_samples,
    covering_grid,
    draw,
    free_axes,
    product,
    stacked,
    successors,
)
from simgap.gap.sampling.values import Kept, Room, Values, centres, check_numbers, combined, in_memory
from simgap.geometry import Grid
from simgap.plants.context import Context, pose_axes
from simgap.simulators.body_samples import BodySamples, joined
from simgap.simulators.rollouts import engine_of


@dataclass(frozen=True, eq=False)
class SampleGrid:
    """The places of the samples: the cell centres of `grid`, for every input.

    Attributes:
        grid: N cells that tile X; inputs: (M, nu); states, input_names: names in order.
        free: state axes on which the gap does not depend by a declared symmetry.
        periodic: state axes along which it repeats itself with the width of X.
        known: the gap as expressions where the simulator is known in closed form; None for a black box.
    """

    grid: Grid
    inputs: Floats
    states: tuple[str, ...]
    input_names: tuple[str, ...]
    free: tuple[int, ...] = ()
    periodic: tuple[int, ...] = ()
    known: ClosedFormGap | None = None

    @property
    def domain(self) -> GapDomain:
        """X and U with their names."""
        return GapDomain(self.states, self.input_names, self.grid.box, self.inputs, self.free, self.periodic)

    @property
    def size(self) -> int:
        """Number of samples, N M."""
        return self.grid.size * len(self.inputs)

    @cached_property
    def rounding(self) -> Floats:
        """(nx,) size of differences that may be rounding alone: the gap is a difference of numbers of the size of X.

        A sixteenth of it is added to a bound; where the gap is known that is a bound of its rounding, twice over.
        """
        box = self.grid.box
        usual = 64.0 * 2.0**-52 * (np.maximum(np.abs(box.lo), np.abs(box.hi)))
        if self.known is None:
            return usual
        proven = [self.known.rounding(i, box.lo, box.hi, self.inputs) for i in range(len(usual))]
        return np.maximum(usual, 32.0 * np.array(proven))

    @cached_property
    def moving_half_widths(self) -> Floats:
        """(nx,) half-widths of a cell, 0 along the free axes."""
        return np.where(np.isin(np.arange(len(self.grid.cells)), self.free), 0.0, self.grid.h)


@dataclass(frozen=True, eq=False)
class DimensionSamples:
    """The signed gap of one dimension: d (N, M), and d_upper where hidden states of the simulator spread it.

    `directed` are samples beside those of the grid; `room` is where more numbers of their kind are kept.

    Raises:
        UserError: for shapes that do not fit or values that are not finite.
    """

    where: SampleGrid
    i: int
    d: Values
    d_upper: Values | None = None
    directed: Directed | None = None
    room: Room = in_memory

    def __post_init__(self) -> None:
        shape = self.where.grid.size, len(self.where.inputs)
        for own in self.ends:
            if own.shape != shape:
                raise UserError(f"the gap samples have shape {own.shape}, not {shape}")
            for block in own.blocks():
                part = own[block]
                check_numbers(part.shape, {"d": part})

    @property
    def ends(self) -> tuple[Values, ...]:
        """The gap, (N, M); both ends of its range where it has one."""
        return (self.d,) if self.d_upper is None else (self.d, self.d_upper)

    @property
    def beside(self) -> Directed | None:
        """`directed`, where the fit has to cover them for themselves; enclosures of a known gap cover them already."""
        return self.directed if self.where.known is None else None

    @property
    def floor(self) -> float:
        """Size of differences that may be rounding alone."""
        return float(self.where.rounding[self.i])

    @cached_property
    def ranges(self) -> CellRanges | None:
        """Enclosures of the gap on every cell, checked against the samples; None for a black box.

        Raises:
            UserError: a gap that cannot be enclosed.
            BrokenPromise: samples that are not those of the equations.
        """
        if self.where.known is None:
            return None
        if self.where.free or self.d_upper is not None:
            raise UserError(
                "a gap in closed form has neither a declared symmetry nor hidden states", key="simulator",
                remedy="Leave out `symmetry`, or say simulator.slopes: sampled.",
            )  # fmt: skip
        found = self.where.known.ranges(self.i, self.where.grid, self.where.inputs)
        found.check_samples(self.d.whole(), self.where.states[self.i])
        return found

    def side(self, upper: bool) -> Values:
        """(N, M) what one side has to cover: d for `hi`, -d for `-lo`."""
        own = self.d if self.d_upper is None or not upper else self.d_upper
        return own if upper else combined(np.negative, own)

    @cached_property
    def largest(self) -> float:
        """Largest sampled |d|."""
        return max(abs(end) for own in self.ends for end in own.ends())


T = TypeVar("T")
DELETE = "Delete the shards of this grid and run again."


def read_back(make: Callable[[Mapping[str, Any]], T], data: Mapping[str, Any]) -> T:
    """The result of one dimension from its saved form.

    Raises:
        UserError: the result of another kind of case, or an incomplete one.
    """
    try:
        return make(data)
    except (LookupError, TypeError, ValueError) as error:
        raise UserError(
            f"the saved result of {data['state']} is not of this case ({error!r})",
            remedy="Run the stages scp and lipschitz again.",
        ) from None


def sample_grid(context: Context, points: Points) -> SampleGrid:
    """The covering grid of a point, checked against its file.

    Raises:
        UserError: states or inputs of another case.
    """
    grid = covering_grid(context.case, context.box, points.name)
    same = points.states.shape == (grid.size, grid.box.size) and np.array_equal(points.inputs, context.input_set)
    wanted = centres(grid)
    if not same or not all(np.array_equal(points.states[block], wanted[block]) for block in wanted.blocks()):
        raise UserError("the grid was made for another case", remedy="Run the grid stage again, and those after it.")
    names = tuple(context.states), tuple(context.inputs)
    free = free_axes(context.case)
    return SampleGrid(grid, points.inputs, *names, free, context.periodic, known_gap(context))


def known_gap(context: Context) -> ClosedFormGap | None:
    """The gap in closed form where the simulator is one, else None.

    Raises:
        UserError: a case that the engine cannot run, or equations that cannot be enclosed.
    """
    if context.case.simulator is None:
        return None
    found = engine_of(context.case, context.folder).closed_form(context.case, context.folder)
    if found is not None and context.plant.sampled.too_long_to_write_out:
        raise UserError(
            "a step of the nominal model is too long to be enclosed beside the simulator's", key="plant.integrator",
            remedy="Set simulator.slopes: sampled, or use a simpler integrator.",
        )  # fmt: skip
    return ClosedFormGap.of(found, context.plant.sampled) if found is not None else None


def dimension_samples(
    context: Context, points: Points, shards: Sequence[Columns], i: int, room: Room = in_memory
) -> DimensionSamples:
    """The signed gap of dimension i on the grid, from shards in order; `room` is where it is kept.

    Raises:
        UserError: shards that are not those of this grid.
    """
    where, name, width = sample_grid(context, points), context.states[i], len(points.inputs)
    ends: list[Kept] = []
    done = 0
    for rolled in shards:
        x, u = stacked(rolled, context.states), stacked(rolled, context.inputs)
        check_rows(points, done, x, u)
        predicted, (least, largest) = context.plant.sampled.step(x, u)[:, i], successors(rolled, name)
        found = [least] if largest is least else [least, largest]  # the second takes room only where there is one
        ends = ends or [room((where.grid.size, width)) for _ in found]
        if len(ends) != len(found):
            raise UserError("some shards hold ranges of successors and others do not", remedy=DELETE)
        for kept, values in zip(ends, found, strict=True):
            kept.put(done, (values - predicted).reshape(-1, width))
        done += len(x) // width
    if done != where.grid.size:
        raise UserError(
            f"the shards hold {done * width} roll-outs, the grid {points.name} needs {where.size}", remedy=DELETE
        )
    return DimensionSamples(where, i, ends[0], ends[1] if len(ends) > 1 else None, room=room)


def check_drawn(context: Context, x: Floats, u: Floats) -> None:
    """Check that fresh samples (n, nx), (n, nu) are the random ones that the case draws.

    Raises:
        UserError: if they are not; those of another X would confirm a bound where it does not hold.
    """
    section = context.need(context.case.gap, "gap")
    states, inputs = draw(context.box, context.input_set, section.fresh_samples, section.seed)
    if not (np.array_equal(states, x) and np.array_equal(inputs, u)):
        raise UserError("the fresh samples are not those of this case", remedy="Run `fresh` again.")


def check_rows(points: Points, first: int, x: Floats, u: Floats) -> None:
    """Check that rows (n, nx), (n, nu) are those of whole states of the grid, from the state `first` on.

    Raises:
        UserError: if they are not.
    """
    states, inputs = product(points.states[first : first + -(-len(x) // len(points.inputs))], points.inputs)
    if not (np.array_equal(states, x) and np.array_equal(inputs, u)):
        raise UserError(f"a shard is not one of the grid {points.name}, or the shards are out of order", remedy=DELETE)


def check_histories(context: Context, points: Points, shards: Sequence[Columns]) -> None:
    """Check that a robot's shards are together all of its grid: every part whole, every step with its own input.

    Raises:
        UserError: if they are not; a hull over a part of the histories would be too narrow.
    """
    hidden = context.need(context.case.hidden_state, "hidden_state")
    symmetry = context.need(context.case.symmetry, "symmetry")
    wanted = {
        AFTER_PREVIOUS: len(points.states) * len(points.inputs),
        SEQUENCE: hidden.chains * hidden.chain_length,
        HISTORY: symmetry.histories * (hidden.length + symmetry.headings),
    }
    found = {part: sum(int((rolled["part"] == part).sum()) for rolled in shards) for part in wanted}
    numbers = np.concatenate([rolled["input"].astype(np.int64) for rolled in shards])
    applied = np.concatenate([stacked(rolled, context.inputs) for rolled in shards])
    same = np.array_equal(points.inputs, context.input_set) and np.array_equal(context.input_set[numbers], applied)
    if found != wanted or not same:
        raise UserError(
            f"the shards are not those of the grid {points.name}: they hold {found} steps, it needs {wanted}",
            remedy="Give all shards of this grid, or delete them and run again.",
        )


def steps_of(context: Context, shards: Sequence[Columns], part: str) -> BodySamples:
    """The steps of one part of a robot's shards, in order."""
    return joined([body_samples(context.case, rolled, part) for rolled in shards])


def previous_classes(context: Context) -> PreviousClasses:
    """The classes of the previous input that the case names.

    Raises:
        UserError: a class count for something that is no input, or more classes than values.
    """
    hidden = context.need(context.case.hidden_state, "hidden_state")
    unknown = [name for name in hidden.classes if name not in context.inputs]
    if unknown:
        raise UserError(f"{unknown} are not inputs", key="hidden_state.classes", remedy=f"They are {context.inputs}.")
    return PreviousClasses.of(context.input_set, [hidden.classes.get(name, 1) for name in context.inputs])


def motion_of(context: Context) -> Floats:
    """The nominal step seen from the robot, (M, 3).

    Raises:
        UserError: a nominal model without the declared symmetry.
    """
    centre = 0.5 * (context.box.lo + context.box.hi)
    rng = np.random.default_rng(0)
    return nominal_motion(context.plant.sampled.step, centre, context.input_set, pose_axes(context), rng)
