"""The body-frame bound against rotations done point by point, and the checks of a declared symmetry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simgap.errors import BrokenPromise, UserError
from simgap.gap.bounds.body_frame import BodyFrameGap, nominal_motion, rotated_box
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.gap.bounds.load import from_json
from simgap.gap.sampling.symmetry import SymmetryDeviation
from simgap.geometry import Box
from simgap.io.results import read_json, write_json
from simgap.simulators.body_samples import to_body

NAMES = ("x", "y", "theta")
U = np.array([[0.0, 0.0], [0.5, -1.0], [0.5, 1.0]])


def domain():
    return GapDomain(NAMES, ("v", "w"), Box([0, 0, -np.pi], [10, 10, np.pi]), U, (0, 1))


def example(seed=0):
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-0.3, 0.1, (3, 3))
    return BodyFrameGap(domain(), (Tier(1, "Made up."),), lower[None], (lower + rng.uniform(0.0, 0.3, (3, 3)))[None])


def turn(theta, d):
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([c * d[:, 0] - s * d[:, 1], s * d[:, 0] + c * d[:, 1], d[:, 2]], axis=1)


finite = st.floats(-2.0, 2.0)


@settings(max_examples=200, deadline=None)
@given(
    st.floats(-7.0, 7.0), st.floats(0.0, 7.0), finite, st.floats(0, 1), finite, st.floats(0, 1), st.integers(0, 10**6)
)
def test_every_rotated_point_is_in_the_hull_and_the_hull_is_tight(t0, wide, a, da, b, db, seed):
    rng = np.random.default_rng(seed)
    x0, x1, y0, y1 = rotated_box(t0, t0 + wide, a, a + da, b, b + db)
    theta = np.concatenate([rng.uniform(t0, t0 + wide, 300), np.linspace(t0, t0 + wide, 300)])
    corners = rng.integers(2, size=(600, 2))
    points = np.stack([a + da * corners[:, 0], b + db * corners[:, 1], theta], axis=1)
    seen = turn(theta, points)
    assert (seen[:, :2] >= [x0, y0]).all()
    assert (seen[:, :2] <= [x1, y1]).all()
    every = np.concatenate([turn(np.linspace(t0, t0 + wide, 2000), np.tile([p, q, 0.0], (2000, 1)))
                            for p in (a, a + da) for q in (b, b + db)])  # fmt: skip
    slack = 1e-4 * (1 + np.abs(every).max())
    assert x0 >= every[:, 0].min() - slack
    assert y1 <= every[:, 1].max() + slack


def test_the_world_bound_holds_every_body_gap_at_every_heading():
    gap, rng = example(), np.random.default_rng(4)
    m, theta = rng.integers(3, size=5000), rng.uniform(-np.pi, np.pi, 5000)
    d = rng.uniform(gap.lower[m], gap.upper[m])
    x = np.stack([rng.uniform(0, 10, 5000), rng.uniform(0, 10, 5000), theta], axis=1)
    lo, hi = gap.bounds(x, U[m])
    assert (lo <= turn(theta, d)).all()
    assert (turn(theta, d) <= hi).all()
    size = np.maximum(np.abs(lo), np.abs(hi)).max(axis=0)
    sup = gap.sup()
    assert all(size[i] <= sup[s].size and (hi - lo).max(axis=0)[i] <= sup[s].width for i, s in enumerate(NAMES))


def test_kernel_bounds_over_boxes_cover_those_at_points_and_ignore_the_position():
    gap, rng = example(1), np.random.default_rng(5)
    kernel = gap.kernel()
    lo, hi = np.empty(3), np.empty(3)
    for _ in range(200):
        a = np.array([rng.uniform(-50, 50), rng.uniform(-50, 50), rng.uniform(-np.pi, 3.0)])
        b = a + 0.1
        m = rng.integers(3)
        kernel(a, b, U[m], lo, hi)
        points = rng.uniform(a, b, (50, 3))
        plo, phi = gap.bounds(points, np.tile(U[m], (50, 1)))
        assert (lo <= plo.min(axis=0) + 1e-12).all()
        assert (hi >= phi.max(axis=0) - 1e-12).all()
    kernel(np.array([1.0, 1.0, 4.0]), np.array([1.0, 1.0, 5.0]), U[0], lo, hi)
    assert np.isinf(lo).all()  # beyond the heading's range there is no bound
    kernel(np.zeros(3), np.zeros(3), np.array([0.123, 0.0]), lo, hi)
    assert np.isinf(hi).all()  # nor for an input outside U


def test_json_keeps_the_bound():
    gap = example(2)
    again = from_json(gap.to_json())
    x, u = np.random.default_rng(0).uniform(-3, 3, (20, 3)), np.tile(U[1], (20, 1))
    assert all(np.array_equal(a, b) for a, b in zip(gap.bounds(x, u), again.bounds(x, u), strict=True))


@pytest.mark.parametrize("pose", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
def test_the_file_keeps_order_of_states_free_axes_kernel_and_tiers(tmp_path, pose):
    i, j, k = pose
    names, lo, hi = [""] * 3, np.zeros(3), np.full(3, 10.0)
    names[i], names[j], names[k], lo[k], hi[k] = "x", "y", "theta", -np.pi, np.pi
    given = GapDomain(tuple(names), ("v", "w"), Box(lo, hi), U, (i, j))
    rng = np.random.default_rng(8)
    lower = rng.uniform(-0.3, 0.1, (3, 3))
    tiers = (Tier(2, "an estimate"), Tier(3, "checked"))
    gap = BodyFrameGap(given, tiers, lower[None], (lower + rng.uniform(0.0, 0.3, (3, 3)))[None], pose)
    write_json(tmp_path / "gap.json", gap.to_json())
    again = from_json(read_json(tmp_path / "gap.json"))
    assert isinstance(again, BodyFrameGap)
    assert (again.pose, again.tiers, again.domain.free) == (pose, tiers, (i, j))
    assert again.domain.states == given.states
    kernels, ends = (gap.kernel(), again.kernel()), [(np.empty(3), np.empty(3)) for _ in range(2)]
    for _ in range(50):
        a = rng.uniform(-3, 3, 3)
        for kernel, (low, high) in zip(kernels, ends, strict=True):
            kernel(a, a + 0.1, U[1], low, high)
        assert np.array_equal(*ends)
        body = rng.uniform(gap.lower[1], gap.upper[1])  # any gap within the table, turned by any heading of the box
        heading = a[k] + 0.1 * rng.random()
        d = turn(heading, body[None, [i, j, k]])[0]
        low, high = ends[1]
        assert np.all((low[[i, j, k]] <= d) & (d <= high[[i, j, k]]))


@pytest.mark.parametrize("lost", ["pose", "gap", "domain", "guarantee", "kind"])
def test_a_damaged_file_is_refused_in_one_line(lost):
    data = example().to_json()
    del data[lost]
    with pytest.raises(UserError, match="not a saved gap bound"):
        from_json(data)
    with pytest.raises(UserError, match="not a saved gap bound"):
        from_json(example().to_json() | {"pose": ["x", "y", "nothing"]})


def test_to_body_undoes_the_heading():
    rng = np.random.default_rng(6)
    d, theta = rng.normal(size=(50, 3)), rng.uniform(-4, 4, 50)
    assert np.abs(to_body(turn(theta, d), theta) - d).max() < 1e-12


def arc(x, u):
    return x + np.stack([u[:, 0] * np.cos(x[:, 2]), u[:, 0] * np.sin(x[:, 2]), u[:, 1]], axis=1)


def test_the_nominal_motion_is_refused_when_the_symmetry_is_false():
    motion = nominal_motion(arc, np.array([5.0, 5, 0]), U, (0, 1, 2), np.random.default_rng(0))
    assert np.allclose(motion, [[0, 0, 0], [0.5, 0, -1], [0.5, 0, 1]])
    slope = lambda x, u: arc(x, u) + 0.01 * x[:, :1] * [1, 0, 0]  # noqa: E731
    with pytest.raises(UserError, match="symmetry is declared but false"):
        nominal_motion(slope, np.array([5.0, 5, 0]), U, (0, 1, 2), np.random.default_rng(0))


def test_a_deviation_above_the_tolerance_breaks_the_promise_with_both_numbers():
    reference = np.zeros((4, 3))
    turned = np.zeros((2, 4, 3))
    turned[1, 2, 2] = -0.07
    deviation = SymmetryDeviation.of_headings(reference, turned)
    assert deviation.largest == pytest.approx([0, 0, 0.07])
    deviation.check(NAMES, {"x": 0.01, "y": 0.01, "theta": 0.08})
    with pytest.raises(BrokenPromise, match=r"theta deviates by 0\.07.*allows 0\.05"):
        deviation.check(NAMES, {"x": 0.01, "y": 0.01, "theta": 0.05})
