"""Every sampled successor lies in the computed box, and every winning cell has an input that keeps it winning."""

from dataclasses import replace
from fractions import Fraction
from math import floor

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from simgap.geometry import Box, Grid
from simgap.model.sampled import NominalModel
from simgap.specifications.invariance import Invariance
from simgap.specifications.space import Space
from simgap.synthesis.abstraction import cells as abstraction
from simgap.synthesis.abstraction.cells import nominal_abstraction
from simgap.synthesis.games import nodes
from simgap.synthesis.games.game import NodeGame
from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.reach import reach_avoid
from simgap.synthesis.input_sets import unpack
from tests.synthesis.synthesis_plants import (
    constant_gap,
    pendulum,
    random_plant,
    rubbing,
    sloped_gap,
    small_slope,
    unicycle,
)

RELAXED = settings(max_examples=20, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
GAPS = {
    "none": (None, None, lambda x, u: (0 * x, 0 * x)),
    "constant": (constant_gap(0.01, 0.02, 0.005), (), lambda x, u: (-sizes(x), sizes(x))),
    "sloped": (
        sloped_gap(),
        (0,),
        lambda x, u: (slope(x), slope(x) + 0.01 * np.abs(u[:, :1])),
    ),
}


def sizes(x):
    return np.tile([0.01, 0.02, 0.005], (len(x), 1))[:, : x.shape[1]]


def slope(x):
    return 0.02 * x[:, :1] + 0.01 * np.arange(x.shape[1])


def plant(name):
    if name == "pendulum":
        return (*pendulum(), Box([-0.2, -0.5], [0.2, 0.5]), ())
    if name == "unicycle":
        inputs = np.array([(v, w) for v in (-0.3, 0.0, 0.25) for w in (-0.5, 0.1, 0.4)])
        return unicycle(), inputs, Box([0, 0, -np.pi], [3, 2, np.pi]), (2,)
    inputs = np.linspace(-1, 1, 5)[:, None]
    if name == "rubbing":
        return rubbing(), inputs, Box([-1.0, -1.0], [1.0, 1.0]), ()
    return random_plant(int(name)), inputs, Box([-1.0, -1.5], [1.2, 1.0]), ()


def test_where_the_nominal_model_jumps_the_box_is_as_wide_as_the_jump():
    model, inputs, box, _ = plant("rubbing")
    grid = Grid(box, (11, 11))
    found = nominal_abstraction(model, grid, inputs).boxes(grid.index(np.zeros((1, 2))))
    assert (found[0, :, 1] - found[0, :, 0]).max() <= 3


def test_a_bounded_term_of_a_quotient_without_bound_is_covered():
    x, v, u = sp.symbols("x v u", real=True)
    model = NominalModel((x, v), (u,), (x, v + 0.3 * sp.Min(1, sp.Abs(v) / x)), 0.05)
    grid = Grid(Box([0.0, 0.0], [1.0, 1.0]), (10, 10))
    low, high = nominal_abstraction(model, grid, np.zeros((1, 1))).boxes(np.zeros(1, np.int64))[0, 0]
    assert low[1] <= 0, "from (0.05, 0)"
    assert high[1] >= 3, "from (0.05, 0.05)"


@pytest.mark.parametrize(
    ("name", "gap", "named"),
    [
        ("pendulum", "none", True),
        ("pendulum", "constant", True),
        ("pendulum", "sloped", False),
        ("unicycle", "constant", True),
        ("unicycle", "sloped", False),
        ("rubbing", "constant", True),
        ("0", "none", True),
        ("0", "sloped", False),
        ("1", "constant", False),
        ("2", "sloped", True),
    ],
)
def test_every_sampled_successor_lies_in_the_box(name, gap, named):
    model, inputs, box, periodic = plant(name)
    kernel, axes, truth = GAPS[gap]

    @given(seed=st.integers(0, 10**6), counts=st.lists(st.integers(2, 60), min_size=3, max_size=3), blur=st.booleans())
    @RELAXED
    def check(seed, counts, blur):
        rng = np.random.default_rng(seed)
        grid = Grid(box, counts[: box.size], periodic)
        error = rng.uniform(0, 2, box.size) * grid.h if blur else np.zeros(box.size)
        a = nominal_abstraction(model, grid, inputs, kernel, axes if named else None, error)
        cells, m = rng.integers(grid.size, size=200), rng.integers(len(inputs), size=200)
        corner = rng.integers(3, size=(200, box.size)) - 1.0  # centres, faces and corners, then the inside
        place = np.where(rng.random((200, 1)) < 0.5, corner, rng.uniform(-1, 1, corner.shape))
        measured = grid.centres()[cells] + place * grid.h
        x = measured + error * rng.choice([-1.0, 0.3, 1.0], size=measured.shape)
        ends = [j for j in range(box.size) if j not in periodic]
        x[:, ends] = np.clip(x, box.lo, box.hi)[:, ends]
        lo, hi = truth(x, inputs[m])
        d = lo + (hi - lo) * rng.choice([0.0, 0.5, 1.0], size=x.shape)
        after = model.step(x, inputs[m]) + d + error * rng.choice([-1.0, 1.0], size=x.shape)
        boxes = a.boxes(cells)[np.arange(200), m]
        k = (after - box.lo) / (2 * grid.h)
        assert np.all(boxes[:, 0] <= k + 1e-9)
        assert np.all(k <= boxes[:, 1] + 1 + 1e-9)

    check()


def test_boxes_are_tight():
    """Not sound by being useless: the box is no wider than spread, gap and two cells of rounding to whole cells."""
    model, inputs = pendulum()
    grid = Grid(Box([0, -0.5], [0.2, 0.5]), (100, 80))
    boxes = nominal_abstraction(model, grid, inputs, constant_gap(1e-3, 1e-3), ()).boxes(np.arange(grid.size))
    wide = boxes[:, :, 1] - boxes[:, :, 0] + 1
    r = grid.h
    spread = np.array([r[0] + 0.005 * r[1], 1.5 * 9.81 * 0.005 * r[0] + r[1]]) + 1e-3
    assert np.all(wide <= 2 * spread / (2 * r) + 2)


@pytest.mark.parametrize("gap", GAPS)
def test_tables_and_direct_evaluation_agree(gap, monkeypatch):
    model, inputs, box, periodic = plant("unicycle")
    kernel, axes, _ = GAPS[gap]
    grid = Grid(box, (7, 6, 9), periodic)
    cells = np.arange(grid.size)
    tables = nominal_abstraction(model, grid, inputs, kernel, () if axes is None else axes).boxes(cells)
    only_small_tables(monkeypatch)
    mixed = nominal_abstraction(model, grid, inputs, kernel, None).boxes(cells)
    monkeypatch.setattr("simgap.synthesis.abstraction.cells._fits", lambda *_: False)
    direct = nominal_abstraction(model, grid, inputs, kernel, None).boxes(cells)
    for other in (mixed, direct):
        assert np.mean(tables != other) < 1e-3  # ties at a cell's face may round differently
        assert np.max(np.abs(tables - other)) <= 1


def only_small_tables(monkeypatch):
    """As on a grid too large to tabulate anything that depends on every axis."""
    monkeypatch.setattr("simgap.synthesis.abstraction.cells._fits", lambda grid, inputs, axes: max(map(len, axes)) < 2)


def test_bounding_the_gap_over_groups_of_cells_changes_no_result(monkeypatch):
    only_small_tables(monkeypatch)
    model, inputs = pendulum()
    grid = Grid(Box([0, -0.5], [0.2, 0.5]), (130, 77))
    a = nominal_abstraction(model, grid, inputs, small_slope())
    assert a.group > 1
    grouped, alone = invariance(a), invariance(replace(a, group=1), threads=2)
    assert 0.3 < alone.winning.mean() < 1
    assert np.array_equal(grouped.mask, alone.mask)
    assert grouped.pairs == alone.pairs == unpack(alone.mask, 25).sum()


@pytest.mark.parametrize("cells", [(40, 30), (33, 57)])
def test_a_winning_cell_has_an_input_whose_box_stays_winning(cells):
    model, inputs = pendulum()
    region = Box([0, -0.5], [0.2, 0.5])
    grid = Grid(region, [10 * c for c in cells])
    a = nominal_abstraction(model, grid, inputs, constant_gap(1e-4, 1e-4), ())
    space = Space(("x1", "x2"), region)
    game = NodeGame((a,), space, np.zeros(2))
    solution = Invariance(kind="invariance", safe={"x1": (0.0, 0.2)}).solve(game)
    assert 0.3 < solution.fraction < 1
    winning = solution.winning.reshape(grid.cells)
    rng = np.random.default_rng(0)
    cells_seen = rng.choice(np.flatnonzero(solution.winning), 400)
    boxes = a.boxes(cells_seen)
    for cell, row in zip(cells_seen, boxes, strict=True):
        stays = [
            bool(np.all(lo >= 0) and np.all(hi < grid.cells) and winning[lo[0] : hi[0] + 1, lo[1] : hi[1] + 1].all())
            for lo, hi in row
        ]
        assert np.array_equal(stays, unpack(solution.mask[cell], 25))
        assert any(stays)


@pytest.mark.parametrize("name", ["pendulum", "rubbing"])
def test_boxes_that_are_kept_are_those_that_are_made_again_at_every_level(name, monkeypatch):
    model, inputs, region, periodic = plant(name)
    grid = Grid(region, (61, 46), periodic)
    monkeypatch.setattr(abstraction, "_fits", lambda *of: False)
    a = nominal_abstraction(model, grid, inputs)
    target = (np.abs(grid.centres()) < 0.4 * region.hi).all(axis=1)
    kept = reach_avoid(a, target, np.ones(grid.size, bool), by_rows=False)
    monkeypatch.setattr(nodes, "MOST_KEPT", 0)
    again = reach_avoid(a, target, np.ones(grid.size, bool), by_rows=False)
    assert target.sum() < kept.winning.sum()
    assert np.array_equal(kept.value, again.value)
    assert np.array_equal(kept.mask, again.mask)


def test_a_periodic_reach_with_gap_goes_down_every_step():
    model = unicycle()
    inputs = np.array([(v, w) for v in (0.0, 0.2, 0.3) for w in (-0.4, 0.0, 0.4)])
    grid = Grid(Box([0, 0, -np.pi], [3, 2, np.pi]), (30, 20, 24), (2,))
    gap = constant_gap(0.003, 0.003, 0.01)
    a = nominal_abstraction(model, grid, inputs, gap, ())
    centres = grid.centres()
    target = (centres[:, 0] > 2) & (centres[:, 1] < 1)
    found = reach_avoid(a, target, np.ones(grid.size, bool))
    assert found.backend == "bit_rows"
    assert found.winning.mean() > target.mean() + 0.2
    rng = np.random.default_rng(3)
    x = centres[rng.choice(np.flatnonzero(found.value > 0), 200)]
    left = found.value[grid.index(x)]
    bits = unpack(found.mask, len(inputs))
    for _ in range(int(left.max())):
        running = left > 0
        choice = np.array([rng.choice(np.flatnonzero(b)) if b.any() else 0 for b in bits[grid.index(x)]])
        moved = model.step(x, inputs[choice]) + rng.choice([-1, 1], x.shape) * np.array([0.003, 0.003, 0.01])
        x = np.where(running[:, None], moved, x)
        now = found.value[grid.index(x)]
        assert np.all(now[running] < left[running])
        left = now
    assert np.all(left == 0)


@pytest.mark.parametrize("gap", ["none", "constant"])
def test_boxes_of_a_map_that_is_affine_in_x_are_the_smallest(gap):
    """Against fractions: cells of the exact image of a cell, found at its corners; its matrix depends on the input."""
    a, b, s = sp.symbols("a b s", real=True)
    half = Fraction(1, 2)
    exact = {s_: ((1 - half * s_, Fraction(1, 4)), (-Fraction(1, 8), 1 + s_ * Fraction(1, 16))) for s_ in (0, 1)}
    rule = (a - s * a / 2 + b / 4 + s * sp.Rational(1, 3), b + s * b / 16 - a / 8 - sp.Rational(1, 7))
    model = NominalModel((a, b), (s,), rule, 0.1)
    grid = Grid(Box([0.0, -1.0], [2.0, 1.0]), (11, 13))
    kernel, axes, _ = GAPS[gap]
    kernel = constant_gap(0.01, 0.02) if gap == "constant" else kernel
    added = (Fraction(0.01), Fraction(0.02)) if gap == "constant" else (0, 0)
    boxes = nominal_abstraction(model, grid, np.array([[0.0], [1.0]]), kernel, axes).boxes(np.arange(grid.size))
    width = Fraction(2, 11), Fraction(2, 13)
    for cell, (i, j) in enumerate(np.ndindex(*grid.cells)):
        corners = [((i + p) * width[0], (j + q) * width[1] - 1) for p in (0, 1) for q in (0, 1)]
        for m, row in exact.items():
            moved = m * Fraction(1, 3), -Fraction(1, 7)
            for k, low in enumerate((0, -1)):
                ends = [row[k][0] * x + row[k][1] * y + moved[k] - low for x, y in corners]
                wanted = [floor((min(ends) - added[k]) / width[k]), floor((max(ends) + added[k]) / width[k])]
                assert boxes[cell, m, :, k].tolist() == wanted, (cell, m, k)
