"""The paper's pendulum against bare PyBullet: the tightness that is promised, on a coarse grid."""

import pytest

from simgap.gap.bases import Expressions
from simgap.gap.fitting.acceptance import check_fresh
from tests.gap.fit_in_memory import fit_gap
from tests.gap.gap_examples import PAPER, gap_section, off_grid, on_grid, pendulum_gap

pytest.importorskip("pybullet")


@pytest.fixture(scope="module", params=[True, False], ids=["matched inertia", "default inertia"])
def sampled(request, root_path):
    gap = pendulum_gap(root_path, request.param)
    return request.param, gap, on_grid(gap, eps=0.0147)


@pytest.fixture(scope="module")
def root_path():
    from pathlib import Path

    return Path(__file__).parents[2] / "configs" / "models" / "pendulum.urdf"


@pytest.mark.parametrize("sides", ["signed", "unsigned"])
def test_tight_and_covering(sampled, sides):
    matched, gap, samples = sampled
    settings = gap_section(basis=Expressions(terms=PAPER), sides=sides, extreme_value=False)
    result = fit_gap(samples, settings)
    assert check_fresh(result.function, *off_grid(gap, 10_000)).violations == 0
    if matched:
        assert all(dim.sup_over_largest_sample <= 1.05 for dim in result.dimensions)
    if sides == "signed" and not matched:
        assert all(dim.mean_width <= 0.02 * dim.largest_sampled_gap for dim in result.dimensions)


def test_known_lipschitz_constant(sampled):
    """Semi-implicit against explicit Euler: dd1/dx1 = tau^2 3 g / 2 l."""
    matched, _, samples = sampled
    settings = gap_section(basis=Expressions(terms=PAPER))
    found = fit_gap(samples, settings).dimensions[0]
    if matched:
        assert found.lipschitz.constants[0] == pytest.approx(0.005**2 * 1.5 * 9.81, rel=2e-3)
        assert found.lipschitz.constants[0] >= 0.005**2 * 1.5 * 9.81 * 0.9999
    methods = {row.method for row in found.lipschitz_estimates}
    assert methods >= {"grid", "reverse Weibull location", "top-20 spacing, 95 %"}


def test_gap_is_almost_a_function_of_angle_and_torque(root_path):
    """With the engine's own inertia the plant is stronger than declared: a bias that a signed bound removes."""
    samples = on_grid(pendulum_gap(root_path, False), eps=0.0147)
    settings = gap_section(basis=Expressions(terms=PAPER), extreme_value=False)
    signed = fit_gap(samples, settings).dimensions
    unsigned = fit_gap(samples, gap_section(basis=Expressions(terms=PAPER), sides="unsigned", extreme_value=False))
    for one, other in zip(signed, unsigned.dimensions, strict=True):
        assert one.mean_width <= 0.01 * other.mean_width
