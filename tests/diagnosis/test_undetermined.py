"""An effect that refines another is named only if the data give the number by which it does."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgap.diagnosis.search.confidence import undetermined
from simgap.effects.coulomb_friction import CoulombFriction
from simgap.effects.stribeck_friction import StribeckFriction


@pytest.mark.parametrize(("width", "error", "loose"), [(0.05, 0.04, True), (0.05, 0.01, False)])
def test_a_stribeck_peak_of_a_width_that_may_be_zero_is_coulomb_friction(width, error, loose):
    peak = SimpleNamespace(effect=StribeckFriction(), slots=(0, 1, 2))
    plain = SimpleNamespace(effect=CoulombFriction(), slots=(3,))
    at = SimpleNamespace(theta=np.array([0.018, 0.0181, width, 0.02]), slots=[0, 1, 2, 3])
    found = undetermined([peak, plain], at, np.array([1e-6, 2e-5, error, 0.5]), 1000)
    assert found == ([peak] if loose else [])
