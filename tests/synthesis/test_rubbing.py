"""The gap that dry friction is guessed to leave, against a step of a block that slides and is stopped by hand."""

import numpy as np
import pytest
import sympy as sp

from simgap.extras.wizard.posture import posture_of
from simgap.extras.wizard.proposal import blocks_along, rubbing
from simgap.model.symbolic import Coordinate, SymbolicModel, Variable, symbol

MASS, FRICTION, TAU = 2.0, 0.6, 0.1


def block():
    v, u = symbol("v"), symbol("u")
    force_map = {"x": (sp.Integer(0), sp.Integer(1) / MASS)}
    states, inputs = (Variable("q", "m"), Variable("v", "m/s")), (Variable("u", "N"),)
    return SymbolicModel(states, inputs, {}, (v, u / MASS), (Coordinate("x", "q", "v"),), force_map=force_map)


def slid(v, u, steps=20_000):
    """How far dry friction moves position and speed from where they go without it, by many small steps."""
    q, speed, h = 0.0, v, TAU / steps
    for _ in range(steps):
        speed += h * u / MASS
        lost = h * FRICTION / MASS
        speed = np.sign(speed) * max(0.0, abs(speed) - lost)
        q += h * speed
    return np.array([q - v * TAU - u / MASS * TAU**2 / 2, speed - v - u / MASS * TAU])


def guess(lo, hi, u, blocks=1e-9, spread=0.0):
    model = block()
    found = rubbing(model, posture_of(model, {}), {"x": FRICTION}, TAU)
    kernel, out = found.gap(np.full(2, blocks), np.full(2, spread)), np.zeros((2, 2))
    kernel(np.array([0.0, lo]), np.array([0.0, hi]), np.array([u]), out[0], out[1])
    return out


@pytest.mark.parametrize(("v", "u"), [(0.5, 0.0), (-0.5, 0.0), (0.4, 3.0), (-0.4, -3.0), (0.5, -4.0)])
def test_a_speed_that_keeps_its_sign_shifts_the_gap_and_does_not_widen_it(v, u):
    lo, hi = guess(v, v, u)
    np.testing.assert_allclose(hi, lo, atol=1e-9)
    np.testing.assert_allclose(lo, slid(v, u), rtol=1e-3)


@pytest.mark.parametrize("u", [-6.0, -2.0, 0.0, 2.0, 6.0])
def test_cells_around_rest_get_what_friction_does_both_ways(u):
    width = 0.4
    lo, hi = guess(-width, width, u)
    inside = np.array([slid(v, u, 500) for v in np.linspace(-width, width, 41)])
    assert (inside[:, 1] >= lo[1] - 1e-3).all()
    assert (inside[:, 1] <= hi[1] + 1e-3).all()
    most = FRICTION * TAU / MASS
    assert hi[1] - lo[1] <= 2 * most + 1e-9


def test_a_block_of_the_table_and_the_spread_widen_it():
    narrow, wide = guess(0.02, 0.05, 0.0), guess(0.02, 0.05, 0.0, blocks=1.0)
    assert narrow[1, 1] - narrow[0, 1] < 1e-9
    assert wide[1, 1] - wide[0, 1] > FRICTION * TAU / MASS
    np.testing.assert_allclose(guess(0.02, 0.05, 0.0, spread=0.25) - narrow, [[-0.25] * 2, [0.25] * 2], atol=1e-12)


def test_joints_that_do_not_rub_have_none():
    model = block()
    assert rubbing(model, posture_of(model, {}), {}, TAU) is None
    assert rubbing(model, posture_of(model, {}), None, TAU) is None


def test_blocks_are_fine_along_speeds_that_rub():
    assert blocks_along(["q", "v"], {"v"}) == {"q": 25, "v": 80}


def test_cells_are_finer_along_the_speeds_alone():
    model = block()
    assert rubbing(model, posture_of(model, {}), {"x": FRICTION}, TAU).finer((40, 50)) == (40, 80)
