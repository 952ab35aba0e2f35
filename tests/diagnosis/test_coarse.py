"""The problem that the search works on: fewer samples that say the same."""

from __future__ import annotations

import numpy as np

from simgap.diagnosis.record.folds import split_windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.simulation.coarse import SEARCH_ROWS, coarse
from simgap.diagnosis.simulation.problem import Problem, build_problem
from simgap.diagnosis.simulation.supermodel import cached_supermodel
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
