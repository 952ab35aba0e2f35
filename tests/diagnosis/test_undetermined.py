"""An effect that refines another is named only if the data give the number by which it does."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgap.diagnosis.search.confidence import undetermined
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.verdict import sets
from simgap.effects.base import Scales
from simgap.effects.forces import Cogging
from simgap.effects.friction import CoulombFriction, DahlFriction, StribeckFriction
from simgap.effects.inputs import InputSaturation


@pytest.mark.parametrize(("width", "error", "loose"), [(0.05, 0.04, True), (0.05, 0.01, False)])
def test_a_stribeck_peak_of_a_width_that_may_be_zero_is_coulomb_friction(width, error, loose):
    peak = SimpleNamespace(effect=StribeckFriction(), slots=(0, 1, 2))
    plain = SimpleNamespace(effect=CoulombFriction(), slots=(3,))
    at = SimpleNamespace(theta=np.array([0.018, 0.0181, width, 0.02]), slots=[0, 1, 2, 3])
    found = undetermined([peak, plain], at, np.array([1e-6, 2e-5, error, 0.5]), 1000)
    assert found == ([peak] if loose else [])


@pytest.mark.parametrize(("effect", "values", "unsure"), [
    (DahlFriction(), {"F_c": 39.6, "d": 206.0}, "never slides"),
    (DahlFriction(), {"F_c": 0.2, "d": 0.1}, ""),
    (Cogging(), {"A": 0.1, "n": 2.0, "phase": 0.0}, "0.95 periods"),
    (Cogging(), {"A": 0.1, "n": 6.0, "phase": 0.0}, ""),
    (InputSaturation(), {"limit": 1.2}, "of one size"),  # beyond it the commands are -1.5 and 1.5
    (InputSaturation(), {"limit": 0.8}, ""),
    (InputSaturation(), {"limit": 2.0}, ""),
])  # fmt: skip
def test_what_looks_like_another_force_wherever_the_record_was_is_doubted(effect, values, unsure):
    why = effect.doubt(values, np.linspace(-1.5, 1.5, 7))
    assert unsure in why
    assert bool(why) == bool(unsure)


@pytest.mark.parametrize(("places", "fewest"), [((0.0, 0.0), 2), ((-0.03, 0.72), 9), ((-4.0, 4.0), 2)])
def test_a_ripple_is_sought_from_one_period_on(places, fewest):
    starts = Cogging().starts(Scales(0.01, places=places))
    assert [start.point([1.0, 0.0])["n"] for start in starts] == list(range(fewest, 17))


def _variances(covariance):
    return Fit(np.zeros(3), np.zeros((1, 2)), (), 1.0, covariance, (), True).variances


def test_what_a_half_of_the_data_does_not_show_has_no_bound():
    seen = np.array([[4.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 9.0]])
    assert _variances(seen) == pytest.approx([4.0, np.inf, 9.0])
    together = np.linalg.pinv(np.array([[1.0, 2.0], [2.0, 4.0]]))  # two coefficients of which one sum is seen
    assert np.all(np.isinf(_variances(together)))
    assert _variances(np.diag([1.0, 4.0])) == pytest.approx([1.0, 4.0])


@pytest.mark.parametrize(("worse_by", "left"), [(2.0, "coulomb_friction"), (500.0, "stribeck_friction")])
def test_a_finer_effect_of_a_loose_number_goes_only_where_the_coarser_one_is_as_good(monkeypatch, worse_by, left):
    fine = SimpleNamespace(effect=StribeckFriction(), slots=(0, 1, 2))
    plain = SimpleNamespace(effect=CoulombFriction(), slots=(3,))
    found = SimpleNamespace(members=(fine,), fit=None, bic=100.0)
    coarse = SimpleNamespace(members=(plain,), fit=None, bic=100.0 + worse_by)
    monkeypatch.setattr(sets, "vanished", lambda *_: [])
    monkeypatch.setattr(sets, "errors_of", lambda *_: (None, 1))
    monkeypatch.setattr(sets, "undetermined", lambda members, *_: [c for c in members if c is fine])
    kept = sets.real(SimpleNamespace(coarser=lambda e, c: coarse), found, False)
    assert [c.effect.name for c in kept.members] == [left]


def test_a_limit_that_no_command_keeps_is_an_input_without_effect():
    assert "no effect" in InputSaturation().doubt({"limit": 1.0}, np.array([3.0, 5.0, 10.0]))
