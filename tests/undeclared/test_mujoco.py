"""Effects hidden in MuJoCo, an engine that shares nothing with the fit; the two engines of the study compared."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from tests.undeclared.plant import pendulum
from tests.undeclared.rig import mujoco_pendulum
from tests.undeclared.rig import pendulum as rig
from tests.undeclared.scoring import mark


@pytest.mark.parametrize("name", mujoco_pendulum.SINGLES)
def test_the_two_engines_of_the_study_agree(name):
    hidden = mujoco_pendulum.draw(np.random.default_rng(3), name)
    ((_, angle, command),) = mujoco_pendulum.record(hidden, np.random.default_rng(7), 0.0, seconds=4.0, traces=1)
    start = np.random.default_rng(7).uniform(-0.5, 0.5, 2)
    x = rig.move(hidden, command[:, 0], start)
    assert np.ptp(x[:, 0]) > 0.5
    np.testing.assert_allclose(x[:, :1] + hidden.offset, angle, atol=3e-5)
    still = rig.move(rig.Hidden(), command[:, 0], start)
    assert np.abs(angle - still[:, :1]).max() > 3e-3  # what was hidden shows


@pytest.mark.parametrize("name", ["viscous_friction", "mass", "com", "fractional_delay"])
def test_hidden_in_another_engine(name):
    rng = np.random.default_rng(3)
    hidden = mujoco_pendulum.draw(rng, name)
    traces = mujoco_pendulum.record(hidden, rng, 1e-3, seconds=8.0)
    record = Record(tuple(Trace(f"t{k}", *a) for k, a in enumerate(traces)), ("angle",), ("torque",))
    m = mark(diagnose(pendulum(), record), asdict(hidden))
    assert (m.verdict, m.exact) == ("attributed", True)
    (error,) = (m.errors or m.listed_errors).values()
    assert error <= 0.005
