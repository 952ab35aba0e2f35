"""Input histories that expose the hidden state of a simulator, and what the gap may exceed its samples by.

A roll-out from rest is not the map that a controller meets: wheels and body still move as the previous input told
them. The bound for an input is therefore the hull over previous inputs of a class (a grid of them, extremes
included), widened by what random input sequences and a directed search (`search`) show beyond that hull, at any
heading. That it is wide enough is an estimate; the influence of older inputs is measured and must fall with their age.

With a value for each input as basis the scenario program solves itself, one dimension after the other: its solution is
the hull over the roll-outs after a grid of previous inputs. In place of slopes stand two measurements: how fast the
influence of older inputs fades, and by how much equal histories differ between headings.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.previous import PreviousClasses, intervals
from simgap.gap.json_record import JsonRecord
from simgap.gap.thresholds import SMALL_INFLUENCE
from simgap.simulators.body_samples import BodySamples
from simgap.statistics import extrapolated_maximum

COORDINATES = 4
"""Coordinates of an excess over the grid of previous inputs: two previous and two present commands of a robot."""


def previous_inputs(values: Sequence[Floats], counts: Sequence[int], classes: Sequence[int] | None = None) -> Floats:
    """A grid of previous inputs: of each input's values the extremes and evenly spaced ones between, (P, nu).

    With `classes` (nu,) of them (`previous.intervals`) those of every class: at least its own extremes.

    Raises:
        UserError: more asked for than there are, or fewer than both extremes.
    """
    picked = []
    for own, count, parts in zip(values, counts, classes or [1] * len(counts), strict=True):
        if not min(2, len(own)) <= count <= len(own):
            raise UserError(
                f"{count} previous values of an input that has {len(own)}", key="hidden_state.previous",
                remedy=f"Take between 2 and {len(own)}.",
            )  # fmt: skip
        groups = intervals(own, parts)
        each = max(2, -(-count // parts))
        places = [np.round(np.linspace(0, len(group) - 1, min(each, len(group)))).astype(int) for group in groups]
        picked.append(np.concatenate([group[spaced] for group, spaced in zip(groups, places, strict=True)]))
    return np.array(list(itertools.product(*picked)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class InputGrid:
    """An input set that is a full grid: its numbers and, along each axis, the numbers of the values.

    Attributes:
        axes: sorted values of each input. number: (counts) input number by value numbers.
    """

    axes: tuple[Floats, ...]
    number: Ints
    inputs: Floats

    @staticmethod
    def of(inputs: Floats) -> InputGrid:
        """The grid of U, (M, nu).

        Raises:
            UserError: values that are not all combined.
        """
        axes = tuple(np.unique(inputs[:, j]) for j in range(inputs.shape[1]))
        number = np.zeros([len(own) for own in axes], np.int64)
        if len(inputs) != number.size:
            raise UserError("hidden states need an input set that is a full grid", key="domain.U")
        number[tuple(np.searchsorted(own, inputs[:, j]) for j, own in enumerate(axes))] = np.arange(len(inputs))
        return InputGrid(axes, number, inputs)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of values of each input."""
        return self.number.shape

    def numbers(self, values: Ints) -> Ints:
        """Input numbers of value numbers: (..., nu) -> (...)."""
        return np.asarray(self.number[tuple(np.moveaxis(values, -1, 0))])

    def values(self, numbers: Ints) -> Ints:
        """Value numbers of input numbers: (...) -> (..., nu)."""
        u = self.inputs[numbers]
        return np.stack([np.searchsorted(own, u[..., j]) for j, own in enumerate(self.axes)], axis=-1)


def random_sequences(inputs: Floats, n: int, length: int, rng: np.random.Generator) -> Ints:
    """Input numbers (n, length): half of the coordinates at an extreme of U, where histories matter most."""
    grid, values = InputGrid.of(inputs), np.empty((n * length, inputs.shape[1]), np.int64)
    for j, count in enumerate(grid.counts):
        extreme = rng.random(n * length) < 0.5
        ends = np.array([0, count - 1])[rng.integers(2, size=n * length)]
        values[:, j] = np.where(extreme, ends, rng.choice(count, n * length))
    return grid.numbers(values).reshape(n, length)


def fading(responses: Floats) -> Floats:
    """Influence of older inputs: responses (L, n, 3) after the last 1, 2, ..., L inputs of n histories -> (L, 3).

    Row l is the largest difference that the inputs more than l + 1 samples back make, out of L.
    """
    return np.abs(responses - responses[-1]).max(axis=1)


def check_fading(memory: Floats, size: Floats, states: Sequence[str], growth: float, noise: Floats) -> None:
    """The influence of older inputs must fall with their age, and be lost at the longest history but one.

    Args:
        memory: (L, nx) see `fading`.
        size: (nx,) sup of the gap.
        states: names.
        growth: share of it that counts as lost.
        noise: (nx,) by how much equal histories differ (contacts, headings): a rise within it is none, nor is one
            within `SMALL_INFLUENCE` of the sup.

    Raises:
        BrokenPromise: naming the state and both numbers.
    """
    if len(memory) < 2:
        return
    for name, influence, floor in zip(states, memory.T, np.maximum(noise, SMALL_INFLUENCE * size), strict=True):
        for age, (before, now) in enumerate(itertools.pairwise(influence.tolist()), 1):
            if now > max(before, floor):
                raise BrokenPromise(
                    f"the influence of earlier inputs on {name} does not fall with their age: inputs more than {age} "
                    f"samples back move it by {before:.3g}, more than {age + 1} back by {now:.3g}; up to {floor:.3g} "
                    "is what equal histories differ by, or negligible",
                    "The engine keeps or makes up more than inputs explain: let its contacts settle "
                    "(simulator.solver_iterations, simulator.substeps), or repeat more histories (symmetry.histories)",
                )
    for name, left, own in zip(states, memory[-2], size, strict=True):
        if left > growth * own:
            raise BrokenPromise(
                f"the gap in {name} still grows with the length of the history: inputs more than {len(memory) - 1} "
                f"samples back move it by {left:.3g}, allowed is {growth:g} of its sup, {growth * own:.3g}",
                "Raise hidden_state.length, lengthen tau, or stiffen the motors",
            )


def hull(m: Ints, values: Floats, inputs: int) -> tuple[Floats, Floats]:
    """Least and largest of values (n, k) per input number: -> (inputs, k) twice; (inf, -inf) without samples."""
    lo, hi = np.full((inputs, values.shape[1]), np.inf), np.full((inputs, values.shape[1]), -np.inf)
    np.minimum.at(lo, m, values)
    np.maximum.at(hi, m, values)
    return lo, hi


def tolerance_of(states: Sequence[str], given: Mapping[str, float]) -> dict[str, float]:
    """The tolerance for every state.

    Raises:
        UserError: a state without one, or an unknown name.
    """
    missing, unknown = [s for s in states if s not in given], [s for s in given if s not in states]
    if missing or unknown:
        raise UserError(
            f"no tolerance for {missing}" if missing else f"no state called {unknown}", key="symmetry.tolerance",
            remedy=f"Give one number for each of {', '.join(states)}.",
        )  # fmt: skip
    return {s: float(given[s]) for s in states}


@dataclass(frozen=True, eq=False)
class Widened(JsonRecord):
    """Hull of one quantity for each class of the previous input and each input, and what random sequences exceed it by.

    Attributes:
        lower, upper: (C, M) over the grid of previous inputs. excess: largest excess of a random sequence; margin: the
            same, extrapolated.
    """

    lower: Floats
    upper: Floats
    excess: float
    margin: float


@dataclass(frozen=True, eq=False)
class HullFit(
    JsonRecord,
    kind="hull",
    program="solved in closed form: on a value for each input, its least and largest sampled gap",
):
    """One dimension over hidden states.

    Attributes:
        gap: body-frame gap. swept: extent of the path of one step along this axis; None for the heading.
        grid, sequences: how many roll-outs after previous inputs and steps of random sequences there were.
    """

    gap: Widened
    swept: Widened | None
    grid: int
    sequences: int


@dataclass(frozen=True, eq=False)
class HistoryInfluence(
    JsonRecord, kind="histories", lipschitz="none: the gap is a table over the inputs, not a function of X"
):
    """Influence of earlier inputs and of the heading in one dimension, in place of slopes.

    Attributes:
        memory: (L,) largest influence on the pose of all inputs more than 1, 2, ..., L samples back.
        deviation: largest difference between equal histories at different headings; compared: how many there were.
    """

    memory: Floats
    deviation: float
    compared: int


def fit_hull(
    i: int, motion: Floats, grid: BodySamples, sequences: BodySamples, pose: tuple[int, int, int] = (0, 1, 2),
    classes: PreviousClasses | None = None,
) -> HullFit:  # fmt: skip
    """Bound dimension i of the body-frame gap, and the swept extent along it, for every class and input.

    Args:
        i: which state.
        motion: nominal step seen from the robot, (M, 3).
        grid: roll-outs after the grid of previous inputs, all inputs after each.
        sequences: steps of random sequences.
        pose: which states are x, y and heading.
        classes: of the previous input; one if not given.
    """
    known = classes or PreviousClasses.single(len(motion))
    d = grid.final[:, i] - motion[grid.m, i], sequences.final[:, i] - motion[sequences.m, i]
    gap = _widened(grid, sequences, known, (d[0], d[0]), (d[1], d[1]))
    swept = None
    if i in pose[:2]:
        axis = pose[:2].index(i)
        ends = [(own.extent[:, 2 * axis], own.extent[:, 2 * axis + 1]) for own in (grid, sequences)]
        swept = _widened(grid, sequences, known, *ends)
    return HullFit(gap, swept, len(grid.m), len(sequences.m))


Ends = tuple[Floats, Floats]


def _widened(grid: BodySamples, sequences: BodySamples, classes: PreviousClasses, inner: Ends, outer: Ends) -> Widened:
    """Hull of least and largest values over the grid, `inner`, and what those of the sequences, `outer`, exceed."""
    inputs = len(classes.kind)
    place = classes.after(grid.previous) * inputs + grid.m
    lower = hull(place, inner[0][:, None], classes.count * inputs)[0].reshape(classes.count, inputs)
    upper = hull(place, inner[1][:, None], classes.count * inputs)[1].reshape(classes.count, inputs)
    own = classes.after(sequences.previous), sequences.m
    excess = np.maximum(np.maximum(lower[own] - outer[0], outer[1] - upper[own]), 0.0)
    return Widened(lower, upper, float(excess.max()), extrapolated_maximum(excess, COORDINATES))
