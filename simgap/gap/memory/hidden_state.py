"""Input histories that expose the hidden state of a simulator, and what the gap may exceed its samples by.

A roll-out from rest is not the map that a controller meets: wheels and body still move as the previous input told them.
The bound for an input is therefore the hull over previous inputs of a class (a grid of them, extremes included),
widened by what random input sequences (`bound`) and a directed search (`search`) show beyond that hull, at any heading.
That it is wide enough is an estimate; the influence of older inputs is measured and must fall with their age.

One table of roll-outs holds three parts: the steps after each previous input of the grid, steps of random sequences of
inputs, and random histories again with fewer inputs before the present one and at other headings.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.config.case import Case
from simgap.config.gap import HiddenStateSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.body_frame import intervals
from simgap.gap.sampling.points import AFTER_PREVIOUS, HISTORY, SEQUENCE, Columns, Points, cut, step_columns
from simgap.gap.thresholds import BEYOND_CONFIDENCE, SMALL_INFLUENCE
from simgap.simulators.base import BodySamples
from simgap.simulators.rollouts import after_previous, along_sequences, repeated_histories

TOP = 20
COORDINATES = 4
"""What an excess over the grid of previous inputs depends on: two previous and two present commands of a robot."""


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
        picked.append(np.concatenate([_spaced(group, min(each, len(group))) for group in groups]))
    return np.array(list(itertools.product(*picked)), dtype=np.float64)


def _spaced(values: Floats, count: int) -> Floats:
    return values[np.round(np.linspace(0, len(values) - 1, count)).astype(int)]


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


def extrapolated_maximum(
    excess: Floats, dimension: int, top: int = TOP, confidence: float = BEYOND_CONFIDENCE
) -> float:
    """Upper estimate of the supremum behind excesses (n,), >= their maximum (0 when nothing exceeds).

    `M1 + (M1 - Mk) r / (1 - r)`, `r = (1 - (1 - confidence)^(1/(k - 1)))^(1/a)`, from the k largest, where the samples
    fill `dimension` a: the more coordinates, the farther the largest sample lies from the supremum (de Haan 1981).
    """
    k = min(top, len(excess))
    largest = np.sort(excess)[-k:]
    if k < 2 or largest[-1] <= 0:
        return max(float(largest[-1]), 0.0)
    r = (1.0 - (1.0 - confidence) ** (1.0 / (k - 1))) ** (1.0 / dimension)
    return float(largest[-1] + (largest[-1] - max(largest[0], 0.0)) * r / (1.0 - r))


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


SEQUENCE_PARTS = 4  # each with random headings of its own, whatever the number of shards and workers


def history_shard(case: Case, folder: Path, points: Points, shard: int, shards: int) -> tuple[Columns, str]:
    """One shard of the three parts, and the engine's name.

    Raises:
        UserError: a case without symmetry, with another kind of simulator, or with too many shards.
    """
    hidden, symmetry, inputs = case.hidden_state, case.symmetry, points.inputs
    if hidden is None or symmetry is None:
        raise UserError("this stage needs the section", key="symmetry", remedy="Add `symmetry:`.")
    rng, n = np.random.default_rng(hidden.seed), symmetry.histories
    sequences = random_sequences(inputs, hidden.chains, hidden.chain_length, rng)
    own = cut(n, shard, shards)
    checked = random_sequences(inputs, n, hidden.length + 1, rng)[own]
    angles = np.random.default_rng(symmetry.seed).uniform(-np.pi, np.pi, (symmetry.headings, n)).T[own]
    tables: list[tuple[dict[str, Any], str]] = []
    previous = points.states[cut(len(points.states), shard, shards)]
    if len(previous):
        found = after_previous(case, folder, previous, inputs)
        tables.append(_part(case, inputs, AFTER_PREVIOUS, found, np.array([1]), np.array([0.0])))
    pieces = sequence_parts(sequences, hidden.seed)
    for numbers, seed in pieces[cut(len(pieces), shard, shards)]:
        found = along_sequences(case, folder, numbers, inputs, seed)
        tables.append(_part(case, inputs, SEQUENCE, found, np.arange(hidden.chain_length), np.array([np.nan])))
    if len(checked):
        found = repeated_histories(case, folder, checked, inputs, angles)
        back = np.array([*range(1, hidden.length + 1), *([hidden.length] * symmetry.headings)])
        heading = np.concatenate([np.zeros((len(checked), hidden.length)), angles], axis=1).ravel()
        tables.append(_part(case, inputs, HISTORY, found, back, heading))
    if not tables:
        raise UserError("there are more shards than samples", key="grid.shards", remedy="Use fewer.")
    names = tables[0][0]
    return {name: np.concatenate([columns[name] for columns, _ in tables]) for name in names}, tables[0][1]


def _part(
    case: Case, inputs: Floats, name: str, found: tuple[BodySamples, str], earlier: Ints, heading: Floats
) -> tuple[dict[str, Any], str]:
    """Columns of one part; `earlier` inputs before the present one and `heading` are repeated over the rows."""
    samples, engine = found
    n = len(samples.m)
    more = {"part": np.full(n, name), "earlier": np.resize(earlier, n), "heading": np.resize(heading, n)}
    return step_columns(case, inputs, samples) | more, engine


def sequence_parts(sequences: Ints, seed: int) -> list[tuple[Ints, list[int]]]:
    """Random sequences (n, k) in parts of rows, each with the seed of its headings; empty parts are left out."""
    parts = np.array_split(sequences, SEQUENCE_PARTS)
    return [(part, [seed, k]) for k, part in enumerate(parts) if len(part)]


def fresh_sequences(inputs: Floats, hidden: HiddenStateSection) -> list[tuple[Ints, list[int]]]:
    """Parts (n, k) of random sequences of inputs (M, nu) with another seed, which no bound has seen."""
    count = -(-hidden.fresh_samples // hidden.fresh_length)
    rng = np.random.default_rng(hidden.fresh_seed)
    return sequence_parts(random_sequences(inputs, count, hidden.fresh_length, rng), hidden.fresh_seed)
