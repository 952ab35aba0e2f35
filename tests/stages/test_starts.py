"""Closed-loop runs begin where they prove something: outside the target, on faces and corners too."""

from types import SimpleNamespace

import numpy as np

from simgap.config.controller import AuditSection, Trials, ValidationSection
from simgap.geometry import Box, Grid, points_of_cells
from simgap.specifications.solution import Solution
from simgap.stages.validation import draw_starts, starts_by_kind
from simgap.synthesis.controller import Controller

GRID = Grid(Box([0.1, -0.3], [1.3, 0.7]), (12, 7))


def controller(winning, target=None, held=False):
    value = None if target is None else np.where(winning, np.where(target, 0, 1), -1).astype(np.int32)
    served = winning if target is None or held else winning & ~target
    mask = served.astype(np.uint8)[:, None]
    solution = Solution(GRID, winning, mask, np.ones(GRID.size, bool), value, target)
    return Controller(np.array([[0.0]]), ("a", "b"), ("u",), solution, "least_effort", {})


def checkerboard():
    return np.indices(GRID.cells).sum(axis=0).reshape(-1) % 2 == 0


def test_every_start_is_in_a_winning_cell_whose_neighbours_lose():
    own = controller(checkerboard())
    starts = draw_starts(own, 4000, 3)
    assert own.contains(starts).all()


def test_faces_and_corners_are_among_the_starts():
    starts = draw_starts(controller(checkerboard()), 4000, 3)
    place = (starts - GRID.box.lo) / (2.0 * GRID.h)
    on_face = np.abs(place - np.round(place)) < 1e-9
    count = on_face.sum(axis=1)
    assert 0.15 < (count == 1).mean() < 0.35
    assert 0.15 < (count == 2).mean() < 0.35
    low = np.abs(place - np.floor(place)) < 1e-9  # lower faces and, nudged inward, upper ones
    assert 0.3 < low[on_face].mean() < 0.7


def test_no_run_begins_in_the_target():
    winning = np.ones(GRID.size, bool)
    target = np.arange(GRID.size) >= GRID.size // 3  # most of what is won
    own = controller(winning, target)
    assert not own.in_target(draw_starts(own, 500, 1)).any()


def test_a_target_that_is_to_be_held_is_started_from():
    winning = np.ones(GRID.size, bool)
    own = controller(winning, winning, held=True)
    assert own.in_target(draw_starts(own, 50, 1)).all()


def test_points_on_faces_are_their_cells_own():
    rng = np.random.default_rng(5)
    for cells in ((1000, 500), (37, 41)):
        grid = Grid(Box([-np.pi, 1e-3], [np.pi, 7.1]), cells, (0,))
        chosen = rng.integers(0, grid.size, 5000)
        place = rng.choice([-1.0, 1.0], (5000, 2))
        assert np.array_equal(grid.index(points_of_cells(grid, chosen, place)), chosen)


def test_both_controllers_begin_at_the_same_states():
    context, section = SimpleNamespace(states=("a", "b")), ValidationSection(starts=300, steps=1)
    left = np.arange(GRID.size) < GRID.size // 2
    for nominal, shared in ((checkerboard(), checkerboard() & left), (left, left)):
        begin = starts_by_kind(context, section, controller(left), {"nominal": controller(nominal)}, Trials.FULL)
        assert controller(left).contains(begin["gap"].x).all()
        assert begin["gap"].numbers.tolist() == list(range(300))
        both = controller(shared).contains(begin["gap"].x)
        np.testing.assert_array_equal(begin["nominal"].x, begin["gap"].x[both])
        np.testing.assert_array_equal(begin["nominal"].x, begin["gap"].x[begin["nominal"].numbers])
    apart = starts_by_kind(context, section, controller(left), {"nominal": controller(~left)}, Trials.FULL)
    assert controller(~left).contains(apart["nominal"].x).all()
    assert apart["nominal"].numbers.tolist() == list(range(300, 600))


def test_a_plain_run_takes_fewer_starts_than_a_full_one_and_fewer_still_to_compare_with():
    everywhere = controller(np.ones(GRID.size, bool))
    context, section = SimpleNamespace(states=("a", "b")), ValidationSection(steps=1)
    plain = starts_by_kind(context, section, everywhere, {"nominal": everywhere})
    full = starts_by_kind(context, section, everywhere, {"nominal": everywhere}, Trials.FULL)
    assert [len(plain[kind].x) for kind in ("gap", "nominal")] == [300, 200]
    assert [len(full[kind].x) for kind in ("gap", "nominal")] == [1000, 1000]
    given = starts_by_kind(context, ValidationSection(starts=7, steps=1), everywhere, {"nominal": everywhere})
    assert [len(given[kind].x) for kind in ("gap", "nominal")] == [7, 7]  # what a case says is done


def test_the_adversary_has_the_budget_of_its_run_unless_the_case_says_it():
    assert AuditSection().budget(histories=False) == (200_000, 20_000)
    assert AuditSection().budget(False, Trials.FULL) == (1_000_000, 100_000)
    assert AuditSection().budget(True, Trials.FULL) == (30_000, 10_000)
    given = AuditSection(evaluations=5, steps=400_000)
    assert given.budget(True, Trials.FULL) == (5, 400_000)
    assert given.budget(True, Trials.DEEP) == (300_000, 400_000)
