"""Roll-outs of a simulator that remembers earlier inputs, for step `rollouts` and for the fresh samples of such a case.

One table holds three parts: the steps after each previous input of the grid, steps of random sequences of inputs, and
random histories again with fewer inputs before the present one and at other headings.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.config.case import Case
from simgap.config.gap import HiddenStateSection
from simgap.errors import UserError
from simgap.gap.memory.hidden_state import random_sequences
from simgap.gap.sampling.points import AFTER_PREVIOUS, HISTORY, SEQUENCE, Columns, Points, cut, step_columns
from simgap.simulators.body_samples import BodySamples
from simgap.simulators.rollouts import after_previous, along_sequences, last_steps, open_robot

FRESH_LENGTH = 5  # samples of a fresh sequence: sequences are independent, steps of one are not
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
        back = np.array([*range(1, hidden.length + 1), *([hidden.length] * symmetry.headings)])
        heading = np.concatenate([np.zeros((len(checked), hidden.length)), angles], axis=1).ravel()
        every = [numbers[hidden.length - k :] for numbers in checked for k in back]
        with open_robot(case, folder) as robot:
            found = last_steps(robot, every, heading, inputs), robot.engine
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
    count = -(-hidden.fresh_samples // FRESH_LENGTH)
    rng = np.random.default_rng(hidden.fresh_seed)
    return sequence_parts(random_sequences(inputs, count, FRESH_LENGTH, rng), hidden.fresh_seed)
