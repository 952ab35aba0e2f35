"""The integration step of a stiff plant, against the matrix exponential: it first misses by more, and then settles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from simgap.diagnosis.record.folds import split_windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.problem import build_problem
from simgap.diagnosis.simulation.step_length import settled
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.model.symbolic import Parameter, SymbolicModel, Variable, symbol

DT, R, K, J, B = 0.01, 1.0, 0.05, 1e-4, 1e-5


def motor(inductance: float) -> SymbolicModel:
    i, w, volts, own = (symbol(n) for n in ("i", "w", "V", "L"))
    return SymbolicModel(
        states=(Variable("w", "rad/s"), Variable("i", "A")),
        inputs=(Variable("V", "V"),),
        parameters={"L": Parameter(inductance, "H")},
        xdot=((K * i - B * w) / J, (volts - R * i - K * w) / own),
    )


@pytest.mark.parametrize("stiff", [3.5, 10.0, 50.0])
def test_a_winding_much_faster_than_the_readings_is_followed(stiff):
    """Samples times R / L: at 3.5 and above, whole steps of Runge and Kutta's method grow without end."""
    own, rng, n = DT * R / stiff, np.random.default_rng(90441), 400
    a, b = np.array([[-B / J, K / J], [-K / own, -R / own]]), np.array([[0.0], [1.0 / own]])
    step = expm(np.block([[a, b], [np.zeros((1, 3))]]) * DT)
    volts, x = 5.0 * np.repeat(rng.uniform(-1.0, 1.0, n // 10), 10), np.zeros((n, 2))
    for k in range(n - 1):
        x[k + 1] = step[:2, :2] @ x[k] + step[:2, 2] * volts[k]
    sigma = np.array([0.1, 0.02])
    trace = Trace("run", np.arange(n) * DT, x + sigma * rng.standard_normal((n, 2)), volts[:, None])
    record = Record((trace,), ("w", "i"), ("V",))
    model = cached_supermodel(motor(own), record.measured, ("viscous_friction",))
    problem = build_problem(model, record, split_windows(record, 1.0), sigma)
    found = settled(problem)
    misses = found.residuals(model.null, initial_states(found))
    assert found.h_max < problem.h_max
    assert float(np.sqrt(np.mean(misses**2))) < 4.0  # windows begin at readings, which have noise of their own
