"""Which of several hypotheses of one record is put to the data that confirm."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from simgap.diagnosis import diagnose as diagnosing
from simgap.diagnosis.diagnose import _Sought


@pytest.fixture
def sought(monkeypatch):
    """Makes hypotheses that are down to the noise; with a channel left out nothing can be compared."""
    monkeypatch.setattr(diagnosing, "plausible", lambda kept: True)
    monkeypatch.setattr(_Sought, "choice", SimpleNamespace(kept=None))
    monkeypatch.setattr(_Sought, "score", np.zeros(0))
    under = SimpleNamespace(parts=None, reached=True, found=None)
    return lambda *left_out: _Sought(None, under, left_out, coloured=False)


def test_what_explains_every_channel_stands_instead_of_what_leaves_one_out(sought):
    """A velocity in degrees a second looks filtered where it is left out, and a gain of 57 goes with it."""
    fewer, all_channels = sought("a filtered velocity"), sought()
    assert not fewer.settled
    assert fewer.likeliest([all_channels]).filtered == ()
    assert all_channels.likeliest([fewer]) is all_channels
