"""The problem that the search works on: fewer samples that say the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import butter, lfilter

from simgap.config.plant import PlantSection
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.folds import split_windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.simulation.coarse import SEARCH_ROWS, coarse
from simgap.diagnosis.simulation.problem import Memo, Problem, build_problem
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.model.symbolic import SymbolicModel
from simgap.plants.plant_model import declared_model
from tests.diagnosis.plants import point_pendulum

NOISE = np.array([1e-3, 1e-2])


def _problem(rate: float, seconds: float, hz: float, traces: int = 1) -> Problem:
    rng = np.random.default_rng(4)
    t = np.arange(int(rate * seconds) + 1) / rate
    w = 2 * np.pi * hz
    clean = np.stack([np.sin(w * t), w * np.cos(w * t)], axis=1)
    u = np.sin(3.0 * t)[:, None]
    made = [Trace(f"t{k}", t + k, clean + rng.normal(size=clean.shape) * NOISE, u) for k in range(traces)]
    record = Record(tuple(made), ("angle", "rate"), ("torque",))
    compiled = cached_supermodel(point_pendulum(1.0, 0.5, 0.25), record.measured)
    return build_problem(compiled, record, split_windows(record, 1.0), NOISE)


def test_a_small_problem_stays_as_it_is():
    problem = _problem(200.0, 10.0, 0.5)
    assert coarse(problem) is problem


def test_a_dense_record_is_averaged_in_blocks():
    problem = _problem(1000.0, 8.0, 0.5, traces=2)
    thin = coarse(problem)
    assert len(thin.windows) == len(problem.windows)
    k = round(len(problem.t) / len(thin.t))
    assert k == 5
    np.testing.assert_allclose(thin.t[:1601], np.arange(1601) * 0.005, atol=1e-12)
    np.testing.assert_allclose(thin.y[1], problem.y[3:8].mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(thin.u[1], problem.u[5:10].mean(axis=0), rtol=1e-9)
    assert thin.firsts.tolist() == [0, 1601]
    # windows begin and end at the same instants, within a block
    np.testing.assert_allclose(thin.t[thin.windows.start], problem.t[problem.windows.start], atol=0.005)
    error = thin.y - np.stack([np.sin(np.pi * (thin.t - np.repeat([0, 1], 1601))), np.zeros(len(thin.t))], axis=1)
    assert np.std(error[10:-10, 0]) < 1.3 * NOISE[0] / np.sqrt(5)


def test_a_motion_that_bends_within_a_block_is_sampled_at_its_middle():
    problem = _problem(1000.0, 8.0, 30.0)
    thin = coarse(problem)
    np.testing.assert_array_equal(thin.y, problem.y[::5])
    np.testing.assert_array_equal(thin.sigma, problem.sigma)


def test_a_long_record_gives_a_spread_of_its_windows():
    problem = _problem(200.0, 200.0, 0.5)
    thin = coarse(problem, together=2)
    assert thin.windows.samples <= SEARCH_ROWS
    assert thin.windows.samples > 0.9 * SEARCH_ROWS
    first = np.searchsorted(problem.windows.start, thin.windows.start)
    assert np.all(np.diff(first)[::2] == 1)  # pairs stay together
    assert first[-1] >= len(problem.windows) - 4


def test_an_input_that_is_faster_than_blocks_keeps_every_sample():
    rng, problem = np.random.default_rng(7), _problem(1000.0, 8.0, 0.5)
    quick = replace(problem, u=10.0 * rng.choice([-1.0, 1.0], problem.u.shape), memo=Memo())
    thin = coarse(quick)
    np.testing.assert_allclose(np.diff(thin.t), 0.001, atol=1e-12)  # 10 N m over 2 ms: .08 rad/s of .01 rad/s noise


RATE, FAST, DAMPED, CUBIC = 610.0, 251.0, 0.04, 1.5e5  # Hz, rad/s (15 readings a period), 1, 1/(m^2 s^2)


def _oscillator() -> Record:
    """x'' = w^2 u - 2 z w x' - w^2 x - c x^3 under noise to 150 Hz, held between readings, by SciPy's integrator."""
    rng = np.random.default_rng(11)
    t = np.arange(9000) / RATE
    low, high = butter(4, 150.0 / (RATE / 2))
    u = 0.03 * lfilter(low, high, rng.normal(size=t.size)) / 0.7
    x, positions = np.zeros(2), np.empty(t.size)
    for k, held in enumerate(u):
        positions[k] = x[0]

        def rate(_: float, s: np.ndarray, held: float = held) -> list[float]:
            return [s[1], FAST**2 * (held - s[0]) - 2 * DAMPED * FAST * s[1] - CUBIC * s[0] ** 3]

        x = solve_ivp(rate, (0.0, 1.0 / RATE), x, method="DOP853", rtol=1e-8, atol=1e-12).y[:, -1]
    y = positions + 2e-4 * rng.standard_normal(t.size)
    return Record((Trace("noise", t, y[:, None], u[:, None]),), ("x",), ("u",))


def test_an_oscillator_of_fifteen_readings_a_period():
    """Its velocity is not measured, and turns round within the first guess of a window; its input is as quick."""
    equations = {
        "parameters": {"w": {"value": FAST, "unit": "1/s"}, "z": {"value": DAMPED}},
        "dynamics": {"x": "v", "v": "w^2*u - 2*z*w*v - w^2*x"},
    }
    states, inputs = {"x": {"unit": "m"}, "v": {"unit": "m/s"}}, {"u": {"unit": "m"}}

    def plant(acceleration: str) -> SymbolicModel:
        own = {**equations, "dynamics": {"x": "v", "v": acceleration}}
        section = PlantSection.model_validate({"symbolic": own, "states": states, "inputs": inputs})
        return declared_model(section, Path())

    record = _oscillator()
    whole = diagnose(plant(f"w^2*u - 2*z*w*v - w^2*x - {CUBIC}*x^3"), record)
    assert whole.verdict == "none"
    found = diagnose(plant("w^2*u - 2*z*w*v - w^2*x"), record)
    assert found.verdict == "attributed"
    (effect,) = found.effects
    assert (effect.name, effect.on) == ("cubic_spring", "axis")  # the one coordinate that the equations show
    low, high = effect.parameters["k3"].ci95
    assert low <= CUBIC <= high
    assert high - low < 0.02 * CUBIC
