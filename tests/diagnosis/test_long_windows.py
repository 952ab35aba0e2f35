"""What swings faster than a window is found, and a gyro that was mounted upside down too, whatever force lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from simgap.diagnosis.diagnose import diagnose, ready
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.model.symbolic import Coordinate, Parameter, SymbolicModel, Variable, symbol

INERTIA, DAMPING, STIFFNESS, NEUTRAL = 0.0042, 0.011, 0.26, 0.21


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
    """Two runs of 12 s with a cable that pulls the axis to its neutral angle; with 0.26 N m/rad it swings in .8 s."""
    rng, t, runs = np.random.default_rng([seed, 4021]), np.arange(0.0, 12.0, 0.01), []
    for k in range(2):
        rate, phase = rng.uniform(0.7, 14.0, 5), rng.uniform(0.0, 6.0, 5)
        u = 0.09 * np.sin(np.outer(t, rate) + phase).sum(axis=1)

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


@pytest.mark.parametrize("stiffness", [0.0, 0.05, STIFFNESS])
def test_kinematics_tells_a_reversed_gyro_whatever_force_lacks(stiffness):
    (seen,) = ready(axis(), swings(3, stiffness, gyro=-1.0), DiagnosisSettings())
    assert [(f.fault, f.channel) for f in seen.faults] == [("wrong_sign", "v")]
    (seen,) = ready(axis(), swings(3, stiffness), DiagnosisSettings())
    assert seen.faults == ()


def test_a_reversed_angle_beside_its_rate_is_told_from_a_reversed_rate():
    record = swings(4, 0.05)
    traces = tuple(replace(r, y=r.y * [-1.0, 1.0]) for r in record.traces)
    (seen,) = ready(axis(), replace(record, traces=traces), DiagnosisSettings())
    assert [(f.fault, f.channel) for f in seen.faults] == [("wrong_sign", "q")]
