"""Whether misses remember themselves, against noise that does not and noise that does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from simgap.diagnosis.search.noise_colour import memory_left


def remembers(misses: np.ndarray) -> bool:
    """Of a fit that leaves these misses (rows, k), in windows of 200 readings."""
    rows = np.arange(0, len(misses) + 1, 200)
    problem: Any = SimpleNamespace(residuals=lambda theta, x0: misses, rows=rows)
    found: Any = SimpleNamespace(theta=None, x0=None)
    return memory_left(problem, found)


def test_white_noise_of_any_size_does_not_remember():
    """Once in ten thousand records by chance: of 300 at most two."""
    rng = np.random.default_rng(5)
    assert sum(remembers(rng.normal(0.0, 3.0, (3600, 2))) for _ in range(300)) <= 2


def test_a_trace_of_a_tenth_of_the_noise_remembers():
    """A slow force that adds a tenth to the variance, on one channel of two."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        slow = lfilter([1.0], [1.0, -0.9], rng.standard_normal(3600))
        misses = rng.standard_normal((3600, 2))
        misses[:, 1] += slow / np.std(slow) * np.sqrt(0.1)
        assert remembers(misses)
