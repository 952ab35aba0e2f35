"""Kernels against brute force on tiny grids, cell by cell and input by input."""

import numpy as np
import pytest

from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.input_sets import unpack
from tests.synthesis import synthesis_oracle as oracle

SHAPES = [((13,), ()), ((9, 7), ()), ((9, 7), (1,)), ((5, 4, 6), ()), ((5, 4, 6), (0, 2)), ((3, 4, 3, 4), (1,))]
ROW_SHAPES = [
    ((70, 6), (), ((1,), (1,))),
    ((6, 70), (), ((0,), (0,))),
    ((7, 66, 5), (2,), ((2,), (2,), ())),
    ((5, 4, 6, 3), (3,), ((3,), (1, 3), (3,), (3,))),
]


def masks(found, cells, inputs):
    bits = unpack(found.mask, inputs)
    return {k: np.flatnonzero(bits[i]).tolist() for i, k in enumerate(np.ndindex(*cells)) if bits[i].any()}


@pytest.mark.parametrize(("cells", "periodic"), SHAPES)
@pytest.mark.parametrize("seed", range(4))
def test_invariance_is_the_brute_force_fixed_point(cells, periodic, seed):
    rng = np.random.default_rng([seed, *cells])
    abstraction = oracle.random_abstraction(rng, cells, periodic, inputs=11, spread=1, drift=2)
    safe = rng.random(abstraction.grid.size) < 0.97
    allowed = {k for k, s in zip(np.ndindex(*cells), safe, strict=True) if s}
    inside, good = oracle.invariant(oracle.transitions(abstraction), allowed)
    found = invariance(abstraction, safe, threads=1 + seed % 2)
    assert np.flatnonzero(found.winning).tolist() == oracle.flat(inside, cells)
    assert masks(found, cells, 11) == good
    assert found.pairs == sum(map(len, good.values()))


def test_some_random_invariance_problem_is_neither_empty_nor_full():
    sizes = []
    for seed in range(4):
        rng = np.random.default_rng([seed, 9, 7])
        abstraction = oracle.random_abstraction(rng, (9, 7), (), inputs=11, spread=1, drift=2)
        sizes.append(invariance(abstraction, rng.random(63) < 0.97).winning.mean())
    assert any(0 < size < 1 for size in sizes)


@pytest.mark.parametrize(("cells", "periodic"), SHAPES)
@pytest.mark.parametrize("seed", range(3))
def test_reach_by_table_is_the_brute_force_fixed_point(cells, periodic, seed):
    rng = np.random.default_rng([seed, 1, *cells])
    compare(oracle.random_abstraction(rng, cells, periodic, inputs=9, spread=1), rng, "table")


@pytest.mark.parametrize(("cells", "periodic", "axes"), ROW_SHAPES)
@pytest.mark.parametrize("backend", ["bit_rows", "table"])
@pytest.mark.parametrize("seed", range(3))
def test_both_backends_are_the_brute_force_fixed_point(cells, periodic, axes, backend, seed):
    rng = np.random.default_rng([seed, 2, *cells])
    found = compare(oracle.random_abstraction(rng, cells, periodic, inputs=9, axes=axes), rng, backend)
    assert found.backend == backend


def compare(abstraction, rng, backend):
    cells = abstraction.grid.cells
    size = abstraction.grid.size
    free, target = rng.random(size) < 0.9, rng.random(size) < 0.1
    named = [{k for k, s in zip(np.ndindex(*cells), flags, strict=True) if s} for flags in (target, free)]
    level, good = oracle.reach(oracle.transitions(abstraction), *named)
    found = reach_avoid(abstraction, target, free, threads=2, by_rows=backend == "bit_rows")
    assert found.value.tolist() == [level.get(k, -1) for k in np.ndindex(*cells)]
    assert masks(found, cells, len(abstraction.inputs)) == good
    assert found.steps == max(level.values())
    return found


def test_rows_are_chosen_where_an_axis_allows_it():
    rng = np.random.default_rng(0)
    idle = oracle.random_abstraction(rng, (6, 5), axes=((1,), (1,)))
    busy = oracle.random_abstraction(rng, (6, 5))
    everything = np.ones(30, bool)
    assert reach_avoid(idle, everything, everything).backend == "bit_rows"
    assert reach_avoid(busy, everything, everything).backend == "table"


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_axes_inputs_and_threads_does_not_matter(seed):
    rng = np.random.default_rng([seed, 3])
    cells, inputs = (11, 8), 7
    a = oracle.random_abstraction(rng, cells, inputs=inputs, spread=1, drift=2)
    order = rng.permutation(inputs)
    swapped = permuted(a, order)
    first, second = invariance(a), invariance(swapped, threads=3)
    assert np.array_equal(first.winning.reshape(cells), second.winning.reshape(cells[::-1]).T)
    one = unpack(first.mask, inputs).reshape(*cells, inputs)[..., order]
    other = unpack(second.mask, inputs).reshape(*cells[::-1], inputs).transpose(1, 0, 2)
    assert np.array_equal(one, other)


def permuted(a, order):
    """The same two-dimensional system with axes swapped and inputs in another order."""
    boxes = a.boxes(np.arange(a.grid.size)).reshape(*a.grid.cells, -1, 2, 2)
    swapped = boxes.transpose(1, 0, 2, 3, 4)[:, :, order][..., ::-1]
    cells = a.grid.cells[::-1]
    b = oracle.random_abstraction(np.random.default_rng(0), cells, inputs=len(order))
    k = np.stack(np.meshgrid(*(np.arange(c) for c in cells), indexing="ij"), axis=-1)
    offsets = swapped - k[:, :, None, None, :]
    b.table[:] = offsets.transpose(4, 0, 1, 2, 3).reshape(-1)
    assert np.array_equal(b.boxes(np.arange(b.grid.size)).reshape(swapped.shape), swapped)
    return b
