"""A force of the place that is no textbook's: told as a curve, never as the ripple and springs that look like it."""

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from tests.undeclared.nominals import nominal
from tests.undeclared.rig.strange import strange_runs
from tests.undeclared.rig.textbook import PLANTS


def answer(plant: str, kind: str, seed: int):
    book = PLANTS[plant]()
    made = strange_runs(book, kind, seed)
    traces = tuple(Trace(f"run{k}", t, np.ascontiguousarray(y), u) for k, (t, y, u) in enumerate(made))
    return diagnose(nominal(plant), Record(traces, book.measured, book.inputs))


@pytest.mark.parametrize(("plant", "kind", "seed"), [("pendulum", "square spring", 1), ("oscillator", "soft stop", 0)])
def test_is_told_as_a_curve(plant, kind, seed):
    d = answer(plant, kind, seed)
    assert [e.name for e in d.effects] == ["force_curve"]
    assert d.verdict == "attributed"


def test_a_ripple_of_which_one_period_was_met_is_not_sure():
    """Where the record went, a weak torsion is a spring and a ripple of a long period to within the noise."""
    d = answer("pendulum", "square spring", 0)
    assert d.verdict == "partial"
    assert any("1.2 periods of the ripple" in w for w in d.doubts)


def test_a_soft_stop_is_where_the_curve_falls():
    """The mechanism is nothing up to its edge and a straight line from there on."""
    (found,) = answer("oscillator", "soft stop", 0).effects
    values = np.array([found.parameters[f"F_{k}"].value for k in range(11)])
    assert np.abs(values[:7]).max() < 0.02 * np.abs(values).max()
    assert np.all(np.diff(values[7:]) < 0.0)
