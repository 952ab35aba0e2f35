"""Dry friction that creeps before it slides, as real friction does and the library's does not."""

from __future__ import annotations

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.result import DiagnosisSettings
from tests.undeclared.nominals import nominal, record
from tests.undeclared.rig.textbook import PLANTS, Hidden


def test_a_drift_that_halves_disagree_on_does_not_take_the_friction_with_it():
    """BIC adds a drift of the cart for the creep; with it halves of the data disagree, and nothing was named."""
    made = record(PLANTS["cart_pole_urdf"](), Hidden(coulomb={"rail": 0.4155}), 10)
    d = diagnose(nominal("cart_pole_urdf"), made, DiagnosisSettings(effects=("coulomb_friction",)))
    assert d.verdict == "attributed"
    assert [(e.name, e.on) for e in d.effects] == [("coulomb_friction", "rail")]
    assert abs(d.effects[0].parameters["F_c"].value - 0.4155) < 0.005
