"""The Runge-Kutta step taken stage by stage: the map that its expressions declare, and enclosures of it."""

from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

from simgap.errors import UserError
from simgap.gap.sampling import samples
from simgap.model.sampled import WRITTEN_OUT, RungeKutta, sampled_model
from simgap.model.symbolic import SymbolicModel, Variable, symbol

TAU = 0.063


def furuta():
    """A rod on an arm that turns, from the upright: Lagrange's equations with the full mass matrix, numbers put in."""
    t2, w1, w2, u = (symbol(n) for n in ("t2", "w1", "w2", "u"))
    arm, rod, both, weight = 0.014, 0.012, 0.006, 0.2943  # inertias in kg m^2, m g l in N m
    a, b, d = arm + rod * sp.sin(t2) ** 2, both * sp.cos(t2), rod
    first = u - 2 * rod * sp.sin(t2) * sp.cos(t2) * w1 * w2 + both * sp.sin(t2) * w2**2
    second = rod * sp.sin(t2) * sp.cos(t2) * w1**2 + weight * sp.sin(t2)
    det = a * d - b**2
    xdot = (w1, w2, (d * first - b * second) / det, (a * second - b * first) / det)
    units = {"t1": "rad", "t2": "rad", "w1": "rad/s", "w2": "rad/s"}
    return SymbolicModel(tuple(Variable(n, v) for n, v in units.items()), (Variable("u", "N*m"),), {}, xdot)


def by_hand(model, x, u, h):
    """The classical step, from its definition."""
    f = sp.lambdify([v.symbol for v in (*model.states, *model.inputs)], model.numeric(), "numpy")

    def rate(at):
        return np.stack([np.broadcast_to(r, len(at)) for r in f(*at.T, *u.T)], axis=1)

    k1 = rate(x)
    k2 = rate(x + h / 2 * k1)
    k3 = rate(x + h / 2 * k2)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))


@pytest.fixture(scope="module")
def rod():
    """The model of a Furuta pendulum, and its map, compiled."""
    model = furuta()
    step = sampled_model(model, TAU, "rk4")
    centre, none = np.full(4, 0.1), np.zeros(1)
    _ = step.kernel(centre, none), step.interval_kernel(centre, centre, none, none)
    _ = step.jacobian_interval_kernel(centre, centre, none, none), step.offset_axes, step.jacobian_axes
    return model, step


def test_four_coupled_states_are_not_written_out(rod):
    """6 s on a core of its own; written out it is not compiled in 250 s."""
    assert isinstance(rod[1], RungeKutta)
    assert rod[1].operations < 100 < WRITTEN_OUT < rod[1].written_out()


def test_a_step_that_is_not_written_out_is_not_enclosed_beside_equations(rod, monkeypatch):
    engine = SimpleNamespace(closed_form=lambda case, folder: (sp.Integer(0),) * 4)
    monkeypatch.setattr(samples, "engine_of", lambda case, folder: engine)
    plant = SimpleNamespace(sampled=rod[1])
    context = SimpleNamespace(case=SimpleNamespace(simulator="equations"), folder=None, plant=plant)
    with pytest.raises(UserError, match="too long to be enclosed") as refused:
        samples.known_gap(context)
    assert refused.value.key == "plant.integrator"


def test_it_is_the_classical_step(rod):
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1.0, 1.0, (200, 4)), rng.uniform(-0.3, 0.3, (200, 1))
    want = by_hand(rod[0], x, u, TAU)
    assert np.allclose(rod[1].step(x, u), want, rtol=1e-13, atol=1e-13)


def test_boxes_enclose_the_map_and_its_slopes(rod):
    model, step = rod
    rng = np.random.default_rng(1)
    centre, r = rng.uniform(-1.0, 1.0, (300, 4)), rng.uniform(0.0, 0.05, (300, 4))
    u = rng.uniform(-0.3, 0.3, (300, 1))
    at = centre + rng.uniform(-1.0, 1.0, (300, 4)) * r
    lo, hi = step.enclosure(centre - r, centre + r, u)
    value = by_hand(model, at, u, TAU)
    assert ((lo <= value + 1e-14) & (value - 1e-14 <= hi)).all()
    tight_lo, tight_hi = step.enclosure(at, at, u)
    assert (tight_hi - tight_lo).max() < 1e-12
    boxes = zip(centre - r, centre + r, u, strict=True)
    ends = np.array([step.jacobian_interval_kernel(low, high, c, c) for low, high, c in boxes])
    small = 1e-6
    for j in range(4):
        e = small * np.eye(4)[j]
        slope = (by_hand(model, at + e, u, TAU) - by_hand(model, at - e, u, TAU)) / (2 * small)
        assert (ends[:, j::4, 0] <= slope + 1e-8).all()
        assert (slope - 1e-8 <= ends[:, j::4, 1]).all()


def test_what_a_state_does_not_read_does_not_move_it(rod):
    step = rod[1]
    assert step.offset_axes == (frozenset({1, 2, 3}),) * 4  # an arm may stand anywhere
    assert not any(0 in axes for row in step.jacobian_axes for axes in row)
    for i in range(4):
        assert step.jacobian_axes[i][0] == frozenset()
        assert step.jacobian_axes[i][1] == frozenset({1, 2, 3})


def test_written_out_it_is_the_same_map_with_the_same_axes():
    q, v, u = (symbol(n) for n in ("q", "v", "u"))
    model = SymbolicModel(
        (Variable("q", "rad"), Variable("v", "rad/s")), (Variable("u", "N*m"),), {},
        (v, 3 * u - 14.7 * sp.sin(q) - 0.1 * v),
    )  # fmt: skip
    stages = RungeKutta((q, v), (u,), model.numeric(), 0.01)
    plain = sampled_model(model, 0.01, "rk4")
    assert not isinstance(plain, RungeKutta)
    assert plain.f == stages.f
    assert plain.operations <= stages.written_out() < WRITTEN_OUT
    x = np.random.default_rng(2).uniform(-1.0, 1.0, (20, 3))
    values = np.stack(sp.lambdify([q, v, u], plain.f, "numpy")(*x.T), axis=1)
    assert np.allclose(values, by_hand(model, x[:, :2], x[:, 2:], 0.01), rtol=1e-14, atol=1e-15)
    assert stages.offset_axes == plain.offset_axes
    assert stages.jacobian_axes == plain.jacobian_axes
