"""Border and switching states against lists written from their definitions."""

import itertools

import numpy as np
import pytest
import sympy as sp

from simgap.gap.bases import Blocks, Monomials
from simgap.gap.bounds.function import GapDomain
from simgap.gap.sampling.borders import BESIDE, Directed, critical_points, kinks, switching_surfaces, thinned_count
from simgap.geometry import Box, Grid
from simgap.model.symbolic import symbol
from simgap.plants.context import Context
from tests.gap.fit_in_memory import GapSamples, fit_gap
from tests.gap.gap_examples import gap_section

A, V, U = (symbol(name) for name in ("a", "v", "u"))


def domain(lo=(-0.3, 0.0), hi=(0.2, 0.5), free=()):
    return GapDomain(("a", "v"), ("u",), Box(lo, hi), np.array([[-1.0], [0.5]]), free)


def rows(x):
    return {tuple(row) for row in x.tolist()}


def test_faces_edges_and_corners_on_the_lattice():
    box = Box([0.0, 0.0, 0.0], [1.0, 2.0, 3.0])
    cube = GapDomain(("a", "v", "w"), ("u",), box, np.zeros((1, 1)))
    lattice = [np.array([0.5]), np.array([0.5, 1.5]), np.array([1.0])]
    found = critical_points(cube, (), lattice)
    ends = [(0.0, hi) for hi in (1.0, 2.0, 3.0)]
    every = itertools.product(*((*own, *two) for own, two in zip(map(list, lattice), ends, strict=True)))
    wanted = {x for x in every if any(value in two for value, two in zip(x, ends, strict=True))}
    assert rows(found.x) == wanted
    assert len(found.x) == len(wanted)
    for x, fixed in zip(found.x.tolist(), found.fixed.tolist(), strict=True):
        assert fixed == [value in two for value, two in zip(x, ends, strict=True)]


def test_both_sides_of_rest_and_rest_itself_inside_and_on_the_border():
    inside = critical_points(domain((-0.3, -0.5), (0.2, 0.4)), (V,), [np.array([0.1]), np.array([0.3])])
    at = {v for a, v in rows(inside.x) if a == 0.1}
    assert at == {-0.5, 0.4, -BESIDE * 0.9, 0.0, BESIDE * 0.9}
    border = critical_points(domain(), (V,), [np.array([0.1]), np.array([0.3])])
    assert {v for a, v in rows(border.x) if a == 0.1} == {0.0, BESIDE * 0.5, 0.5}


def test_a_surface_that_leans_is_met_on_every_line_and_by_every_input():
    surface = V - A - 0.2 + 0.1 * U
    found = critical_points(domain(), (surface,)).x
    values = np.array([[v - a - 0.2 + 0.1 * u for u in (-1.0, 0.5)] for a, v in found])
    near = np.abs(values) <= 2.1 * BESIDE
    for k in (0, 1):
        hits = values[near[:, k], k]
        assert len(hits) > 30
        assert (hits < 0).any()
        assert (hits > 0).any()


def test_what_misses_X_or_depends_on_no_state_adds_nothing():
    plain = critical_points(domain()).x
    for surface in (V - 7.0, U - 0.3):
        assert np.array_equal(critical_points(domain(), (surface,)).x, plain)


def test_nothing_is_fixed_along_a_free_axis():
    found = critical_points(domain(free=(0,)))
    assert set(found.x[:, 0]) == {0.5 * (-0.3 + 0.2)}
    assert not found.fixed[:, 0].any()


def test_a_lattice_with_too_many_states_is_thinned_but_keeps_its_corners():
    lattice = [np.linspace(-0.29, 0.19, 400), np.linspace(0.01, 0.49, 400)]
    found = critical_points(domain(), (), lattice, most=200)
    assert len(found.x) <= 200
    assert set(itertools.product((-0.3, 0.2), (0.0, 0.5))) <= rows(found.x)


def test_kinks_of_equations():
    found = kinks([sp.sign(V) * 2 + sp.Abs(A - 1), sp.Max(A, V, evaluate=False)])
    assert set(found) >= {V, A - 1}
    assert A - V in found or V - A in found


FRICTION = {
    "coulomb_friction": ({"F_c": 0.01}, {0.0}),
    "stribeck_friction": ({"F_c": 0.01, "F_s": 0.02, "v_s": 0.04},
                          {0.0, 0.01, -0.01, 0.02, -0.02, 0.04, -0.04, 0.08, -0.08}),
}  # fmt: skip


@pytest.mark.parametrize("name", FRICTION)
@pytest.mark.parametrize("side", ["simulator.effects", "plant.effects"])
def test_a_case_with_friction_switches_at_rest(vary, name, side):
    values, speeds = FRICTION[name]
    context = Context.load(vary("pendulum", {side: [{"name": name, "on": "hinge", "parameters": values}]}))
    speed = symbol("x2")
    found = [float(sp.solve(e, speed)[0]) for e in switching_surfaces(context) if speed in e.free_symbols]
    assert sorted(set(found)) == pytest.approx(sorted(speeds))


def test_commands_and_end_stops_of_a_case(root, vary, tmp_path):
    urdf = tmp_path / "stopped.urdf"
    content = (root / "configs" / "models" / "pendulum.urdf").read_text()
    urdf.write_text(content.replace('lower="-12.6" upper="12.6"', 'lower="-0.1" upper="0.15"'))
    effects = [{"name": "input_dead_zone", "on": "u", "parameters": {"width": 0.2}},
               {"name": "input_saturation", "on": "u", "parameters": {"limit": 0.9}}]  # fmt: skip
    context = Context.load(vary("pendulum", {"plant.urdf": str(urdf), "simulator.effects": effects}))
    found = switching_surfaces(context)
    x1, u = symbol("x1"), symbol("u")
    stops = sorted(float(sp.solve(e, x1)[0]) for e in found if x1 in e.free_symbols)
    commands = sorted(float(sp.solve(e, u)[0]) for e in found if u in e.free_symbols)
    assert stops == pytest.approx([-0.1, 0.15])
    assert commands == pytest.approx([-0.9, -0.2, 0.2, 0.9])


def test_a_smooth_case_has_no_surface_inside_X(vary):
    context = Context.load(vary("pendulum", {}))
    where = GapDomain(tuple(context.states), tuple(context.inputs), context.box, context.input_set)
    with_stops = critical_points(where, switching_surfaces(context))
    assert np.array_equal(with_stops.x, critical_points(where).x)


@pytest.mark.parametrize("shape", [(4, 3), (7, 7, 7), (40, 40, 40, 40), (1, 40, 1, 40)])
def test_what_will_be_listed_is_counted_before_it_is_listed(shape):
    """In four dimensions a full lattice of 42^4 points is neither built nor rolled out."""
    nx, most = len(shape), 2_000
    free = tuple(j for j, n in enumerate(shape) if n == 1)
    names = tuple(f"x{j}" for j in range(nx))
    cube = GapDomain(names, ("u",), Box([0.0] * nx, [1.0] * nx), np.zeros((1, 1)), free)
    rng = np.random.default_rng(0)
    found = critical_points(cube, (), [rng.uniform(0.0, 1.0, n) for n in shape], most)
    assert len(found.x) == thinned_count(shape, free, most) <= most
    on_border = ((found.x == 0.0) | (found.x == 1.0)).any(axis=1)
    assert on_border.all()
    assert len(rows(found.x)) == len(found.x)


def test_neighbours_lie_on_one_side_of_one_surface():
    """Along a, the states beside v = 0 are joined on each side by themselves, and each face of X along v."""
    found = critical_points(domain(lo=(-0.3, -0.5)), [V], [np.linspace(-0.25, 0.15, 5), np.array([-0.2, 0.2])])
    before, after = found.neighbours(0).T
    for k, state in enumerate(found.x):
        line = {tuple(found.x[i]) for i in (before[k], k, after[k])}
        if found.fixed[k, 0]:
            assert line == {tuple(state)}
            continue
        assert {v for _, v in line} == {state[1]}
        inner = sorted(a for a, v in rows(found.x) if v == state[1] and -0.3 < a < 0.2)
        at = inner.index(state[0])
        assert sorted(a for a, _ in line) == inner[max(at - 1, 0) : at + 2]


@pytest.mark.parametrize("basis", [Blocks(kind="blocks", blocks=(20, 20)), Monomials(degree=2)])
def test_a_gap_that_is_steep_beside_a_surface_alone_is_covered_there(basis):
    """What sticks within a step is flat at every cell centre, and steep along the surface between the samples on it."""
    box, inputs = Box([-0.2, -0.5], [0.2, 0.5]), np.array([[-1.0], [1.0]])

    def gap(x, u):
        stuck = np.abs(x[..., 1]) < 1e-3
        d = 1e-3 * u[..., 0] + np.where(stuck, 0.4 * np.abs(x[..., 0] - 0.013), 0.0)
        return np.stack([0.01 * d, d], axis=-1)

    def at_all_inputs(x):
        return gap(np.repeat(x[:, None], 2, axis=1), inputs[None].repeat(len(x), axis=0))

    grid, names = Grid(box, (20, 20)), (("a", "v"), ("u",))
    beside = critical_points(GapDomain(*names, box, inputs), [V], [grid.axis(j) for j in range(2)])
    there = np.moveaxis(at_all_inputs(beside.x), -1, 0)
    directed = tuple(Directed(beside, own, own) for own in there)
    samples = GapSamples(grid, inputs, at_all_inputs(grid.centres()), *names, directed=directed)
    bound = fit_gap(samples, gap_section(basis=basis, rough_limit=1.0)).function
    rng = np.random.default_rng(41)
    x = np.stack([rng.uniform(-0.2, 0.2, 4000), rng.choice([-1e-9, 0.0, 1e-9], 4000)], axis=1)
    u = inputs[rng.integers(0, 2, 4000)]
    lower, upper = bound.bounds(x, u)
    assert np.all((lower <= gap(x, u)) & (gap(x, u) <= upper))


@pytest.mark.parametrize("basis", [Blocks(kind="blocks", blocks=(5, 5)), Monomials(degree=1)])
def test_both_ends_of_a_range_on_a_surface_are_covered(basis):
    """What an engine spreads where the speed turns round, it spreads there alone."""
    box, inputs = Box([-0.2, -0.5], [0.2, 0.5]), np.array([[-1.0], [1.0]])
    grid, names = Grid(box, (20, 20)), (("a", "v"), ("u",))
    beside = critical_points(GapDomain(*names, box, inputs), [V], [grid.axis(j) for j in range(2)])
    own, flat = np.full((len(beside.x), 2), 0.05), np.zeros((grid.size, 2, 2))
    directed = tuple(Directed(beside, -2.0 * own, own) for _ in range(2))
    bound = fit_gap(GapSamples(grid, inputs, flat, *names, directed=directed), gap_section(basis=basis)).function
    at = beside.x[np.abs(beside.x[:, 1]) < 1e-9]
    assert len(at) > 20
    for u in inputs:
        lower, upper = bound.bounds(at, np.repeat(u[None], len(at), axis=0))
        assert np.all((lower <= -0.1) & (upper >= 0.05))
