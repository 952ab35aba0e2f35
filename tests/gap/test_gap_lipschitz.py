import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import weibull_max

from simgap.errors import BrokenPromise, UserError
from simgap.gap.checked_bound import check_resolved
from simgap.gap.fitting.dimension_fit import fit_dimension
from simgap.gap.lipschitz.estimates import dimension_lipschitz, fit_reverse_weibull, profile_upper
from simgap.gap.lipschitz.grid import DimensionLipschitz, GridLipschitz, estimate, roughness
from simgap.gap.lipschitz.local import FitSlopes, LocalPadding, OffGrid
from simgap.gap.sampling.borders import Borders
from simgap.gap.sampling.samples import SampleGrid
from simgap.gap.sampling.values import in_memory
from simgap.gap.sampling.values import values as given
from simgap.geometry import Box, Grid
from simgap.io.arrays_on_disk import room_in
from simgap.statistics import extrapolated_maximum
from tests.gap.gap_examples import U, X, coulomb, gap_section, on_grid, smooth


def values(function, grid):
    return function(grid.centres())[:, None]


FUNCTIONS = {
    "plane": (lambda x: 3.0 * x[:, 0] - 2.0 * x[:, 1], [3.0, 2.0]),
    "product of sines": (
        lambda x: np.sin(3 * x[:, 0]) * np.cos(2 * x[:, 1]),
        [3.0, 2.0 * np.sin(2 * 0.5) * np.sin(0.6)],
    ),
    "tanh": (lambda x: np.tanh(x[:, 1] / 0.05), [0.0, 20.0]),
    "kink": (lambda x: np.abs(x[:, 0] - 0.03), [1.0, 0.0]),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_grid_estimate_covers_the_true_constants(name):
    function, true = FUNCTIONS[name]
    grid = Grid.covering(X, 0.005)
    found = estimate(values(function, grid), grid)
    assert found.resolved
    assert np.all(found.constants >= np.array(true) * (1 - 1e-12))
    if name != "kink":
        assert np.all(found.constants <= np.array(true) * 1.06 + 1e-6)


@pytest.mark.parametrize("cells", [100, 101])  # the jump between two samples, and on one
def test_a_jump_is_not_lipschitz_and_is_found(cells):
    grid = Grid(X, [20, cells])
    found = estimate(values(lambda x: np.sign(x[:, 1]), grid), grid)
    assert not found.resolved
    assert found.ratio[1] == pytest.approx(2.0)
    assert found.ratio[0] == 1.0


def test_rough_cells_are_those_around_the_jump():
    grid = Grid(X, [20, 100])
    d = values(lambda x: np.sign(x[:, 1]) + x[:, 0] + x[:, 1], grid)
    found = estimate(d, grid)
    assert 0.0 < found.rough_share <= 0.06
    (layer,) = found.layers
    np.testing.assert_allclose([layer.axis, layer.lo, layer.hi], [1, -0.02, 0.02], atol=1e-12)
    assert found.jump >= 2.0


def test_a_jump_is_told_with_its_place_and_size_and_a_bend_as_a_bend():
    grid = Grid(X, [20, 100])
    jump = estimate(values(lambda x: np.sign(x[:, 1]) + x[:, 0], grid), grid)
    said = jump.place(("q", "v"))
    assert "jumps by up to 2" in said
    assert "something switches near v = " in said
    assert "< q <" not in said  # it lies along all of q
    assert "no jump" in estimate(values(lambda x: np.sin(x[:, 0]), grid), grid).place(("q", "v"))


def test_two_joints_that_rub_are_told_apart_and_the_remedy_is_of_a_jump():
    """Friction of two joints: a box around the rough cells holds all of X, two layers cross it."""
    names, box = ("q", "v", "w"), Box([-1, -1, -1], [1, 1, 1])
    grid = Grid(box, [8, 20, 24])
    samples = values(lambda x: 0.3 * np.sign(x[:, 1]) + (0.2 + 0.1 * x[:, 0]) * np.sign(x[:, 2] - 0.25), grid)
    found = estimate(samples, grid)
    said = found.place(names)
    assert "something switches near v = 0 and near w = 0.25, such as dry friction" in said
    assert found.at is not None
    assert (abs(found.at[1]) < 0.2, abs(found.at[2] - 0.25) < 0.2, found.at[0] > 0.6) == (True, True, True)
    assert f"the largest beside q = {found.at[0]:.3g}, v = {found.at[1]:.3g}" in said
    again = GridLipschitz.from_json(json.loads(json.dumps(found.to_json())))
    assert again.place(names) == said
    where = SampleGrid(grid, np.zeros((1, 1)), names, ("u",))
    known = [DimensionLipschitz(found, (), 1.0)]
    with pytest.raises(BrokenPromise) as caught:
        check_resolved(where, gap_section(rough_limit=0.01), known * 3)
    limit = float(re.search(r"rough_limit: ([\d.]+)", str(caught.value)).group(1))
    assert found.rough_share < limit <= found.rough_share + 0.07
    assert "Declare what switches in plant.effects too" in str(caught.value)
    check_resolved(where, gap_section(rough_limit=limit), known * 3)


@pytest.mark.parametrize("at_rest", [0.0, 0.2, -0.3])
def test_a_jump_on_a_sample_is_rough_too(at_rest):
    """Dry friction sampled at v = 0: half of the jump on either side, which no single difference gives away."""
    grid = Grid(X, [20, 101])
    d = values(lambda x: np.where(np.abs(x[:, 1]) < 1e-9, at_rest, np.sign(x[:, 1])) + x[:, 0], grid)
    found = estimate(d, grid)
    assert not found.resolved
    assert 0.0 < found.rough_share <= 0.06
    (layer,) = found.layers
    assert layer.axis == 1
    assert layer.lo < -grid.h[1] < grid.h[1] < layer.hi
    assert found.jump >= 2.0


def test_smooth_functions_are_not_rough():
    rng = np.random.default_rng(7)
    for cells in ([20, 40], [41, 33]):
        grid = Grid(X, cells)
        a, b, c = rng.uniform(-3, 3, 3)
        d = values(lambda x, a=a, b=b, c=c: np.sin(a * x[:, 0] + b) * np.exp(c * x[:, 1]) + np.abs(x[:, 0]), grid)
        assert not roughness(given(d), grid, (0, 1), 1e-14).any


def test_a_jump_over_the_seam_of_a_periodic_axis_is_rough():
    grid = Grid(Box([-np.pi, 0.0], [np.pi, 1.0]), [64, 8], (0,))
    found = estimate(values(lambda x: x[:, 0], grid), grid)
    assert 0.0 < found.rough_share <= 0.1


def test_rounding_is_not_rough():
    grid = Grid(X, [20, 20])
    d = values(lambda x: 1e-16 * np.random.default_rng(0).standard_normal(len(x)), grid)
    assert not roughness(given(d), grid, (0, 1), 1e-14).any
    assert estimate(d, grid, floor=1e-14).resolved


def test_periodic_axis_sees_the_seam():
    box = Box([-np.pi, 0.0], [np.pi, 1.0])
    for periodic in ((), (0,)):
        grid = Grid(box, [64, 8], periodic)
        found = estimate(values(lambda x: x[:, 0] / np.pi, grid), grid)
        assert found.resolved == (not periodic)
    grid = Grid(box, [64, 8], (0,))
    assert estimate(values(lambda x: np.sin(x[:, 0]), grid), grid).constants[0] == pytest.approx(1.0, abs=0.01)


def test_too_few_cells_are_refused_but_not_along_free_axes():
    grid = Grid(X, [1, 50])
    d = values(lambda x: x[:, 1], grid)
    with pytest.raises(UserError, match="smaller eps"):
        estimate(d, grid)
    assert estimate(d, grid, free=(0,)).constants[0] == 0.0


@pytest.mark.parametrize("function", [smooth, coulomb])
@pytest.mark.parametrize("eps", [0.05, 0.02, 0.0147])
def test_local_padding_covers_the_cell(function, eps):
    """d anywhere in a cell exceeds its sample by at most the padding: a dense scan is the oracle."""
    samples = on_grid(function, eps)
    target = samples.dimension(1).side(upper=True)
    pad, _ = LocalPadding(target, samples.grid, (), 1e-14).of()
    rng = np.random.default_rng(2)
    for _ in range(20):
        inside = samples.grid.centres() + samples.grid.h * rng.uniform(-1, 1, (samples.grid.size, 2))
        x = np.broadcast_to(inside[:, None], (samples.grid.size, len(U), 2))
        there = function(x, np.broadcast_to(U, (samples.grid.size, len(U), 1)))[:, :, 1]
        assert (there - target.whole() - pad.whole()).max() <= 1e-15


def test_local_padding_does_not_trust_the_samples_of_the_fit():
    """A fit that agrees with the samples but turns inside the cells must be paid for."""
    grid = Grid(X, [10, 10])
    target = given(np.zeros((grid.size, 1)))
    curvature = np.array([[0.0, 0.0], [0.0, 400.0]])
    pad, _ = LocalPadding(target, grid, (), 0.0).of(FitSlopes(target, lambda j: target, curvature))
    assert pad.ends()[0] >= 0.5 * 400.0 * grid.h[1] ** 2 * (1 - 1e-12)


def test_reverse_weibull_recovers_its_parameters():
    maxima = weibull_max(2.5, loc=7.0, scale=0.8).rvs(4000, random_state=np.random.default_rng(4))
    law = fit_reverse_weibull(maxima)
    assert law.location == pytest.approx(7.0, abs=0.05)
    assert law.shape == pytest.approx(2.5, rel=0.1)
    assert law.ks_p > 0.01
    assert law.log_likelihood >= weibull_max(2.5, loc=7.0, scale=0.8).logpdf(maxima).sum()
    assert profile_upper(maxima, law) > law.location


def test_profile_limit_covers_about_as_often_as_it_says():
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(40):
        maxima = weibull_max(3.0, loc=1.0, scale=0.1).rvs(100, random_state=rng)
        hits += profile_upper(maxima, fit_reverse_weibull(maxima)) >= 1.0
    assert hits >= 33  # 95 % of 40 is 38; 33 is more than three standard deviations below


def test_slopes_that_differ_by_rounding_alone_are_given_no_law():
    plane = on_grid(lambda x, u: 10.0 + 0.002 * x, eps=0.05)
    row = dimension_lipschitz(plane.dimension(0), gap_section()).estimates[-1]
    assert row.note == "all blocks agree"
    assert row.value == pytest.approx(0.002)


def test_the_spacing_limit_lies_beyond_the_largest_slope():
    rng = np.random.default_rng(6)
    a = X.sample(rng, 5000)
    b = np.clip(a + rng.uniform(-0.03, 0.03, a.shape), X.lo, X.hi)
    g = [2.0 * x[:, 0] + np.sin(x[:, 1]) for x in (a, b)]
    slopes = np.abs(g[0] - g[1]) / np.linalg.norm(a - b, axis=1)
    assert extrapolated_maximum(slopes, 4) >= np.hypot(2.0, 1.0) >= slopes.max()


def in_pieces(monkeypatch, tmp_path):
    """From here on a layer of cells and an input at a time, from files."""
    monkeypatch.setattr("simgap.gap.lipschitz.grid.PIECE", 1)
    return room_in(tmp_path, held=0)


@pytest.mark.parametrize("periodic", [(), (0,)])
@pytest.mark.parametrize("jump", [0.0, 3.0])
def test_layers_and_inputs_one_at_a_time_give_the_same_bits(monkeypatch, tmp_path, periodic, jump):
    grid = Grid(Box([-1.0, 0.0], [1.0, 2.0]), (24, 9), periodic)
    x, rng = grid.centres(), np.random.default_rng(7)
    d = np.sin(np.pi * x[:, [0]]) * rng.uniform(0.5, 1.5, 5) + 0.1 * x[:, [1]] ** 2
    d[:, 3] += jump * (x[:, 0] > 0.3)
    whole, rough = estimate(d, grid), roughness(given(d), grid, (0, 1), 0.0)
    assert rough.any == (jump > 0.0)
    stored = in_pieces(monkeypatch, tmp_path)(d.shape)
    stored.put(0, d)
    apart = estimate(stored, grid)
    assert roughness(stored, grid, (0, 1), 0.0) == rough
    for name, value in vars(whole).items():
        assert np.array_equal(getattr(apart, name), value), name
    assert not list(tmp_path.iterdir())  # the file has no name


@pytest.mark.parametrize("jump", [0.0, 3.0])
def test_local_paddings_in_pieces_are_the_same_bits(monkeypatch, tmp_path, jump):
    grid = Grid(Box([-1.0, 0.0], [1.0, 2.0]), (24, 9))
    x, rng = grid.centres(), np.random.default_rng(8)
    t = np.sin(3.0 * x[:, [0]]) * rng.uniform(0.5, 1.5, 5) + jump * (x[:, [0]] > 0.3) * np.arange(5)
    slope = [given(np.broadcast_to(s, t.shape)) for s in (3.0 * np.cos(3.0 * x[:, [0]]), np.full((1, 5), 0.2))]
    fit = FitSlopes(given(np.sin(3.0 * x[:, [0]]) * np.ones(5)), slope.__getitem__, np.eye(2))
    at = Borders(x[[3, 40, 100]], np.array([[True, False], [False, True], [False, False]]), np.arange(3))
    beside = OffGrid(np.array([3, 40, 100]), at, t[[3, 40, 100]])

    def results(room):
        own = LocalPadding(given(t), grid, (), 0.0, room)
        pad, share = own.of(fit)
        return pad.whole(), np.array(share), *own.along(beside, fit), own.of()[0].whole()

    whole = results(in_memory)
    assert (whole[1] > 0.0) == (jump > 0.0)
    pieces = results(in_pieces(monkeypatch, tmp_path))
    assert all(np.array_equal(a, b) for a, b in zip(whole, pieces, strict=True))


@pytest.mark.parametrize("function", [smooth, coulomb])
def test_a_bound_from_files_is_that_from_memory(monkeypatch, tmp_path, function):
    """More samples than one block holds, so that sums, too, are of parts."""
    part = on_grid(function, 0.01).dimension(1)
    monkeypatch.setattr("simgap.gap.sampling.values.BLOCK", 2**12)
    assert part.d.size > 2**13
    settings = gap_section(rough_limit=1.0)
    whole = fit_dimension(part, settings).to_json(), dimension_lipschitz(part, settings).to_json()
    room = in_pieces(monkeypatch, tmp_path)
    stored = room(part.d.shape)
    stored.put(0, part.d.whole())
    kept = replace(part, d=stored, room=room)
    assert (fit_dimension(kept, settings).to_json(), dimension_lipschitz(kept, settings).to_json()) == whole
