"""What is of no practical size is not named, however surely the data show it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.noise import worth
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.simulation import parts
from tests.undeclared.nominals import nominal, record
from tests.undeclared.rig.textbook import Hidden, oscillator

FEW = ("viscous_friction", "input_delay", "input_bias")


def _found(bias, seconds):
    made = record(oscillator(), Hidden(bias={"u": bias}), 4, seconds=seconds)
    d = diagnose(nominal("oscillator"), made, DiagnosisSettings(effects=FEW))
    return d.verdict, [e.name for e in d.effects], [f.fault for f in d.recording]


def test_a_bias_far_below_the_noise_is_not_named():
    """A thousandth of the force: a minute shows it beyond doubt, and it moves no prediction by a tenth of the noise."""
    assert _found(0.0012, 60.0) == ("none", [], [])


def test_a_bias_that_confirm_does_not_ask_for_is_none():
    """It was `unexplained`, although the model as declared is down to the noise."""
    assert _found(0.003, 20.0) == ("none", [], [])


def test_a_bias_of_the_noise_s_size_is_named():
    assert _found(0.02, 20.0) == ("attributed", ["input_bias"], [])


@pytest.mark.parametrize("times", [1.0, 4.0])
def test_noise_that_is_estimated_too_large_hides_no_effect(monkeypatch, times):
    """Steps that a quick plant follows at once were taken for noise, within which the model as declared lay."""
    made = record(oscillator(), Hidden(bias={"u": 0.02}), 4, seconds=20.0)

    def louder(*given):
        found = worth(*given)
        return replace(found, sigma=times * found.sigma)

    monkeypatch.setattr(parts, "worth", louder)
    d = diagnose(nominal("oscillator"), made, DiagnosisSettings(effects=FEW))
    assert (d.verdict, [e.name for e in d.effects]) == ("attributed", ["input_bias"])
    for name, sigma in zip(made.measured, worth(made).sigma, strict=True):
        assert 0.9 < d.sigma[name] / sigma < 1.1


def test_a_noise_that_is_known_is_not_made_smaller():
    made = record(oscillator(), Hidden(bias={"u": 0.02}), 4, seconds=20.0)
    known = {name: 4.0 * float(s) for name, s in zip(made.measured, worth(made).sigma, strict=True)}
    assert diagnose(nominal("oscillator"), made, DiagnosisSettings(effects=FEW, noise=known)).sigma == known
