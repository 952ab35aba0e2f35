"""What of the recordings lies outside X and U is said, as a bound holds on these alone."""

import numpy as np
import pytest

from simgap.diagnosis.record.record import Record, Trace
from simgap.plants.context import Context
from simgap.stages.diagnosis import outside


def record(q, w, u):
    t = np.arange(len(q)) * 0.01
    own = Trace("a", t, np.stack([q, w], axis=1).astype(float), np.array(u, dtype=float)[:, None])
    return Record((own, own), ("x1", "x2"), ("u",))


@pytest.fixture
def context(vary):
    """The pendulum: X is [-0.2, 0.2] rad x [-0.5, 0.5] rad/s, U ends at 1.2 N m."""
    return Context.load(vary("pendulum", {}))


def test_samples_outside_are_counted_once_and_the_farthest_is_told(context):
    said = outside(context, record([0, 0.3, -0.9, 0.1], [0, 0.7, 0, 0], [0, 0, 0, -1.2]))
    assert said.startswith("50 % of the samples lie outside")  # two of four, one of them in two states
    assert "x1 reaches -0.9 rad, X [-0.2, 0.2]" in said
    assert "x2 reaches 0.7 rad/s, X [-0.5, 0.5]" in said
    assert "u reaches" not in said


def test_commands_outside_are_told_and_ends_are_inside(context, vary):
    said = outside(context, record([0.2, 0], [-0.5, 0], [1.2, 3]))
    assert said.startswith("50 %")
    assert "u reaches 3 N m, U [-1.2, 1.2]" in said
    assert outside(context, record([0.2, 0], [-0.5, 0], [1.2, -1.2])) is None
    free = Context.load(vary("pendulum", {"gap": None, "synthesis": None, "validation": None}))
    assert outside(free, record([9, 0, 0], [0, 0, 0], [0, 0, 0])) is None


def test_a_record_that_is_mostly_outside_may_have_other_columns(vary):
    """Degrees for radians, and a case that has no bound."""
    free = Context.load(vary("pendulum", {"gap": None, "synthesis": None, "validation": None}))
    said = outside(free, record([9, 8, 0], [0, 0, 0], [0, 0, 0]))
    assert said.startswith("67 % of the samples lie outside the case's X and U: x1 reaches 9 rad")
    assert said.endswith("compare units, signs and order of the columns.")


def test_single_precision_is_not_outside(context):
    """A command of 1.2 N m that was logged in single precision is 1.2000000477."""
    rounded = np.array([1.2, -1.2], dtype=np.float32)
    assert outside(context, record([0, 0], [0, 0], rounded)) is None
