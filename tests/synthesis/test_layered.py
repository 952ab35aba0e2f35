"""Cells of several sizes against cells of one size: the same set and the same inputs, and fewer pairs looked at."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from pydantic import ValidationError

from simgap.config.synthesis import SynthesisSection
from simgap.errors import UserError
from simgap.geometry import Box
from simgap.model.sampled import NominalModel
from simgap.specifications.invariance import Invariance
from simgap.specifications.reach_and_stay import ReachAndStay
from simgap.specifications.reach_avoid import ReachAvoid
from simgap.specifications.space import Space
from simgap.synthesis.games.invariance import invariance
from simgap.synthesis.games.layered import layered_invariance
from simgap.synthesis.input_sets import unpack
from simgap.synthesis.synthesise import Problem, synthesise
from tests.synthesis import synthesis_oracle as oracle
from tests.synthesis.synthesis_plants import constant_gap, sloped_gap

GAMES = [
    ((13,), None),
    ((70,), None),
    ((9, 70), None),
    ((21, 16), ((1,), (0,))),
    ((9, 7, 10), ((2,), (0, 1), ())),
    ((5, 6, 7, 9), None),
    ((8, 8, 6, 66), ((1,), (2, 3), (3,), (2, 3))),
]


@pytest.mark.parametrize(("cells", "axes"), GAMES)
@pytest.mark.parametrize("layers", [1, 2, 3, 5])
@pytest.mark.parametrize("seed", range(3))
def test_set_and_inputs_are_those_of_the_uniform_grid(cells, axes, layers, seed):
    rng = np.random.default_rng([seed, 5, *cells])
    abstraction = oracle.random_abstraction(rng, cells, inputs=11, axes=axes, spread=1, drift=2)
    safe = None if seed == 2 else rng.random(abstraction.grid.size) < 0.97
    wanted = invariance(abstraction, safe)
    found, asked = layered_invariance(abstraction, layers, safe)
    assert np.array_equal(found.winning, wanted.winning)
    assert np.array_equal(found.mask, wanted.mask)
    assert found.pairs == wanted.pairs
    assert len(asked) == layers


CART = Space(("p", "v"), Box([-1, -1], [1, 1]))
SAFE = {"p": (-1.0, 1.0), "v": (-1.0, 1.0)}


def cart(layers, task=None, **more):
    """A mass that is pushed, and pushed away from the middle: cells are lost along two borders."""
    p, v, force = sp.symbols("p v F", real=True)
    model = NominalModel((p, v), (force,), (p + 0.1 * v, v + 0.1 * (2 * p + force)), 0.1)
    inputs = np.linspace(-1.5, 1.5, 13)[:, None]
    space = more.pop("space", CART)
    task = Invariance(kind="invariance", safe=SAFE) if task is None else task
    return Problem(model, task, space, (130, 150), inputs, constant_gap(0.002, 0.002), (), layers=layers, **more)


def test_a_plant_is_held_by_the_same_cells_and_inputs_with_fewer_looked_at():
    wanted, one, found = (synthesise(cart(layers)) for layers in (1, 2, 4))
    assert 0.2 < wanted.fraction < 0.9
    for other in (one, found):
        assert np.array_equal(other.winning, wanted.winning)
        assert np.array_equal(other.mask, wanted.mask)
    asked = sum(layered_invariance(cart(1).abstraction(), 1)[1])
    assert sum(found.statistics[f"pairs_asked_{side}"] for side in (1, 2, 4, 8)) < 0.5 * asked


def test_states_anywhere_in_cells_that_large_ones_decide_stay_in_the_set():
    problem = cart(4)
    solution = synthesise(problem)
    rng = np.random.default_rng(0)
    x = CART.box.sample(rng, 20000)
    cells = problem.grid.index(x)
    x, cells = x[solution.winning[cells]], cells[solution.winning[cells]]
    for m, (force,) in enumerate(problem.inputs):
        use = unpack(solution.mask[cells], len(problem.inputs))[:, m]
        p, v = x[use].T
        gap = rng.uniform(-0.002, 0.002, (use.sum(), 2))
        after = np.stack([p + 0.1 * v, v + 0.1 * (2 * p + force)], axis=1) + gap
        to = problem.grid.index(after)
        assert (to >= 0).all()
        assert solution.winning[to].all()


def test_what_layers_do_not_serve_is_refused():
    keys = {"target": {"p": (-0.2, 0.2)}}
    refused = [
        cart(2, ReachAvoid(kind="reach_avoid", **keys)),
        cart(2, ReachAndStay(kind="reach_and_stay", **keys)),
        cart(2, latency=1),
        cart(2, error=np.array([0.01, 0.0])),
        cart(2, space=Space(("p", "v"), CART.box, (0,))),
        replace(cart(2), cells=(1300, 1500), gap=sloped_gap(), gap_axes=None, inputs=np.linspace(-1, 1, 99)[:, None]),
    ]
    for problem in refused:
        with pytest.raises(UserError, match="layers are not made for") as caught:
            synthesise(problem)
        assert caught.value.key == "synthesis.layers"


def test_the_key_leaves_cases_that_do_not_set_it_as_they_were():
    keys = {"cells": [2], "specification": {"kind": "invariance", "safe": {"x1": (0.0, 1.0)}}}
    assert "layers" not in SynthesisSection(**keys).model_dump()
    assert SynthesisSection(**keys, layers=3).model_dump()["layers"] == 3
    with pytest.raises(ValidationError):
        SynthesisSection(**keys, layers=0)
