"""Where a grid of samples has to be fine, on gaps whose answer is known by hand."""

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.extras.refine import COUNTS, LINES, POINTS, at_count, counts_for, movement, random_lines, refine
from simgap.geometry import Box

BOX, INPUTS = Box([-1.0, -2.0, 0.0], [1.0, 2.0, 1.0]), np.array([[-1.0], [1.0]])


def moved_by(gap):
    """`movement` along each axis of a gap (n, nx), (n, nu) -> (n,)."""
    rng, found = np.random.default_rng(3), []
    for axis in range(3):
        lines = random_lines(BOX, INPUTS, axis, rng)
        found.append(movement(gap(*lines).reshape(LINES, POINTS, 1)))
    return found


def test_a_straight_gap_moves_by_half_a_cell_times_its_slope():
    moved = moved_by(lambda x, u: 3.0 * x[:, 1] + 5.0 * u[:, 0])
    for count in COUNTS:
        inner = 0.5 * 4.0 / count - 0.5 * 4.0 / POINTS  # the outermost points stand half a part inside the cell
        assert moved[1][count] == pytest.approx(3.0 * inner)
        assert moved[0][count] == moved[2][count] == pytest.approx(0.0, abs=1e-12)
    assert moved[1][8][0] < at_count(moved[1], 7)[0] < moved[1][6][0]
    assert at_count(moved[1], 8) == pytest.approx(moved[1][8])


def test_cells_go_where_the_gap_bends_and_no_more_than_there_may_be():
    moved = moved_by(lambda x, u: np.tanh(x[:, 1] / 0.1) + 0.1 * x[:, 0])
    counts = counts_for(moved, np.ones(1), 4 * 4 * 96)
    assert counts[1] > 2 * max(counts[0], counts[2])
    assert np.prod(counts) <= 4 * 4 * 96
    even = counts_for(moved_by(lambda x, u: x.sum(axis=1)), np.ones(1), 6**3)
    assert even[1] >= even[0]  # its axis is twice as long, and the gap moves as much by length
    assert min(even) >= COUNTS[0]


def test_states_weigh_as_they_are_told():
    moved = [{n: np.array([1.0, 0.0]) / n for n in COUNTS}, {n: np.array([0.0, 1.0]) / n for n in COUNTS}]
    first, second = counts_for(moved, np.array([10.0, 1.0]), 400)
    assert first > 2 * second
    assert counts_for(moved, np.array([1.0, 10.0]), 400) == (second, first)


def test_a_case_is_told_its_section(root):
    """The speed of the pendulum's gap bends along both states; few samples are refused with how many it takes."""
    case, said = root / "configs/cases/pendulum.yaml", []
    found = refine(case, 20_000, said.append)
    assert 19_000 < found.samples <= 20_000  # what the counts that are weighed leave is spread over the axes
    assert np.prod(list(found.cells.values())) * 25 == found.samples
    assert all(found.then[n] > found.now[n] for n in found.then)  # the case has 12 million now
    assert f"x1: {found.half_widths['x1']:.4g}" in found.block()
    assert "roll-outs on lines" in said[-1]
    with pytest.raises(UserError, match="Give at least 400"):
        refine(case, 100, said.append)
