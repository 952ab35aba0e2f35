"""Columns of the tables of samples: pairs of a state and an input, or steps of a robot as it sees them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.gap.sampling.points import Columns
from simgap.simulators.body_samples import BodySamples

KINDS = ("next", "least", "largest")
EXTENTS = ("least_x", "largest_x", "least_y", "largest_y")
AFTER_PREVIOUS, SEQUENCE, HISTORY = "after_previous", "sequence", "history"


def successor_columns(
    case: Case, x: Floats, u: Floats, following: Floats, spread: tuple[Floats, Floats] | None = None
) -> dict[str, Floats]:
    """States, inputs, successors `next_<state>`; `least_` and `largest_` where they have a range: (n,) each."""
    states, inputs = list(case.plant.states), list(case.plant.inputs)
    columns = {n: x[:, k] for k, n in enumerate(states)} | {n: u[:, k] for k, n in enumerate(inputs)}
    columns |= {f"next_{n}": following[:, k] for k, n in enumerate(states)}
    for kind, values in zip(KINDS[1:], spread or (), strict=False):
        columns |= {f"{kind}_{n}": values[:, k] for k, n in enumerate(states)}
    return columns


def units(case: Case) -> Mapping[str, str]:
    """Units of all columns that this step and `fresh` write."""
    plant = case.plant
    own = {n: s.unit for n, s in plant.states.items()}
    of_states = {f"{kind}_{n}": unit for kind in (*KINDS, "moved") for n, unit in own.items()}
    of_inputs = {n: i.unit for n, i in plant.inputs.items()}
    return own | of_inputs | of_states | dict.fromkeys(EXTENTS, "m") | {"heading": "rad"}


def step_columns(case: Case, inputs: Floats, samples: BodySamples) -> dict[str, Any]:
    """Input, final pose `moved_<state>` and extent of each step from where it began: (n,) each; inputs are (M, nu)."""
    u = inputs[samples.m]
    columns: dict[str, Any] = {"input": samples.m, "previous": samples.previous}
    columns |= {n: u[:, j] for j, n in enumerate(case.plant.inputs)}
    columns |= {f"moved_{n}": samples.final[:, j] for j, n in enumerate(case.plant.states)}
    return columns | {n: samples.extent[:, j] for j, n in enumerate(EXTENTS)}


def body_samples(case: Case, columns: Columns, part: str | None = None) -> BodySamples:
    """The steps of one part of a table, or of all of it: the inverse of `step_columns`."""
    rows = slice(None) if part is None else columns["part"] == part
    final = np.stack([columns[f"moved_{n}"][rows] for n in case.plant.states], axis=-1)
    extent = np.stack([columns[n][rows] for n in EXTENTS], axis=-1)
    numbers = (columns[name][rows].astype(np.int64) for name in ("input", "previous"))
    return BodySamples(next(numbers), final, extent, next(numbers))


def stacked(columns: Columns, names: Sequence[str]) -> Floats:
    """Columns side by side: -> (rows, len(names))."""
    return np.stack([columns[name] for name in names], axis=-1)


def successors(rolled: Columns, name: str) -> tuple[Floats, Floats]:
    """Least and largest successor of one state, (n,) each: one and the same array without memory of the inputs."""
    if f"least_{name}" not in rolled:
        return rolled[f"next_{name}"], rolled[f"next_{name}"]
    return rolled[f"least_{name}"], rolled[f"largest_{name}"]
