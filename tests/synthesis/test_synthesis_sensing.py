"""Measurement error and latency against brute force, and in closed loop against the worst corner."""

import itertools

import numpy as np
import pytest

from simgap.geometry import Box
from simgap.specifications.invariance import Invariance
from simgap.specifications.space import Space
from simgap.synthesis.controller import Controller
from simgap.synthesis.input_sets import unpack
from simgap.synthesis.synthesise import SynthesisProblem, synthesise
from tests.synthesis import synthesis_oracle as oracle
from tests.synthesis.synthesis_plants import constant_gap, held_by_measurements, pendulum


@pytest.mark.parametrize("seed", range(6))
def test_latency_alone_is_the_brute_force_game_on_pairs(seed):
    rng = np.random.default_rng([seed, 5])
    cells, inputs = (8, 7), 6
    abstraction = oracle.random_abstraction(rng, cells, (1,), inputs, spread=1, drift=1)
    pairs = oracle.delayed(oracle.transitions(abstraction), inputs)
    found = held_by_measurements(abstraction, np.zeros(2), late=True, first=seed % inputs)
    rows = unpack(found.mask, inputs).reshape(*cells, inputs, inputs)
    assert {(k, p) for *k, p in map(tuple, np.argwhere(rows.any(-1))) for k in [tuple(k)]} == pairs
    may = unpack(found.acting, inputs).reshape(*cells, inputs)
    assert {(k, p) for *k, p in map(tuple, np.argwhere(may)) for k in [tuple(k)]} == pairs
    # a run starts where the input that acts before the first measurement arrives may act
    starts = {k for k, w in zip(np.ndindex(*cells), found.winning, strict=True) if w}
    assert starts == {k for k, p in pairs if p == seed % inputs}


@pytest.mark.parametrize("seed", range(6))
def test_with_error_every_measurement_of_a_winning_cell_keeps_it_winning(seed):
    rng = np.random.default_rng([seed, 6])
    cells, inputs = (14, 13), 12
    abstraction = oracle.random_abstraction(rng, cells, (), inputs, axes=((0,), (1,)), spread=1, drift=2)
    moves = oracle.transitions(abstraction)
    found = held_by_measurements(abstraction, 0.9 * 2 * abstraction.grid.h * np.array([1, 0]))
    wins = {tuple(k) for k in np.argwhere(found.winning.reshape(found.grid.cells)) - [1, 0]}
    bits = unpack(found.mask, inputs).reshape(*found.grid.cells, inputs)
    for a, b in wins:
        for y in range(a - 1, a + 2):
            admissible = np.flatnonzero(bits[y + 1, b])
            assert len(admissible) > 0
            assert all(moves[a, b][m] <= wins for m in admissible)


@pytest.mark.parametrize(("latency", "error"), [(0, (1e-3, 1e-2)), (1, (0, 0)), (1, (1e-3, 1e-2))])
def test_the_pendulum_stays_safe_under_error_and_latency(latency, error):
    model, inputs = pendulum()
    size, error = np.array([1.6e-4, 1.3e-4]), np.array(error)
    safe = Box([0.0, -0.5], [0.2, 0.5])
    specification = Invariance(kind="invariance", safe={"x1": (0.0, 0.2)})
    space = Space(("x1", "x2"), Box([-0.2, -0.5], [0.2, 0.5]))
    gap = constant_gap(*size)
    problem = SynthesisProblem(
        model, specification, space, (400, 200), inputs, gap=gap, gap_axes=(), error=error, latency=latency
    )
    controller = Controller(inputs, ("x1", "x2"), ("u",), synthesise(problem), "least_effort", {})
    assert controller.solution.fraction > 0.8
    rng = np.random.default_rng(7)
    x = safe.sample(rng, 500)
    x = x[controller.contains(x)]
    corners = np.array(list(itertools.product([-1.0, 1.0], repeat=2)))
    y = x + error * corners[rng.integers(4, size=len(x))]
    pending = np.full(len(x), controller.first)
    for _ in range(300):
        applied = pending if latency else controller.lookup(y)
        assert np.all(applied >= 0)
        following = controller.lookup(y, pending) if latency else applied
        x = model.step(x, inputs[applied]) + size * corners[rng.integers(4, size=len(x))]
        assert np.all(safe.contains(x))
        y, pending = x + error * corners[rng.integers(4, size=len(x))], following
