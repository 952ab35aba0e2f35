"""Whether misses remember themselves, against noise that does not and noise that does."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from simgap.diagnosis.search import noise_colour
from simgap.diagnosis.search.noise_colour import memory_left
from simgap.diagnosis.verdict.faults import faint_memory


@pytest.fixture
def channels(monkeypatch):
    """Of a fit that leaves white misses (rows, k) less what a place and a rate took of each window."""

    def told(misses: np.ndarray, length: int = 200, worth: float = 1.0, look: Any = memory_left) -> tuple[Any, ...]:
        n, k = misses.shape
        rows = np.arange(0, n + 1, length)
        t = np.tile(np.linspace(-1.0, 1.0, length), n // length)
        states = np.stack([np.repeat(c[:, None], k, axis=1) * own for own in np.eye(k) for c in (np.ones(n), t)])
        left = misses.copy()
        for a, b in pairwise(rows):
            q = np.linalg.qr(states[:, a:b].reshape(2 * k, -1).T)[0]
            left[a:b] -= (q @ (q.T @ misses[a:b].ravel())).reshape(-1, k)
        monkeypatch.setattr(noise_colour, "state_columns", lambda *given: (left, states))
        model = SimpleNamespace(measured=("q", "p"))
        problem: Any = SimpleNamespace(rows=rows, weight=np.full((n, k), worth), model=model, colour=None)
        found: Any = SimpleNamespace(theta=None, x0=np.zeros((1, 1)))
        return look(problem, found)

    return told


@pytest.mark.parametrize("length", [200, 100, 50])
def test_white_noise_of_any_size_does_not_remember(channels, length):
    """Once in a million records by chance, in windows of any length: of short ones the states take more."""
    rng = np.random.default_rng(5)
    assert not any(channels(rng.normal(0.0, 3.0, (8000, 2)), length) for _ in range(100))


def test_a_trace_of_a_tenth_of_the_noise_remembers(channels):
    """A slow force that adds a tenth to the variance, on one channel of two; the states take a fifth of it."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        slow = lfilter([1.0], [1.0, -0.9], rng.standard_normal(7200))
        misses = rng.standard_normal((7200, 2))
        misses[:, 1] += slow / np.std(slow) * np.sqrt(0.1)
        assert channels(misses) == (1,)
        assert channels(misses, look=faint_memory) == ("p",)
        assert channels(misses, worth=0.5, look=faint_memory) == ()  # the rounding of an encoder
