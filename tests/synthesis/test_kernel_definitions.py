"""The kernels of a post one by one, against their definitions: cells, rounding, groups, gaps, windows, holes."""

import itertools

import numba as nb
import numpy as np
import pytest

from simgap.geometry import Box, Grid
from simgap.specifications.space import cells_meeting, cells_within
from simgap.synthesis.abstraction.cells import clip_boxes, count_holes, drop_boxes_with_holes, layout
from simgap.synthesis.abstraction.intersample import planar_swept_cells
from simgap.synthesis.abstraction.post import (
    OUTSIDE,
    Frame,
    cell_box,
    gap_adder,
    group_box,
    image,
    to_cells,
    whole_cells,
)
from simgap.synthesis.input_sets import embed, every_input, margins, padded, window_and

GRIDS = [
    Grid(Box([0.1, -0.7], [0.4, 0.9]), [7, 11]),
    Grid(Box([-0.2, -0.5], [0.2, 0.5]), [1000, 500]),
    Grid(Box([1000.1, -3.3], [1001.3, 5.1]), [13, 90]),
]


def around(value, count=6):
    """A number with its nearest neighbours among the floats."""
    out, low, high = [value], value, value
    for _ in range(count):
        low, high = np.nextafter(low, -np.inf), np.nextafter(high, np.inf)
        out += [low, high]
    return np.array(out)


def header(grid, error):
    return Frame(grid, np.zeros((1, 1)), np.asarray(error, float)).header


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("error", [(0.0, 0.0), (0.013, 0.04)])
def test_every_float_that_is_measured_in_a_cell_lies_in_its_box(grid, error):
    """A float beside a face is put into a cell by a division and the box by a product: their rounding differs."""
    head, lo, hi = header(grid, error), np.empty(2), np.empty(2)
    slack = 2.0**-44 * (np.abs(grid.box.lo) + np.abs(grid.box.hi))
    for j in (0, 1):
        for face in range(grid.cells[j] + 1):
            for value in around(grid.box.lo[j] + 2.0 * grid.h[j] * face):
                x = 0.5 * (grid.box.lo + grid.box.hi)
                x[j] = value
                cell = int(grid.index(x[None])[0])
                if cell < 0:
                    continue
                cell_box(np.array(np.unravel_index(cell, grid.cells)), 2, head, lo, hi)
                true = np.clip(value + np.array([-1.0, 1.0]) * error[j], grid.box.lo[j], grid.box.hi[j])
                assert lo[j] <= true[0]
                assert true[1] <= hi[j]
                room = slack[j] if error[j] == 0.0 else 0.0  # the pad itself is there, where no error hides it
                assert lo[j] <= max(grid.box.lo[j], grid.box.lo[j] + 2.0 * grid.h[j] * (cell_of(cell, grid, j))) - room
    assert np.all(np.isfinite(lo))


def cell_of(cell, grid, j):
    return int(np.unravel_index(cell, grid.cells)[j])


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("error", [(0.0, 0.0), (0.013, 0.04)])
def test_every_float_of_an_interval_is_measured_in_one_of_its_cells(grid, error):
    head = header(grid, error)
    for j in (0, 1):
        width = 2.0 * grid.h[j]
        for face in range(1, grid.cells[j]):
            at = grid.box.lo[j] + width * face
            # both ends on a face: rounding may have put the true end on its other side
            first, last = to_cells(at, at, j, 2, head)
            assert first <= face - 1 - np.floor(error[j] / width - 1e-6) * (error[j] > 0)
            assert last >= face + np.floor(error[j] / width + 1e-6)
            for value in around(at):
                for seen in (value - error[j], value, value + error[j]):
                    k = np.floor((seen - grid.box.lo[j]) / width)
                    low, high = to_cells(value, value, j, 2, head)
                    assert low <= k <= high


def test_what_is_not_finite_or_far_away_lies_outside_every_grid():
    head = header(GRIDS[0], (0.0, 0.0))
    for lo, hi in ((-np.inf, 0.2), (0.2, np.inf), (np.nan, 0.2), (-1e30, 0.2), (0.2, 1e30)):
        assert to_cells(lo, hi, 0, 2, head) == (-OUTSIDE, OUTSIDE)


@pytest.mark.parametrize("extra", [0, 1, 4])
def test_a_group_is_the_union_of_its_cells(extra):
    """The box over which a gap is bounded at once holds the last cell of the group as well as the first."""
    grid = GRIDS[0]
    head, work = header(grid, (0.01, 0.02)), np.empty((3, 2))
    index = np.array([2, 3])
    group_box(index, extra, 2, head, work[0], work[1], work[2])
    assert index.tolist() == [2, 3]
    boxes = np.empty((extra + 1, 2, 2))
    for k in range(extra + 1):
        cell_box(np.array([2, 3 + k]), 2, head, boxes[k, 0], boxes[k, 1])
    assert np.array_equal(work[0], boxes[:, 0].min(axis=0))
    assert np.array_equal(work[1], boxes[:, 1].max(axis=0))


@nb.njit
def bent(lo, hi, u, v):
    """x1^2 - x2 and 2 x1 + x2 at a point, as intervals."""
    a, b = lo[0] * lo[0] - lo[1], 2.0 * lo[0] + lo[1]
    return ((a, a), (b, b))


@nb.njit
def bent_slopes(lo, hi, u, v):
    return ((2.0 * lo[0], 2.0 * hi[0]), (-1.0, -1.0), (2.0, 2.0), (1.0, 1.0))


@nb.njit
def uneven(xlo, xhi, u, lo, hi):
    lo[0], lo[1] = -0.5, -0.25 + u[0]
    hi[0], hi[1] = 2.0, 3.0 + u[0]


def test_the_image_of_a_box_holds_the_image_of_its_corners():
    over, work = image(bent, bent_slopes), np.empty(2)
    for lo, hi in (([-1.0, 0.0], [-0.5, 0.3]), ([0.2, -1.0], [0.9, 1.0]), ([-0.3, 0.0], [0.5, 0.1])):
        low, high = np.empty(2), np.empty(2)
        over(np.array(lo), np.array(hi), np.zeros(1), 2, low, high, work)
        for x in itertools.product(*zip(lo, hi, strict=True)):
            value = np.array([x[0] ** 2 - x[1], 2 * x[0] + x[1]])
            assert np.all(low <= value + 1e-12)
            assert np.all(value <= high + 1e-12)


def test_a_gap_moves_both_ends_of_a_table():
    grid, inputs = GRIDS[0], np.array([[0.1], [0.7]])
    head = Frame(grid, inputs, np.zeros(2)).header
    for i in (0, 1):
        out = np.zeros((1, 1, 2, 2))
        gap_adder(uneven)(np.array([[1, 1]]), np.array([i]), head, inputs, out)
        assert out[0, 0, :, 0].tolist() == ([-0.5, -0.5] if i == 0 else [-0.25 + 0.1, -0.25 + 0.7])
        assert out[0, 0, :, 1].tolist() == ([2.0, 2.0] if i == 0 else [3.1, 3.7])


def test_offsets_from_a_centre_become_whole_cells():
    grid = Grid(Box([0.0, 0.0], [10.0, 20.0]), [10, 10])
    out = np.empty((1, 2, 2), np.int32)
    offsets = np.array([[[-0.7, 0.4], [0.6, 1.7]]])
    whole_cells(offsets, 0, 2, header(grid, (0.0, 0.0)), out)
    # from the centre at 0.5 of cell 0: [-0.2, 0.9] and [1.1, 2.2]
    assert out.tolist() == [[[-1, 0], [1, 2]]]


@pytest.mark.parametrize("periodic", [(), (1,), (0, 1)])
@pytest.mark.parametrize("margin", [(0, 1), (1, 2), (2, 0)])
def test_a_window_is_the_and_over_every_cell_within_the_margin_with_the_seam(periodic, margin):
    grid = Grid(Box([0.0, 0.0], [1.0, 1.0]), [5, 6], periodic)
    values = np.random.default_rng(3).integers(0, 2**63, (30, 2), dtype=np.uint64) | np.uint64(0xF0F0F0F0F0F0F0F0)
    found = window_and(values, grid, margin)
    shaped = values.reshape(5, 6, 2)
    for a, b in itertools.product(range(5), range(6)):
        wanted = np.full(2, 2**64 - 1, np.uint64)
        for da, db in itertools.product(range(-margin[0], margin[0] + 1), range(-margin[1], margin[1] + 1)):
            k = [a + da, b + db]
            for j, cells in enumerate(grid.cells):
                k[j] = k[j] % cells if j in periodic else k[j]
            if 0 <= k[0] < 5 and 0 <= k[1] < 6:
                wanted &= shaped[k[0], k[1]]
        assert np.array_equal(found.reshape(5, 6, 2)[a, b], wanted)


def test_margins_hold_the_error_and_outside_is_what_is_said():
    grid = Grid(Box([0.0, 0.0], [1.0, 1.0]), [10, 10], (1,))
    assert margins(grid, np.array([0.1, 0.0])) == (2, 0)  # a full cell and its face
    assert margins(grid, np.array([0.05, 0.21])) == (1, 3)
    larger = padded(grid, (2, 3))
    assert larger.cells == (14, 10)
    assert larger.box.lo == pytest.approx([-0.2, 0.0])
    assert larger.box.hi == pytest.approx([1.2, 1.0])
    rows = embed(np.zeros((100, 1), np.uint64), grid, larger, every_input(5)).reshape(14, 10)
    assert (rows[[0, 1, 12, 13]] == 31).all()
    assert (rows[2:12] == 0).all()


@pytest.mark.parametrize(("cells", "periodic"), [((5, 4), ()), ((5, 4), (1,)), ((3, 4, 5), (2,)), ((3, 2, 4, 3), (0,))])
def test_a_box_counts_where_it_has_no_hole(cells, periodic):
    rng, n = np.random.default_rng(8), len(cells)
    inside = (rng.random(cells) < 0.8).astype(np.uint8)
    shape = layout(cells, periodic)
    table = count_holes(inside.reshape(-1), shape, n)
    lower = rng.integers(-2, 4, (300, n))
    wide = rng.integers(0, 3, (300, n))
    wide[:60, list(periodic)] += np.array(cells)[list(periodic)] - 1  # nearly a turn, a turn, and more
    boxes = np.concatenate([lower, lower + wide], axis=1).astype(np.int32)
    given, ok = boxes.copy(), np.empty(300, np.uint8)
    flat = boxes.reshape(-1)
    clip_boxes(shape, n, flat, 0, 300, ok)
    drop_boxes_with_holes(table, shape, n, flat, 0, 300, ok)
    for box, found in zip(given, ok, strict=True):
        wanted = True
        for k in itertools.product(*(range(box[j], box[n + j] + 1) for j in range(n))):
            at = [v % cells[j] if j in periodic else v for j, v in enumerate(k)]
            within = all(0 <= v < c for v, c in zip(at, cells, strict=True))
            wanted = wanted and within and bool(inside[tuple(at)])
        assert bool(found) == wanted


@pytest.mark.parametrize("error", [None, np.array([0.0, 0.0, 0.2])])
def test_swept_cells_hold_every_point_of_a_box_at_every_heading(error):
    grid = Grid(Box([0.0, 0.0, -np.pi], [10.0, 10.0, np.pi]), [200, 200, 8], (2,))
    lower, upper = np.array([[-0.1, -0.2]]), np.array([[0.9, 0.25]])
    swept, off = planar_swept_cells(grid, lower, upper, error=error), 0.0 if error is None else 0.2
    rng = np.random.default_rng(6)
    for layer in range(8):
        theta = -np.pi + (np.pi / 4) * layer + rng.uniform(-off, np.pi / 4 + off, 400)
        theta = np.concatenate([theta, [-np.pi + (np.pi / 4) * layer - off, -np.pi + (np.pi / 4) * (layer + 1) + off]])
        corner = np.array(list(itertools.product([-0.1, 0.9], [-0.2, 0.25])))
        for a, b in corner:
            moved = np.stack([np.cos(theta) * a - np.sin(theta) * b, np.sin(theta) * a + np.cos(theta) * b], axis=1)
            for start in (1e-6, 0.05 - 1e-6):  # in a cell of width 0.05
                k = np.floor((moved + start) / 0.05)
                assert np.all(k >= swept.lower[layer, 0, :2])
                assert np.all(k <= swept.upper[layer, 0, :2])


def test_cells_within_and_meeting_at_faces_and_across_a_seam():
    grid = Grid(Box([0.0, 0.0], [4.0, 4.0]), [4, 4], (1,))
    within = cells_within(grid, Box([1.0, -1.0], [2.5, 1.0])).reshape(4, 4)
    assert np.argwhere(within).tolist() == [[1, 0], [1, 3]]
    meeting = cells_meeting(grid, Box([1.0, 3.5], [2.5, 4.5])).reshape(4, 4)
    assert np.argwhere(meeting).tolist() == [[1, 0], [1, 3], [2, 0], [2, 3]]


@pytest.mark.parametrize("hole", range(4))
def test_a_box_of_a_full_turn_meets_every_cell_of_it(hole):
    inside = np.ones((2, 4), np.uint8)
    inside[:, hole] = 0
    shape = layout((2, 4), (1,))
    table, ok = count_holes(inside.reshape(-1), shape, 2), np.empty(1, np.uint8)
    for first, last in ((0, 3), (1, 4), (-1, 3), (2, 9), (-5, -1)):
        box = np.array([0, first, 1, last], np.int32)
        clip_boxes(shape, 2, box, 0, 1, ok)
        drop_boxes_with_holes(table, shape, 2, box, 0, 1, ok)
        assert not ok[0]
