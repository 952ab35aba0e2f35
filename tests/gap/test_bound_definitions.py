"""What a bound adds, piece by piece and exactly: rounding of tables, memory and headings, padding, both sides."""

import itertools

import numpy as np
import pytest

from simgap.config.gap import GapSection
from simgap.errors import UserError
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.gap.bounds.previous import PreviousClasses
from simgap.gap.fitting.acceptance import check_fresh, clopper_pearson_upper, covering_remainder
from simgap.gap.lipschitz.grid import GridLipschitz, Layer, bends, estimate, steps, to_cells, worse
from simgap.gap.memory.bound import Robot, assemble_hulls
from simgap.gap.memory.hidden_state import HistoryInfluence, HullFit, Widened, fading, fit_hull, hull
from simgap.gap.sampling.symmetry import SymmetryDeviation
from simgap.geometry import Box, Grid
from simgap.simulators.body_samples import BodySamples
from simgap.statistics import extrapolated_maximum, reach

U = np.array([[-1.0], [0.5]])
TIER = (Tier(1, "Made up."),)


def tables(seed=0):
    """A table of 3 x 2 cells, for two inputs."""
    rng = np.random.default_rng(seed)
    edges = np.array([0.1, 0.4, 0.9, 1.3]), np.array([-0.7, 0.2, 0.6])
    lower = rng.uniform(-1.0, 0.0, (6, 2, 2))
    domain = GapDomain(("a", "b"), ("u",), Box([0.1, -0.7], [1.3, 0.6]), U)
    return CellGap(domain, TIER, edges, lower, lower + rng.uniform(0.1, 1.0, (6, 2, 2)))


def touched(gap, lo, hi):
    """Numbers of the cells that a box touches, shared faces included."""
    for k in itertools.product(range(3), range(2)):
        if all(lo[j] <= gap.edges[j][k[j] + 1] and hi[j] >= gap.edges[j][k[j]] for j in (0, 1)):
            yield k


def test_tables_hold_every_cell_that_a_box_touches_and_are_rounded_outward():
    gap, rng = tables(), np.random.default_rng(4)
    ends = [np.sort(rng.uniform(lo, hi, (120, 2)), axis=1) for lo, hi in ((0.1, 1.3), (-0.7, 0.6))]
    boxes = np.stack(ends, axis=2)
    faces = np.array([[[0.4, 0.2], [0.4, 0.2]], [[0.2, -0.3], [0.4, 0.2]], [[0.9, 0.2], [1.0, 0.3]]])
    for lo, hi in [*boxes, *faces]:
        for m in (0, 1):
            below, above = gap.box_bounds(lo[None], hi[None], U[[m]])
            for k, i in itertools.product(touched(gap, lo, hi), (0, 1)):
                flat = k[0] * 2 + k[1]
                assert above[0, i] > gap.upper[flat, m, i]
                assert below[0, i] < gap.lower[flat, m, i]


def test_a_table_is_raised_in_every_cell_that_a_box_touches():
    """A cell that shares a face alone is raised too: on the face both cells apply."""
    gap, more = tables(), np.array([0.3, 0.0])
    raised = gap.raised_within({"b": (0.2, 0.3)}, more)
    assert raised.upper[:, :, 0] == pytest.approx(gap.upper[:, :, 0] + 0.3)  # b = 0.2 is a border of all
    raised = gap.raised_within({"a": (0.5, 0.7), "b": (0.3, 9.0)}, more)
    own = [k[0] * 2 + k[1] for k in touched(gap, (0.5, 0.3), (0.7, 9.0))]
    others = [n for n in range(6) if n not in own]
    assert own == [3]
    assert raised.upper[own, :, 0] == pytest.approx(gap.upper[own, :, 0] + 0.3)
    assert raised.lower[own, :, 0] == pytest.approx(gap.lower[own, :, 0] - 0.3)
    assert np.array_equal(raised.upper[others], gap.upper[others])
    assert np.array_equal(raised.upper[:, :, 1], gap.upper[:, :, 1])


def test_more_is_left_near_rest_and_its_tier_says_so():
    section = GapSection.model_validate(
        {"basis": ["1"], "remainder": {"a": 0.1}, "remainder_within": [{"where": {"b": [0.4, 0.5]}, "by": {"a": 0.4}}]}
    )
    gap = tables()
    covering = covering_remainder(gap, section)
    x, u = np.array([[0.2, 0.5], [0.2, -0.5]]), U[[0, 0]]
    (lo, hi), (low, high) = gap.bounds(x, u), covering.bounds(x, u)
    assert high[:, 0] - hi[:, 0] == pytest.approx([0.4, 0.1])
    assert lo[:, 0] - low[:, 0] == pytest.approx([0.4, 0.1])
    assert high[:, 1] == pytest.approx(hi[:, 1])
    assert "0.4 for a in the cells with b in [0.4, 0.5]" in str(covering.tiers[-1].to_json())
    with pytest.raises(UserError, match="not states") as refused:
        covering_remainder(gap, section.model_copy(update={"remainder": {"c": 0.1}}))
    assert refused.value.key == "gap.remainder"


@pytest.mark.parametrize(
    ("within", "said"),
    [
        ([{"where": {"b": [0.5, 0.4]}, "by": {"a": 0.4}}], r"where\.b\n.*ends are reversed"),
        ([{"where": {}, "by": {"a": 0.4}}], r"where\n.*at least 1 item"),
        ([{"where": {"b": [0.4, 0.5]}, "by": {"a": -0.4}}], r"by\.a\n.*equal to 0"),
    ],
)
def test_a_mistake_in_where_more_is_left_is_refused(within, said):
    with pytest.raises(ValueError, match=said):
        GapSection.model_validate({"basis": ["1"], "remainder_within": within})


def test_a_table_is_rounded_outward_at_a_point():
    """The rounding pad must be there, for what reads the bound rounds again."""
    gap = tables()
    lo, hi = gap.bounds(np.array([[0.3, -0.1]]), U[:1])
    assert np.all(hi[0] > gap.upper[0, 0])
    assert np.all(lo[0] < gap.lower[0, 0])


def test_suprema_of_a_table_are_those_over_all_cells():
    gap = tables()
    inner = [np.linspace(a + 1e-6, b - 1e-6, 40) for e in gap.edges for a, b in itertools.pairwise(e)]
    rows = np.array(list(itertools.product(np.concatenate(inner[:3]), np.concatenate(inner[3:]))))
    for name, i in (("a", 0), ("b", 1)):
        found = gap.sup()[name]
        for u in U:
            lo, hi = gap.bounds(rows, np.tile(u, (len(rows), 1)))
            assert found.size >= np.maximum(-lo[:, i], hi[:, i]).max() * (1 - 1e-9)
            assert found.width >= (hi - lo)[:, i].max() * (1 - 1e-9)


def hulls_of(axis_margins, swept_margins):
    lower, upper = np.array([[-0.1, -0.3]]), np.array([[0.2, 0.4]])
    made = []
    for own, way in zip(axis_margins, swept_margins, strict=True):
        swept = None if way is None else Widened(np.array([[-0.5, -0.6]]), np.array([[0.7, 0.8]]), way, way)
        made.append(HullFit(Widened(lower, upper, own, own), swept, 100, 100))
    return made


def test_margin_heading_deviation_and_path_between_poses_are_all_added():
    domain = GapDomain(("x", "y", "t"), ("u",), Box([0, 0, -3], [10, 10, 3]), U, (0, 1))
    deviation = (0.004, 0.007, 0.02)
    influences = [HistoryInfluence(np.array([0.01, 0.0, 0.0]), d, 50) for d in deviation]
    robot = Robot(domain, np.zeros((2, 3)), 0.003, 0.5, PreviousClasses.single(2))
    fit = assemble_hulls(robot, hulls_of((0.05, 0.06, 0.03), (0.01, 0.02, None)), influences)
    for i, (own, turned) in enumerate(zip((0.05, 0.06, 0.03), deviation, strict=True)):
        np.testing.assert_allclose(fit.gap.lower[:, i], np.array([-0.1, -0.3]) - own - turned, rtol=1e-12)
        np.testing.assert_allclose(fit.gap.upper[:, i], np.array([0.2, 0.4]) + own + turned, rtol=1e-12)
    for i, way in enumerate((0.01, 0.02)):  # across headings the larger deviation of both axes may show in either
        np.testing.assert_allclose(
            fit.table.swept[0][0, :, i], np.array([-0.5, -0.6]) - way - 0.007 - 0.003, rtol=1e-12
        )
        np.testing.assert_allclose(fit.table.swept[1][0, :, i], np.array([0.7, 0.8]) + way + 0.007 + 0.003, rtol=1e-12)


def test_a_hull_counts_what_sequences_exceed_on_either_side():
    m = np.array([0, 0, 1, 1])
    path = np.zeros((4, 2, 3))
    path[:, -1, 0] = [0.1, 0.3, -0.2, 0.2]
    grid, motion = BodySamples.of_paths(m, path), np.zeros((2, 3))
    for beyond, value in ((0.07, 0.37), (0.05, 0.05)):
        way = np.zeros((1, 2, 3))
        way[0, -1, 0] = value
        fit = fit_hull(0, motion, grid, BodySamples.of_paths(np.array([0]), way))
        assert fit.gap.excess == pytest.approx(beyond)
        assert fit.gap.lower[0].tolist() == pytest.approx([0.1, -0.2])
        assert fit.gap.upper[0].tolist() == pytest.approx([0.3, 0.2])


def test_hulls_and_fading_by_their_definitions():
    lo, hi = hull(np.array([1, 1, 0]), np.array([[2.0], [-3.0], [5.0]]), 2)
    assert lo.tolist() == [[5.0], [-3.0]]
    assert hi.tolist() == [[5.0], [2.0]]
    responses = np.array([[[0.5], [1.0]], [[0.2], [-0.4]], [[0.1], [0.0]]])
    assert fading(responses)[:, 0].tolist() == pytest.approx([1.0, 0.4, 0.0])
    excess = np.array([0.0, 0.1, 0.3, 0.2])
    for dimension in (1, 4):
        r = (1.0 - 0.05 ** (1 / 3)) ** (1 / dimension)
        assert extrapolated_maximum(excess, dimension) == pytest.approx(0.3 + 0.3 * r / (1 - r))
    turned = np.array([[[0.1, 0.0, 0.0]], [[-0.3, 0.0, 0.2]]])
    assert SymmetryDeviation.of_headings(np.zeros((1, 3)), turned).largest.tolist() == pytest.approx([0.3, 0.0, 0.2])


def test_a_body_frame_bound_is_rounded_outward_in_the_heading_too():
    lower, upper = np.full((2, 3), -0.1), np.full((2, 3), 0.2)
    domain = GapDomain(("x", "y", "t"), ("u",), Box([0, 0, -3], [10, 10, 3]), U, (0, 1))
    lo, hi = BodyFrameGap(domain, TIER, lower[None], upper[None]).bounds(np.array([[1.0, 2.0, 0.3]]), U[:1])
    assert lo[0, 2] < -0.1
    assert hi[0, 2] > 0.2


def test_slopes_and_their_change_on_a_parabola():
    """d = x^2 on cells of width 1 from -3: neighbours differ by 2k + 1, second differences are 2 everywhere."""
    grid = Grid(Box([-3.0, 0.0], [5.0, 4.0]), [8, 4])
    d = (grid.centres()[:, :1] + 0.0) ** 2
    step = steps(d.reshape(8, 4, 1), 0, grid)
    assert bends(step, 0, grid)[:, 0, 0].tolist() == [2.0] * 8
    assert to_cells(step, 0, grid)[:, 0, 0].tolist() == [4.0, 4.0, 2.0, 2.0, 4.0, 6.0, 8.0, 8.0]
    found = estimate(d, grid)
    assert found.constants.tolist() == pytest.approx([8.0 + 2.0, 0.0])  # the true one at the face x = 5 is 10


def test_the_worse_of_two_estimates_is_worse_in_every_number():
    left, right = Layer(0, -1.0, 0.0, 0.5), Layer(1, 0.5, 2.0, 0.5)
    a = GridLipschitz(np.array([1.0, 5.0]), np.array([1.0, 1.1]), 0.1, 0.2, np.array([0.5, 0.5]), (left,))
    b = GridLipschitz(np.array([2.0, 4.0]), np.array([1.4, 1.0]), 0.3, 0.1, np.array([1.5, 1.5]), (right,))
    found = worse(a, b)
    assert [found.constants.tolist(), found.ratio.tolist()] == [[2.0, 5.0], [1.4, 1.1]]
    assert (found.rough_share, found.jump) == (0.3, 0.2)
    assert (found.at.tolist(), found.layers) == ([0.5, 0.5], (left, right))


def test_counting_by_hand():
    gap = tables()
    x = np.array([[0.3, -0.1], [0.5, 0.3], [0.2, 0.0]])
    lo, hi = gap.bounds(x, np.tile(U[:1], (3, 1)))
    middle = 0.5 * (lo + hi)
    below, above = middle.copy(), middle.copy()
    below[0, 1], above[2, 0] = lo[0, 1] - 0.1, hi[2, 0] + 0.3
    for d, state, worst in ((below, "b", 0.1), (above, "a", 0.3)):
        check = check_fresh(gap, x, np.tile(U[:1], (3, 1)), d)
        assert (check.violations, check.by_state[state]) == (1, 1)
        assert check.worst[state] == pytest.approx(worst)
    assert check_fresh(gap, x, np.tile(U[:1], (3, 1)), middle, d_upper=above).violations == 1
    # P(at most 2 of 50 outside) = 0.05 at the bound
    p = clopper_pearson_upper(50, 2)
    assert sum(_binomial(50, k) * p**k * (1 - p) ** (50 - k) for k in range(3)) == pytest.approx(0.05, rel=1e-6)


def _binomial(n, k):
    return np.prod([(n - j) / (j + 1) for j in range(k)])


def test_split_conformal_takes_the_rank_of_n_plus_one():
    scores = np.arange(1.0, 20.0)  # 19 scores: rank ceil(20 * .9) = 18
    assert reach(scores, 0.9) == 18.0
    assert reach(scores, 0.951) == np.inf
