"""The conformal bound covers fresh transitions as often as it says, and shrinks when the model is right."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from simgap.config.load import parse_case
from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.verdict.remainder import bound_remainder
from simgap.effects import AppliedEffect
from simgap.plants.plant_model import PlantModel
from tests.stages import diagnosis_example as example


@pytest.fixture(scope="module")
def plant():
    import yaml

    return PlantModel.of(parse_case(yaml.safe_load(example.CASE), Path("bench.yaml")), Path())


SIGMA = dict(zip("qv", example.SIGMA.tolist(), strict=True))
FOUND = (AppliedEffect("coulomb_friction", "hinge", {"F_c": 0.19}),)


def remainder(plant, seed=3, level=0.9, tau=0.05):
    data = example.record(seed=seed)
    corrected, _ = plant.corrected_by(FOUND)
    return bound_remainder(example.windows(data), SIGMA, (plant.corrected, corrected), tau, level)


def test_the_corrected_model_leaves_less_than_the_noise_of_the_readings(plant):
    r = remainder(plant)
    assert r.count == 51  # of 19 in a second, 17 with a neighbour on both sides
    assert r.after["v"] < 0.2 * r.before["v"]
    for state in "qv":  # two readings differ by sqrt(2) sigma, and nine of ten by 1.6 times as much
        assert r.after[state] < 0.5 * np.sqrt(2.0) * norm.ppf(0.95) * SIGMA[state]
        assert r.one_step["unresolved"][state] <= r.one_step["after"][state]
    assert "at least 90 %" in r.statement
    assert r.confidence == 0.9
    assert 9 <= r.pieces <= 51
    assert f"51 held-out transitions, which are {r.pieces} independent pieces" in r.statement
    assert "of one run: how another differs is not known" in r.statement
    assert r.unbounded == ()


KINDS = {
    "white": lambda t, x, drawn: drawn,
    "lasting": lambda t, x, drawn: np.sin(2 * np.pi * t / 5.0),
    "quick": lambda t, x, drawn: np.sin(2 * np.pi * t / 0.7),
    "rare": lambda t, x, drawn: np.sign(drawn) * (abs(drawn) > 1.6),  # in a tenth of the steps
    "of the place": lambda t, x, drawn: np.sin(3.0 * x[0]),
    "dry": lambda t, x, drawn: -np.tanh(x[1] / 1e-2),
}
RATE, TAU, EVERY = 100.0, 0.05, 5


def moved(x, u, extra, seconds, steps):
    """The bench by Runge-Kutta steps under a held torque and what the model misses, `extra(seconds, x)`: (2, ...)."""
    h = seconds / steps

    def rate(t, x):
        return np.array([x[1], (u - example.WEIGHT * np.sin(x[0]) + extra(t, x)) / example.INERTIA])

    for k in range(steps):
        k1 = rate(k * h, x)
        k2 = rate((k + 0.5) * h, x + h / 2 * k1)
        k3 = rate((k + 0.5) * h, x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate((k + 1) * h, x + h * k3))
    return x


def recorded(kind, size, seed, seconds=20.0):
    """States (n, 2) and torques (n,) of a bench with a torque that the model lacks, and what it misses in each step."""
    rng = np.random.default_rng(seed)
    drawn, phase = rng.standard_normal(int(seconds * RATE) // EVERY + 1), rng.uniform(0, 6.28, 2)
    x, states, torques = np.array([0.4, 0.0]), [], []
    for k in range(int(seconds * RATE)):
        t, more = k / RATE, drawn[k // EVERY]
        u = 0.8 * np.sin(1.1 * t + phase[0]) + 0.7 * np.sin(3.1 * t + phase[1])
        states.append(x)
        torques.append(u)
        x = moved(x, u, lambda s, x, t=t, more=more: size * KINDS[kind](t + s, x, more), 1 / RATE, 3)
    states, torques = np.array(states), np.array(torques)
    there = states[:-EVERY:EVERY].T
    for k in range(EVERY):
        there = moved(there, torques[k:-EVERY:EVERY], lambda s, x: 0.0, 1 / RATE, 3)
    return states, torques, states[EVERY::EVERY] - there.T


def cut(states, torques, sigma, seed, name):
    """Windows of a second, with noise; each fourth is held out."""
    read = states[:, : len(sigma)] + sigma * np.random.default_rng(seed).standard_normal((len(states), len(sigma)))
    for k in range(len(states) // 100):
        s = slice(100 * k, 100 * k + 100)
        own = (read[s], read[s], read[s], np.zeros((100, 2)), torques[s, None])
        yield WindowPrediction(name, k % 4 == 3, np.arange(100 * k, 100 * k + 100) / RATE, *own)


@pytest.mark.parametrize("kind", list(KINDS))
def test_a_remainder_that_is_known_is_covered_as_often_as_was_asked(plant, kind):
    """Whatever the model misses, beside readings that are coarser or finer than it."""
    for size in (0.03, 0.3):
        runs, (states, _, missed) = [recorded(kind, size, 20 + k) for k in range(2)], recorded(kind, size, 90)
        for noise in ([1e-2], [1e-3, 1e-2]):
            windows = [w for k, (x, u, _) in enumerate(runs) for w in cut(x, u, noise, 70 + k, f"run {k}")]
            sigma = dict(zip("qv", noise, strict=False))
            r = bound_remainder(windows, sigma, (plant.corrected, plant.corrected), TAU, 0.95)
            slow = np.abs(states[:-EVERY:EVERY, 1]) <= (r.rest_after.below if r.rest_after else -1.0)
            by = [[b[s] for s in "qv"] for b in (r.rest_after.by if r.rest_after else r.after, r.after)]
            inside = np.all(np.abs(missed) <= np.where(slow[:, None], *by), axis=1)
            assert np.mean(inside) >= 0.95, (size, noise)


def test_too_few_transitions_bound_nothing(plant):
    r = remainder(plant, level=0.999)
    assert np.isinf(r.after["q"])
    assert "too few" in r.statement


def test_a_step_is_never_shorter_than_the_sampling(plant):
    assert remainder(plant, tau=1e-4).tau == pytest.approx(0.01)


def test_delay_and_lag_become_shifts(plant):
    applied = [AppliedEffect("input_delay", "u", {"delay": 0.02}), AppliedEffect("input_lag", "u", {"T": 0.01})]
    same, shifts = plant.corrected_by(applied)
    assert shifts == pytest.approx({"u": 0.03})
    assert same.state_names == plant.corrected.state_names


def test_a_run_that_moves_otherwise_is_one_piece(plant):
    """Two recordings of which one is shaken are two pieces, and leave two thirds of the confidence."""
    calm, rough = example.record(seed=3), example.record(seed=4)
    noise = 4.0 * example.SIGMA * np.random.default_rng(5).standard_normal(rough.traces[0].y.shape)
    (trace,) = rough.traces
    shaken = replace(rough, traces=(replace(trace, y=trace.y + noise),))
    windows = example.windows(calm) + tuple(replace(w, trace="rough") for w in example.windows(shaken))
    corrected, _ = plant.corrected_by(FOUND)
    r = bound_remainder(windows, SIGMA, (plant.corrected, corrected), 0.05, 0.9)
    assert (r.pieces, r.runs, r.by_run, r.confidence) == (2, 2, True, pytest.approx(2 / 3))
    assert "at least 66.6 % (of 90 % asked for, which takes 9 pieces)" in r.statement
    assert "2 runs, one piece each because they differ" in r.statement
    assert r.inside == 1.0
