"""The window simulation against solutions by hand and against SciPy's integrator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.diagnosis.plants import block, one_window, point_pendulum, stopping, with_effect


def test_dry_friction_stops_exactly_and_sticks():
    t = np.arange(0.0, 3.0, 0.01)
    problem, compiled = one_window(block(2.0), t, np.zeros_like(t))
    theta = with_effect(compiled, "coulomb_friction", "slide", F_c=0.7)
    x = problem.states(theta, np.array([[0.0, 0.4]]))
    q, v = stopping(0.4, 0.7, 2.0, t)
    np.testing.assert_allclose(x[:, 0], q, atol=1e-10)
    np.testing.assert_allclose(x[:, 1], v, atol=1e-10)


def test_a_stuck_block_starts_when_the_push_exceeds_friction():
    t = np.arange(0.0, 2.0, 0.01)
    u = np.where(t < 1.0 - 1e-9, 0.69, 1.7)
    problem, compiled = one_window(block(2.0), t, u)
    theta = with_effect(compiled, "coulomb_friction", "slide", F_c=0.7)
    x = problem.states(theta, np.array([[0.0, 0.0]]))
    np.testing.assert_allclose(x[:, 1], np.maximum(t - 1.0, 0.0) * 0.5, atol=1e-9)


def test_a_peak_holds_up_to_the_breakaway_force():
    t = np.arange(0.0, 1.0, 0.01)
    for push, moves in ((0.95, False), (1.05, True)):
        problem, compiled = one_window(block(2.0), t, np.full_like(t, push))
        theta = with_effect(compiled, "stribeck_friction", "slide", F_c=0.7, F_s=1.0, v_s=0.05)
        x = problem.states(theta, np.array([[0.0, 0.0]]))
        assert (x[-1, 0] > 0) == moves


def test_delay_shifts_the_input_between_samples():
    t = np.arange(0.0, 1.0, 0.01)
    u = np.where(t < 0.3 - 1e-9, 0.0, 2.0)
    problem, compiled = one_window(block(2.0), t, u)
    theta = with_effect(compiled, "input_delay", "u", delay=0.0137)
    x = problem.states(theta, np.array([[0.0, 0.0]]))
    np.testing.assert_allclose(x[:, 1], np.maximum(t - 0.3137, 0.0), atol=1e-9)


def test_lag_follows_its_time_constant():
    t = np.arange(0.0, 1.0, 0.01)
    u = np.where(t < 0.3 - 1e-9, 0.0, 2.0)
    problem, compiled = one_window(block(2.0), t, u)
    theta = with_effect(compiled, "input_lag", "u", T=0.05)
    x = problem.states(theta, np.array([[0.0, 0.0]]))
    late = np.maximum(t - 0.3, 0.0)
    np.testing.assert_allclose(x[:, 1], late - 0.05 * (1.0 - np.exp(-late / 0.05)), atol=1e-5)


def test_a_driven_pendulum_over_jittering_stamps_agrees_with_scipy():
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.003, 0.007, 400))
    u = rng.uniform(-2.0, 2.0, 400)
    model = point_pendulum(1.0, 0.5, 1.0 / 3.0)
    problem, compiled = one_window(model, t, u)
    theta = with_effect(compiled, "quadratic_drag", "hinge", c=0.1)
    x = problem.states(theta, np.array([[0.4, -1.0]]))

    def slope(_: float, s: np.ndarray, torque: float) -> list[float]:
        drag = 0.1 * s[1] * abs(s[1])
        return [s[1], 3.0 * (torque - drag - 0.5 * 9.81 * np.sin(s[0]))]

    state = np.array([0.4, -1.0])
    for k in range(len(t) - 1):
        state = solve_ivp(slope, (t[k], t[k + 1]), state, args=(u[k],), rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(x[-1], state, atol=1e-7)


@pytest.mark.parametrize(("name", "values"), [("coulomb_friction", {"F_c": 0.2}), ("viscous_friction", {"b": 0.2})])
def test_halving_the_step_changes_nothing_visible(name, values):
    t = np.arange(0.0, 2.0, 0.005)
    u = 2.0 * np.sin(5.0 * t)
    model = point_pendulum(1.0, 0.5, 1.0 / 3.0)
    ends = []
    for h in (0.005, 0.0025):
        problem, compiled = one_window(model, t, u, h)
        ends.append(problem.states(with_effect(compiled, name, "hinge", **values), np.array([[0.5, 0.0]])))
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-7)
