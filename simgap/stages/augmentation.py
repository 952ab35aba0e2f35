"""How a corrected case carries the delay and the lag that were found: as states while they stay small, else by gamma.

A lag adds a state, the actuator's output, in the range of what admissible commands make of it. A delay near one sample
adds the pending input to the controller's memory. Above the limits here neither is added: the sampled model then has no
memory, and the gap stage takes gamma over what earlier commands leave behind.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.config.case import Case
from simgap.config.domain import InputSet
from simgap.config.plant import AddedEffect
from simgap.effects import AppliedEffect, effect
from simgap.effects.commands import MemoryInputEffect
from simgap.geometry import Box, Grid
from simgap.simulators.commands import CommandPath
from simgap.specifications.base import specification_of
from simgap.synthesis.bits import packed_width
from simgap.synthesis.pending import LARGEST_NODES, bytes_of_nodes
from simgap.synthesis.sensing import LARGEST_MASK

LARGEST_ROLLOUTS = 2_000_000
"""Most roll-outs (cells of `grid.eps` times inputs) with a lag as a state."""
LARGEST_PAIRS = 100_000_000
"""Most pairs of a cell of `synthesis.cells` and an input with a lag as a state."""
LAG_CELLS = 24
"""Cells of the abstraction along a lagged input."""


@dataclass(frozen=True)
class Augmentation:
    """What the corrected case carries.

    Attributes:
        lags: input -> range of what the plant feels, for each lag that becomes a state.
        pending: whether one sample of delay becomes the controller's latency.
        words: a sentence for each decision, for the head of the case.
    """

    lags: Mapping[str, tuple[float, float]]
    pending: bool
    words: tuple[str, ...]


def plan(case: Case, applied: Sequence[AppliedEffect]) -> Augmentation:
    """Decide for a case that checks, with all effects that its plant will have."""
    lagged, delays = _remembered(applied)
    if case.domain is None or not (lagged or delays):
        return Augmentation({}, False, ())
    ranges = {on: _felt(case.domain.U[on], applied, on) for on in lagged}
    words = []
    fits = lagged and case.plant.symbolic is None and _rollouts(case, ranges) and _pairs(case, len(lagged))
    if lagged:
        names = ", ".join(f"{on}_lagged" for on in lagged)
        words.append(
            f"The lag is a state of the model: {names}, which the controller computes from its own commands."
            if fits
            else "The lag is not in the sampled model: as a state it would exceed "
            f"{LARGEST_ROLLOUTS:,} roll-outs or {LARGEST_PAIRS:,} pairs, or this plant cannot take it. Gamma covers it."
        )
    pending = bool(delays) and _one_sample(case, delays) and not fits
    if delays:
        words.append(
            "The first sample of the delay is the controller's latency: it knows which input is pending, and commands "
            "that would act earlier are held back. Gamma covers the rest."
            if pending
            else "The delay is not in the sampled model: it is not near one sample of every input, or too large with "
            "these cells and inputs, or not for this specification. Gamma covers it."
        )
    return Augmentation(ranges if fits else {}, pending, tuple(words))


def _remembered(applied: Sequence[AppliedEffect]) -> tuple[list[str], dict[str, float]]:
    """The inputs that lag, and the delay (s) of those that act late."""
    lagged, delays = set(), dict[str, float]()
    for a in applied:
        kind = effect(a.name)
        if isinstance(kind, MemoryInputEffect):
            delay, lag = kind.seconds(a.values)
            lagged |= {a.on} if lag > 0.0 else set()
            delays |= {a.on: delays.get(a.on, 0.0) + delay} if delay > 0.0 else {}
    return sorted(lagged), delays


def augment(content: dict[str, Any], case: Case, chosen: Augmentation) -> None:
    """Write the decision into the plain content of the case."""
    for on, ends in chosen.lags.items():
        name = f"{on}_lagged"
        if name in content["plant"]["states"]:
            continue
        content["plant"]["states"][name] = {"unit": case.plant.inputs[on].unit, "lag_of": on}
        content["domain"]["X"][name] = list(ends)
        if case.synthesis is not None:
            content["synthesis"]["cells"] = [*content["synthesis"]["cells"], LAG_CELLS]
        if case.gap is not None and isinstance(content["gap"]["basis"], list):
            content["gap"]["basis"] = [*content["gap"]["basis"], name]
    if chosen.pending:
        content["sensing"] = {**(content.get("sensing") or {}), "latency": 1, "latency_of": "input_delay"}


def _felt(values: InputSet, applied: Sequence[AppliedEffect], on: str) -> tuple[float, float]:
    effects = [AddedEffect(name=a.name, on=a.on, parameters=dict(a.values)) for a in applied]
    return CommandPath.of(effects, on, values.list().tolist(), 0.0).felt


def _rollouts(case: Case, ranges: Mapping[str, tuple[float, float]]) -> bool:
    if case.grid is None or case.domain is None:
        return True
    ends = [*(v for n, v in case.domain.X.items() if n not in {f"{on}_lagged" for on in ranges}), *ranges.values()]
    if any(lo == hi for lo, hi in ends):
        return False
    if case.grid.eps is None:  # no half-width is given for the lagged input
        return False
    grid = Grid.covering(Box([lo for lo, _ in ends], [hi for _, hi in ends]), case.grid.eps)
    return math.prod(grid.cells) * _inputs(case) <= LARGEST_ROLLOUTS


def _pairs(case: Case, lags: int) -> bool:
    if case.synthesis is None:
        return True
    return math.prod(case.synthesis.cells) * LAG_CELLS**lags * _inputs(case) <= LARGEST_PAIRS


def _one_sample(case: Case, delays: Mapping[str, float]) -> bool:
    """Whether every input's delay is nearest to one sample, and the controller can remember the pending input."""
    if case.domain is None or case.synthesis is None or set(delays) != set(case.plant.inputs):
        return False
    near = all(0.5 <= d / case.domain.tau < 1.5 for d in delays.values())
    free = case.sensing is None or case.sensing.latency == case.sensing.known_delay
    inputs = _inputs(case)
    cells = math.prod(case.synthesis.cells)
    if specification_of(case).on_true_cells:
        return near and free and cells * inputs * packed_width(inputs) <= LARGEST_MASK
    return near and free and bytes_of_nodes(cells, inputs) <= LARGEST_NODES


def _inputs(case: Case) -> int:
    return int(np.prod([len(u.list()) for u in case.domain.U.values()])) if case.domain else 0
