"""From roll-outs to what the steps after them work on: the signed gap of a dimension, the motion of a robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.gap.bounds.body_frame import nominal_motion
from simgap.gap.bounds.closed_form import ClosedFormGap
from simgap.gap.bounds.previous import PreviousClasses
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
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid
from simgap.gap.sampling.values import Centres, Held, Room
from simgap.plants.context import Context, pose_axes
from simgap.simulators.body_samples import BodySamples, joined
from simgap.simulators.build import closed_form

T = TypeVar("T")


def read_back(make: Callable[[Mapping[str, Any]], T], data: Mapping[str, Any]) -> T:
    """The result of one dimension from its saved form.

    Raises:
        UserError: the result of another kind of case, or an incomplete one.
    """
    try:
        return make(data)
    except (LookupError, TypeError, ValueError) as error:
        raise UserError(
            f"the saved result of {data['state']} is none of this case ({error!r})",
            remedy="Run the stages scp and lipschitz again.",
        ) from None


def sample_grid(context: Context, points: Points) -> SampleGrid:
    """The covering grid of a point, checked against its file.

    Raises:
        UserError: states or inputs of another case.
    """
    grid = covering_grid(context.case, context.box, points.name)
    same = points.states.shape == (grid.size, grid.box.size) and np.array_equal(points.inputs, context.input_set)
    centres = Centres(grid)
    if not same or not all(np.array_equal(points.states[a:b], centres.rows(a, b)) for a, b in centres.blocks()):
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
    found = closed_form(context.case, context.folder)
    if found is not None and context.plant.sampled.too_long_to_write_out:
        raise UserError(
            "a step of the nominal model is too long to be enclosed beside the simulator's", key="plant.integrator",
            remedy="Set simulator.slopes: sampled, or use a simpler integrator.",
        )  # fmt: skip
    return ClosedFormGap.of(found, context.plant.sampled) if found is not None else None


def dimension_samples(
    context: Context, points: Points, shards: Sequence[Columns], i: int, room: Room = Held.room
) -> DimensionSamples:
    """The signed gap of dimension i on the grid, from shards in order; `room` is where it is kept.

    Raises:
        UserError: shards that are not those of this grid.
    """
    where, name = sample_grid(context, points), context.states[i]
    model = context.plant.sampled
    lower, upper = _Filled(room, where), None
    for rolled in shards:
        done = lower.done
        x, u = stacked(rolled, context.states), stacked(rolled, context.inputs)
        check_rows(points, done, x, u)
        predicted = model.step(x, u)[:, i]
        least, largest = successors(rolled, name)
        if largest is not least and upper is None:  # the second end takes room only where there is one
            if done:
                remedy = "Delete the shards of this grid and run again."
                raise UserError("some shards hold ranges of successors and others do not", remedy=remedy)
            upper = _Filled(room, where)
        lower.add(least - predicted)
        if upper is not None:
            upper.add(largest - predicted)
    if lower.done != where.size:
        raise UserError(
            f"the shards hold {lower.done} roll-outs, the grid {points.name} needs {where.size}",
            remedy="Delete the shards of this grid and run again.",
        )
    return DimensionSamples(where, i, lower.kept, upper.kept if upper is not None else None, room=room)


class _Filled:
    """Numbers of a grid (N, M), from shards in order; they may end within a state."""

    def __init__(self, room: Room, where: SampleGrid) -> None:
        self.kept, self.done, self._left = room((where.grid.size, len(where.inputs))), 0, np.empty(0)

    def add(self, some: Floats) -> None:
        """The next ones, (n,)."""
        width, left = self.kept.shape[1], np.concatenate([self._left, some])
        whole = len(left) // width * width
        self.kept.put((self.done - len(self._left)) // width, left[:whole].reshape(-1, width))
        self.done, self._left = self.done + len(some), left[whole:]


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
    """Check that rows (n, nx), (n, nu) are those of the grid from row `first` on.

    Raises:
        UserError: if they are not.
    """
    count = len(points.inputs)
    start, stop = first // count, -(-(first + len(x)) // count)
    states, inputs = product(points.states[start:stop], points.inputs)
    own = slice(first - start * count, first - start * count + len(x))
    if not (np.array_equal(states[own], x) and np.array_equal(inputs[own], u)):
        raise UserError(
            f"a shard is not one of the grid {points.name}, or the shards are out of order",
            remedy="Delete the shards of this grid and run again.",
        )


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
