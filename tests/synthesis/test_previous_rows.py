"""The game over cells and classes of the previous input, against an oracle written from its definition."""

from dataclasses import replace

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.specifications.solution import after_choice
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.intersample import SweptCells
from simgap.synthesis.abstraction.post import table_meta, table_post
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.input_sets import unpack

CELLS, INPUTS = (11, 5), 4  # the second axis is an angle: all offsets depend on it, and it wraps
GRID = Grid(Box([0.0, 0.0], [11.0, 5.0]), CELLS, (1,))
AXES = ((1,), (1,))


def made_up(rng, swept):
    """Boxes of at most 3 x 2 cells up to 3 cells away, and swept cells on the way."""
    lower = np.stack([rng.integers(-3, 3, (CELLS[1], INPUTS)), rng.integers(-2, 2, (CELLS[1], INPUTS))], axis=-1)
    upper = lower + np.stack([rng.integers(0, 3, lower.shape[:2]), rng.integers(0, 2, lower.shape[:2])], axis=-1)
    table = np.stack([np.stack([lower[..., i], upper[..., i]], axis=-1) for i in range(2)]).astype(np.int32)
    meta, _ = table_meta(GRID, INPUTS, AXES)
    inputs = np.arange(INPUTS, dtype=np.float64)[:, None]
    way = None
    if swept:
        low, high = np.zeros(lower.shape, np.int32), np.zeros(lower.shape, np.int32)
        low[..., 0], high[..., 0] = np.minimum(lower[..., 0], 0), np.maximum(upper[..., 0], 0)
        way = SweptCells(1, low, high)
    own = Abstraction(GRID, inputs, table_post(), meta, np.zeros(1), table.reshape(-1), AXES, np.zeros(2), way)
    return own, lower, upper


def cells_of(k, lower, upper):
    """Flat cells of the box k + [lower, upper]; None where it leaves the grid."""
    found = set()
    for a in range(k[0] + lower[0], k[0] + upper[0] + 1):
        if not 0 <= a < CELLS[0]:
            return None
        for b in range(k[1] + lower[1], k[1] + upper[1] + 1):
            found.add(a * CELLS[1] + b % CELLS[1])
    return found


def oracle(boxes, kind, target, free):
    """Levels (cells, classes) and admissible inputs, from the definition: level by level over all nodes and inputs."""
    classes = len(boxes)
    level = {(k, c): 0 for k in np.flatnonzero(target & free) for c in range(classes)}
    admissible, number = {}, 0
    while True:
        number += 1
        new = {}
        for k in np.flatnonzero(free):
            where = divmod(int(k), CELLS[1])
            for c, (own, lower, upper) in enumerate(boxes):
                if (k, c) in level:
                    continue
                good = []
                for m in range(INPUTS):
                    box = cells_of(where, lower[where[1], m], upper[where[1], m])
                    way = set()
                    if own.swept is not None:
                        ends = own.swept.lower[where[1], m], own.swept.upper[where[1], m]
                        way = cells_of(where, *ends)
                    if box is None or way is None or not all(free[j] for j in way):
                        continue
                    if all((j, kind[m]) in level for j in box):
                        good.append(m)
                if good:
                    new[k, c] = good
        if not new:
            return level, admissible
        admissible |= new
        level |= dict.fromkeys(new, number)


@pytest.mark.parametrize("swept", [False, True])
def test_levels_and_inputs_are_those_of_the_definition(swept):
    won = 0
    for seed in range(60):
        rng = np.random.default_rng([seed, swept])
        classes = int(rng.integers(1, 4))
        kind = rng.permutation(np.arange(INPUTS) % classes)
        boxes = [made_up(rng, swept) for _ in range(classes)]
        free = rng.random(GRID.size) < 0.9
        target = rng.random(GRID.size) < 0.3
        level, admissible = oracle(boxes, kind, target, free)
        for by_rows in (True,) if swept else (True, False):
            found = reach_avoid([own for own, _, _ in boxes], target, free, kind=kind, by_rows=by_rows)
            assert found.backend == ("bit_rows" if by_rows else "table")
            for node, (k, c) in enumerate(np.ndindex(GRID.size, classes)):
                assert found.value[node] == level.get((k, c), -1)
                assert np.flatnonzero(unpack(found.mask[node], INPUTS)).tolist() == admissible.get((k, c), [])
        won += len(admissible)
    assert won > 1000  # the problems are not all trivial


def test_a_path_between_samples_is_refused_where_no_axis_allows_bit_rows():
    own, _, _ = made_up(np.random.default_rng(0), swept=True)
    busy, everything = replace(own, axes=((0, 1), (0, 1))), np.ones(GRID.size, bool)
    with pytest.raises(UserError, match="checked on bit rows only"):
        reach_avoid([busy, busy], everything, everything, kind=np.arange(INPUTS) % 2)


def test_a_controller_remembers_the_class_of_what_it_applied_and_what_is_pending():
    kind = np.array([0, 0, 1, 2])
    assert after_choice(None, False, 0, 3) == (3, 0)
    assert after_choice(None, True, 2, 3) == (2, 3)
    assert after_choice(kind, False, 1, 3) == (3, 2)
    # pending input 3 after one of class 1; input 2 is chosen: 3 acts, then 2 is pending after one of class 2
    assert after_choice(kind, True, 3 * 3 + 1, 2) == (3, 2 * 3 + 2)
    applied, after = after_choice(kind, False, np.array([0, 1]), np.array([1, 2]))
    assert applied.tolist() == [1, 2]
    assert after.tolist() == [0, 1]
