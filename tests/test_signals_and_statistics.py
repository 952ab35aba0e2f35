"""What stands in for `scipy.signal` and `scipy.stats`, which take long to import, against these."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal, stats

from simgap import signals, statistics

WINDOWS = [(5, 2), (7, 3), (21, 4), (51, 5)]


@pytest.mark.parametrize(("size", "order"), WINDOWS)
@pytest.mark.parametrize("deriv", [0, 1, 2])
def test_local_polynomials_are_those_of_scipy(size, order, deriv):
    y = np.random.default_rng(size).normal(size=200).cumsum()
    ours = signals.savgol_filter(y, size, order, deriv, 0.01)
    theirs = signal.savgol_filter(y, size, order, deriv, 0.01)
    np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-9 * np.abs(theirs).max())
    weights = signal.savgol_coeffs(size, order, deriv, 0.01)
    mine = signals.savgol_coeffs(size, order, deriv, 0.01)
    np.testing.assert_allclose(mine, weights, rtol=1e-8, atol=1e-9 * np.abs(weights).max())


P = np.array([1e-6, 0.01, 0.3, 0.5, 0.95, 1.0 - 1e-6])
X = np.linspace(-6.0, 6.0, 25)
PAIRS = {
    "norm.cdf": (statistics.norm.cdf(X), stats.norm.cdf(X)),
    "norm.ppf": (statistics.norm.ppf(P), stats.norm.ppf(P)),
    "chi2.ppf": (statistics.chi2.ppf(P, 3), stats.chi2.ppf(P, 3)),
    "chi2.isf": (statistics.chi2.isf(P, 40.0), stats.chi2.isf(P, 40.0)),
    "t.ppf": (statistics.student.ppf(P, 7), stats.t.ppf(P, 7)),
    "t.logpdf": (statistics.student.logpdf(X, 4.0), stats.t.logpdf(X, 4.0)),
    "f.ppf": (statistics.fisher.ppf(P, 2, 90), stats.f.ppf(P, 2, 90)),
}


@pytest.mark.parametrize("name", PAIRS)
def test_distributions_are_those_of_scipy(name):
    ours, theirs = PAIRS[name]
    np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-14)
