"""What swings faster than a window is found, and a gyro that was mounted upside down too, whatever force lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from simgap.diagnosis.diagnose import diagnose, ready
from simgap.diagnosis.record.faults.columns import velocity_lags
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.model.symbolic import Coordinate, Parameter, SymbolicModel, Variable, symbol

INERTIA, DAMPING, STIFFNESS, NEUTRAL = 0.03, 0.05, 2.4, 0.3


def axis() -> SymbolicModel:
    """J a = u - b v, as a designer declares a camera's pitch axis."""
    return SymbolicModel(
        states=(Variable("q", "rad"), Variable("v", "rad/s")),
        inputs=(Variable("u", "N*m"),),
        parameters={"J": Parameter(INERTIA, "kg*m^2"), "b": Parameter(DAMPING, "N*m*s/rad")},
        xdot=(symbol("v"), (symbol("u") - symbol("b") * symbol("v")) / symbol("J")),
        coordinates=(Coordinate("pitch", "q", "v"),),
        force_map={"pitch": (sp.Integer(0), 1 / symbol("J"))},
    )


def swings(seed: int, stiffness: float, gyro: float = 1.0) -> Record:
    """Two runs of 12 s with a cable that pulls the axis to its neutral angle; with 2.4 N m/rad it swings in .7 s."""
    rng, t, runs = np.random.default_rng([seed, 4021]), np.arange(0.0, 12.0, 0.01), []
    for k in range(2):
        rate, phase = rng.uniform(0.7, 14.0, 5), rng.uniform(0.0, 6.0, 5)
        u = 0.6 * np.sin(np.outer(t, rate) + phase).sum(axis=1)

        def slope(s, x, u=u):
            force = np.interp(s, t, u) - DAMPING * x[1] - stiffness * (x[0] - NEUTRAL)
            return x[1], force / INERTIA

        x = solve_ivp(slope, (0.0, t[-1]), (0.1, 0.0), t_eval=t, rtol=1e-9, atol=1e-9).y.T
        y = np.array([1.0, gyro]) * x + rng.normal(0.0, (1e-3, 1e-2), x.shape)
        runs.append(Trace(f"run{k}", t, y, u[:, None]))
    return Record(tuple(runs), ("q", "v"), ("u",))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_spring_that_swings_faster_than_a_window_is_found_about_its_neutral_angle(seed):
    settings = DiagnosisSettings(effects=("spring", "constant_force"))
    d = diagnose(axis(), swings(seed, STIFFNESS), settings)
    found = {e.name: e.parameters for e in d.effects}
    assert d.verdict == "attributed"
    assert found["spring"]["k"].value == pytest.approx(STIFFNESS, rel=2e-3)
    assert found["constant_force"]["F_0"].value == pytest.approx(STIFFNESS * NEUTRAL, rel=5e-3)


def _told(record: Record) -> list[list[tuple[str, str]]]:
    """Of each possibility of the columns what is told."""
    return [[(f.fault, f.channel) for f in seen.faults] for seen in ready(axis(), record, DiagnosisSettings())]


@pytest.mark.parametrize("seed", [3, 5, 6, 7])
@pytest.mark.parametrize("stiffness", [0.0, 0.4, STIFFNESS])
def test_kinematics_tells_a_reversed_gyro_whatever_force_lacks(stiffness, seed):
    assert _told(swings(seed, stiffness, gyro=-1.0)) == [[("wrong_sign", "v")]]
    assert _told(swings(seed, stiffness)) == [[]]


@pytest.mark.parametrize("seed", [4, 8, 9, 10])
def test_a_reversed_angle_beside_its_rate_is_told_from_a_reversed_rate(seed):
    record = swings(seed, 0.4)
    traces = tuple(replace(r, y=r.y * [-1.0, 1.0]) for r in record.traces)
    assert _told(replace(record, traces=traces)) == [[("wrong_sign", "q")]]


@pytest.mark.parametrize("ratio", [3.0, 4.0, 0.25, 50.0])
def test_a_gear_between_an_angle_and_its_rate_is_no_sign(ratio):
    """Of another size than the derivative, and of its sign: kinematics says nothing of the columns."""
    found = [f for each in _told(swings(11, 0.0, gyro=ratio)) for f in each]
    assert ("wrong_sign", "q") not in found
    assert ("wrong_sign", "v") not in found


def test_half_a_period_late_a_swing_is_not_taken_for_its_negative():
    """A free swing of six a second whose rate is filtered by 3 ms: shifted by half a period it fits as well."""
    t = np.arange(0.0, 3.0, 0.005)
    q = 0.1 * np.exp(-0.4 * t) * np.cos(2.0 * np.pi * 6.0 * t)
    v = np.gradient(q, t, edge_order=2)
    late = np.interp(t - 0.003, t, v)
    rng = np.random.default_rng(12)
    y = np.column_stack([q, late]) + rng.normal(0.0, (1e-4, 5e-3), (len(t), 2))
    (lag,) = velocity_lags(Record((Trace("run", t, y, np.zeros((len(t), 1))),), ("q", "v"), ("u",)), axis())
    assert lag.scale > 0.0
    assert lag.lag_s == pytest.approx(0.003, abs=1e-3)


def test_a_rate_that_the_model_does_not_declare_to_be_one_is_compared_with_no_derivative():
    geared = replace(axis(), xdot=(4.0 * symbol("v"), axis().xdot[1]))
    assert not list(velocity_lags(swings(13, 0.4), geared))
