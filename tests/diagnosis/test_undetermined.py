"""An effect that refines another is named only if the data give the number by which it does."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgap.diagnosis.search.confidence import undetermined
from simgap.effects.forces import Cogging
from simgap.effects.friction import CoulombFriction, DahlFriction, StribeckFriction


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
])  # fmt: skip
def test_what_looks_like_another_force_wherever_the_record_was_is_doubted(effect, values, unsure):
    why = effect.doubt(values, (-1.5, 1.5))
    assert unsure in why
    assert bool(why) == bool(unsure)
