"""Reach-while-avoid on slabs of bits against the definition, on shapes where rows, words and wrapping matter."""

import itertools

import numpy as np
import pytest

from simgap.geometry import Box, Grid
from simgap.synthesis.abstraction.cells import Abstraction
from simgap.synthesis.abstraction.intersample import SweptCells
from simgap.synthesis.abstraction.post import reduced_cells, table_meta, table_post
from simgap.synthesis.games.reach import Levels, reach_avoid, reach_by_rows
from simgap.synthesis.games.row_moves import RowSystem
from simgap.synthesis.input_sets import unpack

INPUTS = 11
SHAPES = {  # cells, periodic axes, used axes
    "one row below the other": ((66, 9, 4), (2,), (2,)),
    "the bit axis in the middle": ((5, 70, 6), (), (0,)),
    "no second idle axis": ((6, 65), (0,), (0,)),
    "words that are full": ((64, 3), (), (1,)),
    "full words, one row below the other": ((64, 5, 3), (), (2,)),
    "an idle axis that wraps": ((5, 67, 4), (0, 2), (2,)),
    "two used axes": ((40, 7, 3, 4), (3,), (2, 3)),
    "three axes and no second idle one": ((33, 3, 4, 3), (1, 3), (1, 2, 3)),
    "nothing matters": ((20, 6, 3), (), ()),
}


def made_up(shape, seed, swept, far):
    """Boxes up to `far` cells away that depend on the used axes; swept boxes around the start."""
    rng, (cells, periodic, used) = np.random.default_rng(seed), shape
    n = len(cells)
    grid = Grid(Box(np.zeros(n), np.array(cells, float)), cells, periodic)
    layers = reduced_cells(grid, used)
    lower = rng.integers(-far, far + 1, (len(layers), INPUTS, n))
    upper = lower + rng.integers(0, 3, lower.shape)
    lower[:, 3], upper[:, 3] = lower[:, 2], upper[:, 2]  # two inputs that do the same
    table = np.concatenate([np.stack([lower[..., i], upper[..., i]], axis=-1).reshape(-1) for i in range(n)])
    axes = (used,) * n
    meta, _ = table_meta(grid, INPUTS, axes)
    inputs = np.arange(INPUTS, dtype=float)[:, None]
    way = None
    if swept and len(used) == 1:
        grown = rng.integers(0, 2, (2, *lower.shape))  # beyond start and box: of one near the border it leaves the grid
        low, high = np.minimum(lower, 0) // 2 - grown[0], np.maximum(upper, 0) // 2 + grown[1]
        low[..., used[0]] = high[..., used[0]] = 0
        low, high = low.astype(np.int32), high.astype(np.int32)
        way = SweptCells(used[0], low, high)
    own = Abstraction(grid, inputs, table_post(), meta, np.zeros(1), table.astype(np.int32), axes, np.zeros(n), way)
    return own, layers, lower, upper


def offsets(own, layers, lower, upper):
    """Boxes of every cell, (cells, M, n) twice, and its swept boxes or None."""
    grid, used = own.grid, own.axes[0]
    k = np.stack(np.unravel_index(np.arange(grid.size), grid.cells), axis=-1)
    layer = np.zeros(grid.size, int)
    for j in used:
        layer = layer * grid.cells[j] + k[:, j]
    sides = [(k[:, None] + lower[layer], k[:, None] + upper[layer])]
    if own.swept is not None:
        sides.append((k[:, None] + own.swept.lower[layer], k[:, None] + own.swept.upper[layer]))
    return sides


def holds(inside, grid, low, high):
    """Which boxes (cells, M, n) lie in a set, corner to corner, cell by cell."""
    good = np.ones(low.shape[:2], bool)
    for step in itertools.product(*(range(int(d) + 1) for d in (high - low).max(axis=(0, 1)))):
        at, there = low + np.array(step), np.all(low + np.array(step) <= high, axis=2)
        on = np.ones(good.shape, bool)
        for j, count in enumerate(grid.cells):
            if j not in grid.periodic:
                on &= (at[..., j] >= 0) & (at[..., j] < count)
        flat = np.ravel_multi_index(tuple(np.moveaxis(at % np.array(grid.cells), -1, 0)), grid.cells)
        good &= ~there | (on & inside[flat])
    return good


def by_definition(own, layers, lower, upper, target, free):
    """Levels (cells,) and admissible inputs (cells, M), level by level."""
    boxes, *ways = offsets(own, layers, lower, upper)
    value, mask = np.where(target & free, 0, -1), np.zeros((own.grid.size, INPUTS), bool)
    clear = holds(free, own.grid, *ways[0]) if ways else np.ones(mask.shape, bool)
    good, level = np.ones(mask.shape, bool), 0
    while good.any():
        good = holds(value >= 0, own.grid, *boxes) & clear & (free & (value < 0))[:, None]
        level += 1
        mask |= good
        value[good.any(axis=1)] = level
    return value, mask


@pytest.mark.parametrize("name", SHAPES)
def test_levels_and_inputs_are_those_of_the_definition(name):
    won = 0
    for seed in range(5):
        own, *about = made_up(SHAPES[name], seed, swept=seed % 2 == 1, far=2 if seed < 3 else 40)
        rng = np.random.default_rng([seed, 7])
        k = np.stack(np.unravel_index(np.arange(own.grid.size), own.grid.cells), axis=-1)
        target = np.all((k >= np.array(own.grid.cells) // 4) & (k <= 3 * np.array(own.grid.cells) // 4), axis=1)
        if seed in (1, 2):  # up to the border, where a set that a word holds meets the next row
            target = rng.random(own.grid.size) < 0.95
        free = rng.random(own.grid.size) < 0.995
        value, mask = by_definition(own, *about, target, free)
        for threads in (1, 2):
            found = reach_avoid(own, target, free, threads)
            assert found.backend == "bit_rows"
            assert np.array_equal(found.value, value)
            assert np.array_equal(unpack(found.mask, INPUTS), mask)
        order = rng.permutation(INPUTS)
        first = np.where(mask.any(axis=1), order[np.argmax(mask[:, order], axis=1)], -1)
        for by_rows, threads in ((True, 1), (True, 2), (False, 1)):
            if not by_rows and own.swept is not None:
                continue  # the table checks no path
            one = reach_avoid(own, target, free, threads, order=order, by_rows=by_rows)
            assert np.array_equal(one.value, value)
            assert np.array_equal(one.chosen, first)
            assert one.mask.shape == (own.grid.size, 0)
        won += int((value > 0).sum())
    assert won > 20


def test_more_entries_than_there_is_room_for(monkeypatch):
    own, *about = made_up(SHAPES["one row below the other"], 1, swept=False, far=2)
    target = np.arange(own.grid.size) % 66 < 60
    wanted = by_definition(own, *about, target, np.ones(own.grid.size, bool))
    grown = []
    monkeypatch.setattr("simgap.synthesis.games.reach.ENTRIES", 1)
    plain = Levels._make_room
    monkeypatch.setattr(Levels, "_make_room", lambda self, n: grown.append(n) or plain(self, n))
    system = RowSystem.of(own)
    value, mask, _ = reach_by_rows([system], np.zeros(INPUTS, int), target, np.ones(own.grid.size, bool), 2)
    assert len(grown) > 1
    assert np.array_equal(value[:, 0], wanted[0])
    assert np.array_equal(unpack(mask[:, 0], INPUTS), wanted[1])


def test_a_box_turns_with_its_axis_however_far_it_is():
    """An input that turns by 5 turns and a cell on an axis of 4 cells lands one cell on."""
    grid = Grid(Box([0.0, 0.0], [70.0, 4.0]), (70, 4), (1,))
    table = np.array([[[1, 1]]] * 4 + [[[21, 21]]] * 4, np.int32)
    axes = ((1,), (1,))
    meta, _ = table_meta(grid, 1, axes)
    own = Abstraction(grid, np.zeros((1, 1)), table_post(), meta, np.zeros(1), table.reshape(-1), axes, np.zeros(2))
    k = np.stack(np.unravel_index(np.arange(grid.size), grid.cells), axis=-1)
    found = reach_avoid(own, (k[:, 0] == 69) & (k[:, 1] == 0), np.ones(grid.size, bool))
    assert found.value.reshape(70, 4)[68].tolist() == [-1, -1, -1, 1]
    assert found.value.reshape(70, 4)[67].tolist() == [-1, -1, 2, -1]
