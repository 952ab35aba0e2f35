"""The bound of hidden forces covers them whatever their order in time, and lets the noise of the readings out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
import yaml
from scipy.stats import norm

from simgap.config.load import parse_case
from simgap.correction.process_noise import bound_forces
from simgap.diagnosis.result import WindowPrediction
from simgap.model.symbolic import Parameter, symbol
from simgap.plants.plant_model import PlantModel
from tests.stages import diagnosis_example as example

DT, TAU, STEPS, NOISE = 0.01, 0.05, 400, 1e-3


@pytest.fixture(scope="module")
def model():
    return PlantModel.of(parse_case(yaml.safe_load(example.CASE), Path("bench.yaml")), Path()).corrected


def forces(kind, rng):
    steps, fresh = np.arange(STEPS), rng.standard_normal(STEPS)
    if kind == "AR(1)":
        for k in range(1, STEPS):
            fresh[k] = 0.9 * fresh[k - 1] + np.sqrt(1 - 0.81) * fresh[k]
    return {
        "none": np.zeros(STEPS), "constant": np.ones(STEPS), "alternating": (-1.0) ** steps, "white": fresh,
        "AR(1)": fresh, "every third": np.sqrt(1.5) * np.where(steps % 3 == 0, -2.0, 1.0) / np.sqrt(3),
        "rare": np.where(rng.uniform(size=STEPS) < 0.1, np.sign(fresh), 0.0),
    }[kind]  # fmt: skip


def windows(force, rng):
    """The pendulum pushed by a rate of its speed in each step, its angle read with noise."""
    x, rows, fine = np.array([0.4, 0.0]), [], 5
    for k in range(STEPS * round(TAU / DT)):
        u = example.torque(DT * k)
        rows.append([*x, u])
        for _ in range(fine):
            half = x + 0.5 * DT / fine * rate(x, u, force[k // round(TAU / DT)])
            x = x + DT / fine * rate(half, u, force[k // round(TAU / DT)])
    table, t = np.array(rows), DT * np.arange(len(rows))
    read = table[:, :1] + NOISE * rng.standard_normal((len(t), 1))
    cuts = [slice(a, a + 200) for a in range(0, len(t), 200)]
    return [
        WindowPrediction(
            "run", True, t[s], read[s], read[s], read[s], table[s, :2], table[s, 2:], np.ones_like(read[s])
        )
        for s in cuts
    ]


def rate(x, u, more):
    return np.array([x[1], (u - example.WEIGHT * np.sin(x[0])) / example.INERTIA + more])


@pytest.mark.parametrize("kind", ["constant", "alternating", "white", "AR(1)", "every third", "rare"])
@pytest.mark.parametrize("size", [0.05, 0.5])
def test_forces_are_covered_whatever_their_order(model, kind, size):
    rng = np.random.default_rng(7)
    hidden = size * forces(kind, rng)
    found = bound_forces(windows(hidden, rng), {"q": NOISE}, model, TAU, 0.95)
    assert np.mean(np.abs(hidden) * TAU <= found["v"]) >= 0.95


def test_where_nothing_is_hidden_the_bound_is_below_the_noise_of_two_readings(model):
    rng = np.random.default_rng(8)
    found = bound_forces(windows(forces("none", rng), rng), {"q": NOISE}, model, TAU, 0.95)
    two = norm.ppf(0.975) * np.sqrt(2.0) * NOISE
    assert found["q"] < two
    assert found["v"] < two / TAU


def test_readings_that_are_no_measurement_do_not_count(model):
    rng = np.random.default_rng(9)
    clean = windows(forces("none", rng), rng)
    spiky = []
    for w in clean:
        read, used = w.measured.copy(), np.ones_like(w.measured)
        read[17], used[17] = 9.0, 0.0
        spiky.append(WindowPrediction(w.trace, True, w.t, read, read, read, w.states, w.inputs, used))
    one, other = (bound_forces(part, {"q": NOISE}, model, TAU, 0.95) for part in (clean, spiky))
    assert other["v"] == pytest.approx(one["v"], rel=0.2)
    assert bound_forces([], {"q": NOISE}, model, TAU, 0.95) == {}


def test_a_delay_that_is_a_parameter_acts_like_its_number(model):
    """A corrected model holds what was found as parameters."""
    rng = np.random.default_rng(10)
    made = windows(forces("white", rng), rng)
    (command,) = model.input_names
    named = replace(model, parameters={**model.parameters, "late": Parameter(0.02, "s")})
    one, other = (
        bound_forces(made, {"q": NOISE}, m, TAU, 0.95)
        for m in (model.with_delay(command, sp.Float(0.02)), named.with_delay(command, symbol("late")))
    )
    assert one == other
    assert one != bound_forces(made, {"q": NOISE}, model, TAU, 0.95)
