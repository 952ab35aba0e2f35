"""The law of misses with gross errors, by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgap.diagnosis.conclude import _warnings
from simgap.diagnosis.simulation.noise_law import LIMIT, are_gross, limited, usual_size

RNG = np.random.default_rng(20)


def test_noise_keeps_its_sum_of_squares():
    noise = RNG.standard_normal((200_000, 1))
    assert np.mean(limited(noise, np.ones(1)) ** 2) == pytest.approx(1.0, abs=0.01)


def test_what_a_reading_counts_is_limited_whatever_it_misses_by():
    misses = np.array([[5.0], [1e3], [-1e9]])
    counts = limited(misses, np.ones(1)) ** 2
    assert np.all(counts < 2.0 * np.log(1001.0) + 1e-9)
    assert np.sign(limited(misses, np.ones(1))).ravel().tolist() == [1.0, 1.0, -1.0]


@pytest.mark.parametrize("size", [1.0, 7.0])
def test_beyond_the_limit_a_miss_is_a_gross_error(size):
    misses = size * LIMIT * np.array([[0.99], [1.01], [-1.01]])
    assert are_gross(limited(misses, np.array([size])), np.array([size])).ravel().tolist() == [False, True, True]


def test_the_loss_is_that_of_the_mixture():
    z, own, any_ = np.linspace(-6, 6, 41)[:, None], 1.0, 1e-3
    loss = -2.0 * np.log((own * np.exp(-0.5 * z**2) + any_) / (own + any_))
    assert np.allclose(limited(z, np.ones(1)) ** 2, loss)


def test_the_usual_size_hardly_sees_a_push():
    misses = RNG.standard_normal((4000, 1))
    used = np.ones_like(misses)
    clean = float(usual_size(misses, used)[0])
    misses[1000:1200] += 500.0
    assert clean < float(usual_size(misses, used)[0]) < 1.25 * clean


def test_the_usual_size_does_not_count_what_was_lost():
    misses = RNG.standard_normal((4000, 1))
    used = (RNG.random((4000, 1)) > 0.6).astype(float)
    kept = misses[used > 0.0][:, None]
    assert usual_size(misses * used, used) == usual_size(kept, np.ones_like(kept))


@pytest.mark.parametrize(("stray", "told"), [(0, False), (2, False), (12, True)])
def test_readings_far_out_are_told_as_gross_errors_beyond_what_chance_makes(stray, told):
    """Of ten thousand Gaussian readings two lie beyond 3.7 standard deviations."""
    held = SimpleNamespace(stray=stray, free=10_000, at_noise=True, horizon=object())
    kept = SimpleNamespace(fit=SimpleNamespace(converged=True))
    assert any("gross errors" in words for words in _warnings(held, kept, 0.5)) == told
