"""What is of no practical size is not named, however surely the data show it."""

from __future__ import annotations

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.result import DiagnosisSettings
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
