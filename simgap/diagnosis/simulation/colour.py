"""Noise that remembers: a law of its autocorrelation, and residuals made white by it.

Each channel's noise is a white part and a part whose autocorrelation falls as exp(-|t| / tau). Residuals of a window
are replaced by the errors of their best linear prediction from those before, over the standard deviation of these: sums
of squares, sensitivities, the information criterion and intervals then count what is independent. It is taken as
stationary, samples as evenly spaced. Source: Durbin (1960), Rev. Int. Stat. Inst. 28(3), and Brockwell, Davis (1991),
Time Series: Theory and Methods, sec. 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.late import njit

ORDER = 60  # of the prediction


@dataclass(frozen=True, eq=False)
class Colour:
    """The law of the noise of all channels, in units of their standard deviations.

    Attributes:
        shared: (k,) share of the variance that remembers; tau: (k,) s, for how long.
        interval: s between samples; block: how many samples stand behind each reading, as their mean.
    """

    shared: Floats
    tau: Floats
    interval: float
    block: int = 1

    def covariance(self, lags: Ints) -> Floats:
        """Autocovariance of single samples at lags in samples: (l,) -> (k, l)."""
        held = self.shared[:, None] * np.exp(-np.abs(lags) * self.interval / self.tau[:, None])
        return np.asarray(held + (1.0 - self.shared)[:, None] * (lags == 0))

    def of_blocks(self, size: int, mean: bool) -> tuple[Colour, Floats]:
        """The law for every `size`-th reading, as block mean or as it is, and its standard deviation (k,)."""
        if not mean:
            return Colour(self.shared, self.tau, self.interval * size), np.ones(len(self.tau))
        after = Colour(self.shared, self.tau, self.interval, size)
        return after, np.sqrt(after._of_readings(1)[:, 0])

    def _of_readings(self, count: int) -> Floats:
        """Autocovariance of the readings at lags 0 ... count - 1, (k, count)."""
        if self.block == 1:
            return self.covariance(np.arange(count))
        apart = np.arange(1 - self.block, self.block)
        weight = (self.block - np.abs(apart)) / self.block**2
        lags = self.block * np.arange(count)[:, None] + apart
        return np.asarray(self.covariance(lags.ravel()).reshape(len(self.tau), count, -1) @ weight)

    @cached_property
    def predictors(self) -> tuple[Floats, Floats]:
        """Weights of the readings before, (k, ORDER + 1, ORDER), and standard deviations of the errors (k, ORDER + 1).

        Row n predicts from n readings, the latest first; standard deviations are over that of a reading.
        """
        g = self._of_readings(ORDER + 1)
        g = g / g[:, :1]
        weights, spread = np.zeros((len(g), ORDER + 1, ORDER)), np.ones((len(g), ORDER + 1))
        for c, gamma in enumerate(g):
            variance = 1.0
            for n in range(1, ORDER + 1):
                last = weights[c, n - 1, : n - 1]
                reflection = (gamma[n] - last @ gamma[n - 1 : 0 : -1]) / variance
                weights[c, n, : n - 1] = last - reflection * last[::-1]
                weights[c, n, n - 1] = reflection
                variance *= 1.0 - reflection**2
                spread[c, n] = np.sqrt(variance)
        return weights, spread


@njit("void(float64[:, ::1], int64[::1], float64[:, :, ::1], float64[:, ::1])", cache=True)
def whiten(residual: Floats, rows: Ints, weights: Floats, spread: Floats) -> None:
    """Residuals (n, k) become errors of prediction over their standard deviation, in place, window by window.

    rows: (w + 1,) first row of each window; weights, spread: see `Colour.predictors`.
    """
    order = weights.shape[2]
    for w in range(rows.size - 1):
        for i in range(rows[w + 1] - 1, rows[w] - 1, -1):
            n = min(i - rows[w], order)
            for c in range(residual.shape[1]):
                foreseen = 0.0
                for j in range(n):
                    foreseen += weights[c, n, j] * residual[i - 1 - j, c]
                residual[i, c] = (residual[i, c] - foreseen) / spread[c, n]
