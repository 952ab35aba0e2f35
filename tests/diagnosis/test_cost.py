"""What a search must not do twice."""

from __future__ import annotations

import numpy as np
import pytest

from simgap import units
from simgap.diagnosis.diagnose import diagnose_mended
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search import columns
from simgap.diagnosis.simulation import refit as refits
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import linearise, slot_direction
from tests.diagnosis.plants import block, one_window, point_pendulum


def _swinging(n: int = 200) -> tuple[Problem, np.ndarray]:
    """A window of a pendulum of 1 kg at 0.5 m under a sine, and where a fit of it may begin."""
    t = np.arange(n) * 0.01
    problem, compiled = one_window(point_pendulum(1.0, 0.5, 0.3), t, np.sin(3.0 * t))
    problem.y[:] = problem.states(compiled.null, np.array([[0.9, 1.5]]))[:, : problem.y.shape[1]]
    return problem, initial_states(problem) + 0.3


def test_a_step_that_was_taken_is_not_simulated_again(monkeypatch):
    problem, x0 = _swinging()
    asked: list[bytes] = []
    plain = Problem._simulated

    def counted(self, theta, begin):
        asked.append(begin.tobytes())
        return plain(self, theta, begin)

    monkeypatch.setattr(Problem, "_simulated", counted)
    ends = refits.refit(problem, problem.model.null, x0)
    np.testing.assert_allclose(ends.x0, [[0.9, 1.5]], atol=1e-5)
    assert len(asked) > 3  # several steps, each with its shifted starts in one pass
    assert len(set(asked)) == len(asked)


def test_initial_states_step_as_each_window_by_itself_would():
    problem, x0 = _swinging(400)
    halves = problem.windows.pick(np.array([0, 0]))
    halves.stop[0], halves.start[1] = 200, 200
    both = problem.on(halves)
    x0 = np.vstack([x0, x0 + 0.1])
    linear = linearise(both, both.model.null, x0, [slot_direction(both, both.model.null, 0, 1e-4)])
    step = np.array([0.01])
    wanted = [np.linalg.solve(linear.state_r[w], linear.state_g[w] - linear.state_b[w] @ step) for w in (0, 1)]
    np.testing.assert_allclose(linear.state_step(step), wanted, rtol=1e-12)


def test_plain_units_of_angles_need_no_table_of_units(monkeypatch):
    def refused() -> None:
        raise AssertionError

    monkeypatch.setattr(units, "_registry", refused)
    assert units.full_turn("rad") == 2.0 * np.pi
    assert units.full_turn("m") is None
    assert units.full_turn("1") is None


def test_turns_have_the_names_of_data_sheets():
    for unit, of in (("rev", "rad"), ("rev/s", "rad/s")):
        assert units.conversion(unit, of).factor == pytest.approx(2.0 * np.pi)


def _driven(scale: float) -> Record:
    """Dry friction of 2 N on a mass of 2 that nobody declared, its position read in units of 1 / `scale` m."""
    traces = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        t = np.arange(0.0, 6.0, 0.01)
        u = 6.0 * np.sin(2 * np.pi * 0.7 * t + seed) + 3.0 * np.sin(2 * np.pi * 1.9 * t)
        q, v, out = 0.0, 0.0, []
        for now in u:
            out.append(q)
            for _ in range(20):
                v += 5e-4 * now / 2.0
                v = 0.0 if abs(v) <= 5e-4 else v - np.copysign(5e-4, v)
                q += 5e-4 * v
        y = np.array(out)[:, None] + 1e-4 * rng.standard_normal((len(t), 1))
        traces.append(Trace(f"run{seed}", t, scale * y, u[:, None]))
    return Record(tuple(traces), ("q",), ("u",))


def test_units_that_cannot_be_right_are_not_fitted_to_the_end(monkeypatch):
    long, plain = [], columns.fit

    def counted(problem, theta, x0, slots, steps, most=30, rounds=3):
        if slots and rounds == 3:
            long.append(tuple(problem.y[:3, 0]))
        return plain(problem, theta, x0, slots, steps, most, rounds)

    monkeypatch.setattr(columns, "fit", counted)
    settings = DiagnosisSettings(effects=("coulomb_friction", "viscous_friction", "input_bias", "input_gain"))
    d, mended = diagnose_mended(block(), _driven(1e3), settings)
    assert [f.fault for f in d.recording] == ["wrong_unit"]
    sizes = [float(np.abs(record.traces[0].y).max()) for record in (mended, _driven(1e3))]
    assert sizes[0] < 0.1 * sizes[1]  # what the pictures show is mended
    assert [e.name for e in d.effects] == ["coulomb_friction"]
    assert len(set(long)) <= 3  # of seven possibilities
