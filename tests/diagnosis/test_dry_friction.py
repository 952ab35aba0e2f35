"""Windows that begin stuck, against a drive solved in closed form and the noise that it was read with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.folds import split_windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search import fit as module
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import Problem, build_problem
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.diagnosis.verdict.held_out import judge
from tests.diagnosis.plants import block, point_pendulum, with_effect
from tests.undeclared.rig import dry_friction as rig

NOISE, STEP = 1e-5, 1e-5
SIGMA = float(np.hypot(NOISE, STEP / np.sqrt(12.0)))  # an encoder's count adds its uniform error


def _problem(seed: int, friction: float = 1.0) -> Problem:
    traces = rig.drive_record(rig.Drive(friction=friction), seed, seconds=10.0, noise=NOISE, step=STEP)
    record = Record(tuple(Trace(f"t{k}", *a) for k, a in enumerate(traces)), ("q",), ("u",))
    compiled = cached_supermodel(block(2.0), ("q",), ("coulomb_friction",))
    return build_problem(compiled, record, split_windows(record, 1.0), np.array([SIGMA]))


def test_the_rig_stops_and_sticks_where_an_event_integrator_says():
    p = rig.Drive(mass=2.0, friction=0.7, viscous=0.3, bias=0.1)
    t = np.array([0.0, 2.0])

    def slide(_: float, x: np.ndarray) -> list[float]:
        return [x[1], (0.1 - 0.3 * x[1] - 0.7) / 2.0]

    def rest(_: float, x: np.ndarray) -> float:
        return float(x[1])

    rest.terminal = True
    exact = solve_ivp(slide, (0.0, 2.0), [0.0, 0.4], events=rest, rtol=1e-11, atol=1e-13)
    end = rig.motion(p, t, np.zeros(2), 0.0, 0.4)[-1]
    assert exact.t_events[0].size == 1
    np.testing.assert_allclose(end, [exact.y[0, -1], 0.0], atol=1e-9)


@pytest.mark.parametrize("seed", [1, 2])
def test_every_held_out_window_reaches_the_noise(seed):
    problem = _problem(seed)
    theta = with_effect(problem.model, "coulomb_friction", "slide", F_c=1.0)
    held = judge(problem, theta, 0.2)
    each = np.add.reduceat(np.sum(problem.residuals(theta, held.states) ** 2, axis=1), problem.rows[:-1])
    assert np.max(each / problem.counts) < 1.5  # 200 samples: 1 +- .1; one stuck in a valley of its own is far above
    assert held.horizon.rmse[0] < 1.25 * held.horizon.floor[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_friction_is_found_from_far_away_and_its_interval_holds_it(seed):
    problem = _problem(seed)
    start = with_effect(problem.model, "coulomb_friction", "slide", F_c=0.2)
    slot = problem.model.find("coulomb_friction", "slide").slots[0]
    base = fit(problem, problem.model.null, initial_states(problem), [], {})
    found = fit(problem, start, base.x0, [slot], {slot: 1e-6})
    assert found.converged
    assert found.chi2 / problem.size < 1.1
    assert abs(found.theta[slot] - 1.0) < 4.0 * np.sqrt(found.covariance[0, 0])


def test_a_window_that_begins_stuck_leaves_the_valley_beside_rest():
    problem = _problem(4)
    theta = with_effect(problem.model, "coulomb_friction", "slide", F_c=1.0)
    moving = initial_states(problem)
    moving[:, 1] += 0.05  # every window is begun too fast, also those that stand still
    found = fit(problem, theta, moving, [], {})
    assert found.chi2 / problem.size < 1.1


def test_steps_that_are_all_rejected_are_not_convergence(monkeypatch):
    problem = _problem(1)
    start = with_effect(problem.model, "coulomb_friction", "slide", F_c=0.2)
    slot = problem.model.find("coulomb_friction", "slide").slots[0]
    monkeypatch.setattr(module, "_follow", lambda problem, at, *step: replace(at, chi2=2.0 * at.chi2))
    found = fit(problem, start, initial_states(problem), [slot], {slot: 1e-6})
    assert found.theta[slot] == 0.2
    assert not found.converged


def test_an_arm_that_falls_shows_its_inertia_and_its_friction():
    """Friction that varies with the place, as a ripple would in one direction, keeps all above the noise.

    A fit of both from the inertia that explains most alone ends at no friction; one of them and drag leads there.
    """
    rng, t, runs = np.random.default_rng(6), np.arange(0.0, 1.3, 0.02), []

    def slope(now, x):
        rub = 0.04 * (1.0 + 0.15 * np.sin(9.0 * x[0])) * np.tanh(x[1] / 1e-2)
        return x[1], (-0.072 * 9.81 * 0.1 * np.sin(x[0]) - rub) / 0.0039

    for k, begin in enumerate((1.5, 1.35, 1.2)):
        y = solve_ivp(slope, (0.0, 1.3), (begin, 0.0), t_eval=t, rtol=1e-8, max_step=1e-3).y[0]
        runs.append(Trace(f"run{k}", t, (y + rng.normal(0.0, 1e-3, len(t)))[:, None], np.zeros((len(t), 1))))
    known = ("arm.mass", "arm.com", "gravity")
    settings = DiagnosisSettings(window_s=0.5, horizon_s=0.3, known=known)
    d = diagnose(point_pendulum(0.072, 0.1, 0.0012), Record(tuple(runs), ("angle",), ("torque",)), settings)
    found = {e.name: [p.value for p in e.parameters.values()] for e in d.effects}
    assert d.verdict == "partial"
    assert {"parameter_error", "coulomb_friction"} <= set(found) <= {"parameter_error", "coulomb_friction", "cogging"}
    assert found["coulomb_friction"] == pytest.approx([0.04], rel=0.1)
