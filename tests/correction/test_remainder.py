"""The conformal bound covers fresh transitions as often as it says, and shrinks when the model is right."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from simgap.config.load import parse_case
from simgap.correction.remainder import bound_remainder
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
    corrected, shifts = plant.corrected_by(FOUND)
    return bound_remainder(example.windows(data), SIGMA, (plant.corrected, corrected), shifts, tau, level)


def test_the_corrected_model_needs_a_smaller_bound(plant):
    r = remainder(plant)
    assert r.count == 3 * 19
    assert r.after["v"] < 0.7 * r.before["v"]
    assert r.with_noise["v"] < 6 * 1e-2  # noise at both ends: sqrt(2) sigma, and its largest of many
    assert r.after["v"] < r.with_noise["v"]
    assert "at least 80 %" in r.statement
    assert "not inside the bound of q, v" in r.statement
    assert r.confidence == pytest.approx(0.8)  # of each bound 90 %
    assert 9 <= r.pieces <= 57
    assert f"57 held-out transitions, which are {r.pieces} independent pieces" in r.statement
    assert "of one run: how another differs is not known" in r.statement
    assert r.unbounded == ()
    # noise alone: two readings each, and both channels at once inside with probability 0.9
    reach = np.sqrt(2.0) * norm.ppf(0.5 + np.sqrt(0.9) / 2)
    for state in "qv":  # the corrected model leaves little but noise
        assert r.with_noise[state] == pytest.approx(reach * SIGMA[state], rel=0.3)


def one_step(y, u, tau):
    """The corrected pendulum over tau, written out by hand: (n, 2), (n,) -> (n, 2)."""

    def rate(x):
        dry = 0.19 * np.sign(x[:, 1])
        return np.stack([x[:, 1], (u - example.WEIGHT * np.sin(x[:, 0]) - dry) / example.INERTIA], axis=1)

    k1 = rate(y)
    k2 = rate(y + tau / 2 * k1)
    k3 = rate(y + tau / 2 * k2)
    return y + tau / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + tau * k3))


def test_coverage_of_other_recordings(plant):
    bound = remainder(plant, seed=3).with_noise
    limits = np.array([bound["q"], bound["v"]])
    shares = []
    for seed in range(10, 16):
        (trace,) = example.record(seed=seed).traces
        starts = np.arange(0, len(trace.t) - 5, 5)
        u = np.mean([trace.u[starts + k, 0] for k in range(5)], axis=0)
        residual = trace.y[starts + 5] - one_step(trace.y[starts], u, 0.05)
        shares.append(np.mean(np.all(np.abs(residual) <= limits, axis=1)))
    # 57 calibration transitions: the coverage of one draw is Beta(52, 6), 0.90 with a standard deviation of 0.04
    assert 0.82 <= np.mean(shares) <= 0.99


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
    corrected, shifts = plant.corrected_by(FOUND)
    r = bound_remainder(windows, SIGMA, (plant.corrected, corrected), shifts, 0.05, 0.9)
    assert (r.pieces, r.runs, r.by_run, r.confidence) == (2, 2, True, pytest.approx(2 / 3 - 0.1))
    assert "at least 56.6 % (of 90 % asked for, which takes 9 pieces)" in r.statement
    assert "2 runs, one piece each because they differ" in r.statement
    assert r.inside == 1.0
