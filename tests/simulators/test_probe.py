"""The one trial of simulators that are a person's code: maps pass, and each way to remember is refused."""

import time

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.simulators.base import Simulator
from simgap.simulators.supervision import BLOCK, try_as_map
from tests.little_cart import write_cart


class Cart(Simulator):
    """A cart, and what is left of its force: nothing, unless `filtered`."""

    nx, nu, engine, filtered, calls = 2, 1, "cart", 0.0, 0

    def reset(self, x):
        self.x, self.force = np.array(x), 0.0

    def advance(self, u):
        self.calls += 1
        self.force = self.filtered * self.force + u[0]
        self.x = self.x + 0.01 * np.array([self.x[1], self.force])
        return self.x


class Drifts(Cart):
    def advance(self, u):
        return super().advance(u) + (self.calls > 500)


class Clocked(Cart):
    def advance(self, u):
        return super().advance(u) + np.floor(30 * time.monotonic())


class Ordered(Cart):
    """What it answers depends on the state before, by a bit that the same order sets alike."""

    before = 0.0

    def advance(self, u):
        self.before, last = self.x[0], self.before
        return super().advance(u) + 1e-9 * (last > self.x[0])


def rolled(tmp_path, simulator, blocks=1):
    """Roll-outs of a corner of X alone."""
    own = try_as_map(simulator, load_case(write_cart(tmp_path)))
    x, u = np.full((BLOCK, 2), 0.9), np.ones((BLOCK, 1))
    for _ in range(blocks):
        found = own.rollouts(x, u)
    return found


def test_a_map_passes_with_its_results_as_they_are(tmp_path):
    assert np.array_equal(rolled(tmp_path, Cart(), 4), np.tile([0.909, 0.91], (BLOCK, 1)))


@pytest.mark.parametrize(("kind", "blocks"), [(Clocked, 1), (Ordered, 1), (Drifts, 9)])
def test_what_answers_in_two_ways_is_refused_with_the_call_and_how_to_declare_it(tmp_path, kind, blocks):
    with pytest.raises(UserError, match="gives two results for the same call, at x = ") as refused:
        rolled(tmp_path, kind(), blocks)
    assert "plant.states" in refused.value.remedy
    assert "hidden_state" in refused.value.remedy


def test_state_that_a_reset_puts_at_rest_is_refused_by_its_second_step(tmp_path):
    simulator = Cart()
    simulator.filtered = 0.5
    with pytest.raises(UserError, match="has more state than the case: a second step moves v otherwise"):
        rolled(tmp_path, simulator)
