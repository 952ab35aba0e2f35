"""A record in which nothing was commanded."""

from __future__ import annotations

import numpy as np

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from tests.diagnosis.plants import block


def test_an_input_at_rest_has_effects_that_are_scaled_by_one():
    """A mass that slides out under a force that no effect of the library is: all of them are tried."""
    rng, t = np.random.default_rng(4), np.arange(0.0, 8.0, 0.01)
    v, q, out = 1.0, 0.0, []
    for now in t:
        out.append(q)
        for i in range(10):
            v += 1e-3 * (0.6 * np.sin(2 * np.pi * 1.7 * (now + 1e-3 * i)) - 0.4 * v) / 2.0
            q += 1e-3 * v
    y = np.array(out)[:, None] + 1e-4 * rng.standard_normal((len(t), 1))
    record = Record((Trace("run", t, y, np.zeros((len(t), 1))),), ("q",), ("u",))
    d = diagnose(block(), record, DiagnosisSettings(max_effects=2))
    assert d.verdict in ("partial", "unexplained")
    assert all(np.isfinite(c.chi2_drop) for c in d.candidates)
