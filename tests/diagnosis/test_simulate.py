"""The window simulation against solutions by hand and against SciPy's integrator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.simulation.step_length import resolved
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


def test_friction_that_grows_with_the_load_acts_in_a_window_that_begins_without_one():
    t = np.arange(0.0, 1.0, 0.01)
    problem, compiled = one_window(block(2.0), t, np.where(t < 0.3 - 1e-9, 0.0, 2.0), effects=("load_friction",))
    theta = with_effect(compiled, "load_friction", "u", mu=0.2)
    assert compiled.rubs(theta)
    x = problem.states(theta, np.array([[0.0, 0.0]]))
    np.testing.assert_allclose(x[:, 1], 0.8 * np.maximum(t - 0.3, 0.0), atol=1e-9)


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


def test_a_stuck_block_breaks_away_at_the_instant_that_a_lagged_force_reaches_friction():
    """Between the stamps; a block that waits for the next one would be .0056 too slow for good."""
    t = np.arange(0.0, 0.6, 0.01)
    u = np.where(t < 0.3 - 1e-9, 0.0, 2.0)
    problem, compiled = one_window(block(2.0), t, u)
    theta = with_effect(compiled, "input_lag", "u", T=0.013)
    theta[list(compiled.find("coulomb_friction", "slide").slots)] = 0.7
    x = problem.states(theta, np.array([[0.0, 0.0]]))
    free = np.maximum(t - 0.3 + 0.013 * np.log(1.0 - 0.7 / 2.0), 0.0)  # s from the breakaway on
    np.testing.assert_allclose(x[:, 1], 0.5 * (1.3 * free - 1.3 * 0.013 * (1.0 - np.exp(-free / 0.013))), atol=2e-5)


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


def _with_dry_friction(t, u, x0, friction):
    """SciPy's pendulum that slides one way, the other way, or sticks; each rest is an event -> (n, 2)."""

    def pull(q, torque):
        return torque - 0.5 * 9.81 * np.sin(q)

    def slide(_, s, torque, way):
        return [s[1], 3.0 * (pull(s[0], torque) - friction * way)]

    def rest(_, s, torque, way):
        return s[1] * way

    rest.terminal, rest.direction = True, -1.0
    rows, state = [np.asarray(x0)], np.asarray(x0)
    for begin, end, torque in zip(t[:-1], t[1:], u[:-1], strict=True):
        now = begin
        while now < end:
            push = pull(state[0], torque)
            if state[1] == 0.0 and abs(push) <= friction:
                break  # held, and the arm stays where it is until the command changes
            way = np.sign(state[1]) if state[1] else np.sign(push)
            go = solve_ivp(slide, (now, end), state, "DOP853", args=(torque, way), events=rest, rtol=1e-11, atol=1e-13)
            now, state = go.t[-1], go.y[:, -1]
            if go.status == 1:
                state = np.array([state[0], 0.0])
        rows.append(state)
    return np.array(rows)


@pytest.mark.parametrize("friction", [0.2, 1.2])  # slides all the while; sticks for part of the time
def test_a_driven_pendulum_with_dry_friction_agrees_with_the_events_of_scipy(friction):
    t = np.arange(0.0, 2.0, 0.005)
    u = 2.0 * np.sin(5.0 * t)
    expected = _with_dry_friction(t, u, [0.5, 0.0], friction)
    assert np.any(np.diff(np.sign(expected[:, 1])) != 0)
    assert np.any(np.all(expected[1:] == expected[:-1], axis=1)) == (friction > 1.0)
    problem, compiled = one_window(point_pendulum(1.0, 0.5, 1.0 / 3.0), t, u, 0.005)
    theta = with_effect(compiled, "coulomb_friction", "hinge", F_c=friction)
    x = problem.states(theta, np.array([[0.5, 0.0]]))
    np.testing.assert_allclose(x, expected, atol=2e-6)


def test_a_simulation_does_not_look_its_functions_up(monkeypatch):
    """numba would at each call, if they were its arguments: for longer than a few windows take."""
    t = np.arange(0.0, 1.0, 0.01)
    problem, compiled = one_window(block(), t, np.zeros(t.size))
    theta = with_effect(compiled, "coulomb_friction", "slide", F_c=1.0)
    expected = problem.states(theta, np.array([[0.0, 0.4]]))

    def looked_up(*_: object) -> int:
        raise AssertionError("looked up")

    for name in ("_get_wrapper_address", "_get_jit_address"):
        monkeypatch.setattr(f"numba.experimental.function_type.{name}", looked_up)
    found = problem.states(theta, np.array([[0.0, 0.4]]))
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(found.T, stopping(0.4, 1.0, 2.0, t), atol=1e-12)


@pytest.mark.parametrize("dry", [0.0, 0.3])
def test_stamps_a_few_trillionths_of_a_second_apart_are_simulated(dry):
    """An instant that rounding leaves before the end of a sample was no step at all, and divided by zero."""
    t = np.concatenate([[0.0, 0.01, 0.01 + 5e-12], np.arange(0.02, 1.0, 0.01)])
    problem, compiled = one_window(block(2.0), t, np.full_like(t, 1.0))
    theta = with_effect(compiled, "coulomb_friction", "slide", F_c=dry)
    x = problem.states(theta, np.array([[0.0, 0.0]]))
    np.testing.assert_allclose(x[:, 1], 0.5 * (1.0 - dry) * t, atol=1e-9)


def test_a_step_that_a_stiff_effect_needs_shorter_does_not_resolve_it():
    t = np.arange(0.0, 4.0, 0.02)
    q = 0.3 * np.sin(2.0 * t)
    record = Record((Trace("run", t, q[:, None], np.zeros((len(t), 1))),), ("q",), ("u",))
    parts, _ = parts_of(block(), record, settings := DiagnosisSettings(noise={"q": 1e-3}))
    problem = parts.with_tier(settings, True, False).known
    slots = problem.model.find("dahl_friction", "slide").slots
    for distance, good in ((0.05, True), (1e-4, False)):
        theta = problem.model.null.copy()
        theta[list(slots)] = 0.5, distance
        assert resolved(problem, theta, initial_states(problem)) is good


def test_a_motor_behind_its_joint_feels_the_inputs_of_its_own_trace():
    """Two traces whose clocks both begin at 0, and a delayed command."""
    rng, t = np.random.default_rng(0), np.arange(400) * 0.01
    u = rng.normal(size=(400, 1))
    y = np.cumsum(u, axis=0) * [1e-3, 1e-3] + 1e-3 * rng.normal(size=(400, 2))
    settings = DiagnosisSettings(effects=("joint_elasticity", "input_delay"))
    record = Record((Trace("a", t, y, u), Trace("b", t, y, -2.0 * u)), ("q", "v"), ("u",))
    parts, _ = parts_of(block(), record, settings)
    known = parts.with_tier(settings, True, True).known
    felt = known._felt(with_effect(known.model, "input_delay", "u", delay=0.02), (0,))
    own = np.concatenate([[u[0, 0]] * 2, u[:398, 0]])  # before it begins a trace feels its first command
    assert felt[:400] == pytest.approx(own)
    assert felt[400:] == pytest.approx(-2.0 * own)
