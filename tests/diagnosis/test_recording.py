"""Faults of a recording are told apart from what the plant lacks, on plants that share no code with the fit."""

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.simulation.colour import Colour, whiten
from tests.diagnosis import rigs

FEW = DiagnosisSettings(effects=("viscous_friction", "coulomb_friction", "input_gain", "input_delay", "spring"))


def _diagnosed(rig, fault, seed=1, **hidden):
    return diagnose(rig.model, rigs.record(rig, fault, seed, seconds=6.0, **hidden), FEW)


@pytest.mark.parametrize("fault", ["coloured noise", "drift", "input late", "velocity filtered"])
def test_a_perfect_model_under_a_fault_lacks_nothing(fault):
    d = _diagnosed(rigs.pendulum(), fault)
    assert d.verdict == "none"
    assert not d.effects
    assert [f.fault for f in d.recording] == [rigs.FAULTS[fault][1]]


def test_an_effect_is_named_beside_the_fault_and_its_interval_holds():
    for fault in ("coloured noise", "input late"):
        d = _diagnosed(rigs.oscillator(), fault, viscous=0.3)
        assert d.verdict == "attributed"
        (found,) = d.effects
        assert found.name == "viscous_friction"
        lo, hi = found.parameters["b"].ci95
        assert lo <= 0.3 <= hi
        assert [f.fault for f in d.recording] == [rigs.FAULTS[fault][1]]


def test_the_size_of_a_fault_is_told():
    late, drift = (_diagnosed(rigs.pendulum(), f).recording[0] for f in ("input late", "drift"))
    assert late.value == pytest.approx(0.01, rel=0.05)
    assert drift.value == pytest.approx(4e-3, rel=0.05)


def test_errors_of_prediction_are_white():
    rng, dt = np.random.default_rng(5), 0.005
    y = rigs.ar1(rng, 40_000, 0.8, 0.03, dt) + 0.6 * rng.standard_normal(40_000)
    colour = Colour(np.array([0.64]), np.array([0.03]), dt)
    e = y[:, None].copy()
    whiten(e, np.array([0, len(e)]), *colour.predictors)
    assert np.std(e) == pytest.approx(1.0, abs=0.02)
    assert abs(np.corrcoef(e[1:, 0], e[:-1, 0])[0, 1]) < 0.015
    means = y.reshape(-1, 5).mean(axis=1)
    after, spread = colour.of_blocks(5, True)
    e = means[:, None] / spread
    whiten(e, np.array([0, len(e)]), *after.predictors)
    assert np.std(e) == pytest.approx(1.0, abs=0.03)
