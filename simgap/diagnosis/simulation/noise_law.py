"""The law of a record's noise: how large the misses may be, and what they remember of those before.

*Gross errors.* A miss is normal of the usual size or, a thousandth as likely at zero, anything at all. Beyond 3.7 times
the usual size the second is likelier: such a reading weighs nothing, and neither a model that comes a little nearer to
it nor one that goes further away is better for it; what one reading, or a push, does to a fit is limited. Sources:
Tukey (1960), in Contributions to Probability and Statistics, 448; Huber, Ronchetti (2009), Robust Statistics, sec. 4.5;
Lange, Little, Taylor (1989), J. Am. Stat. Assoc. 84 (the usual size, by the scale of Student's t).

*Colour.* Each channel's noise is a white part and a part whose autocorrelation falls as exp(-|t| / tau). Residuals of a
window are replaced by the errors of their best linear prediction from those before, over the standard deviation of
these: sums of squares, sensitivities, the information criterion and intervals then count what is independent. It is
taken as stationary, samples as evenly spaced. Source: Brockwell, Davis (1991), Time Series: Theory and Methods, sec.
5.2 (innovations), here of noise whose autocovariance falls by one factor from each reading to the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.thresholds import MOST, SELDOM, TAILS
from simgap.late import njit

LIMIT = float(np.sqrt(-2.0 * np.log(SELDOM)))
"""Beyond so many usual sizes a miss is rather a gross error."""


def limited(residual: Floats, spread: Floats) -> Floats:
    """Residuals whose squares add up to the loss under the law: small ones stay as they are, none exceeds 3.7 spreads.

    Gauss-Newton steps on them are those of iteratively reweighted least squares: (n, k), (k,) -> (n, k).
    """
    half = -0.5 * np.square(residual / spread)
    return np.asarray(np.copysign(spread * np.sqrt(-2.0 * np.log1p(np.expm1(half) / (1.0 + SELDOM))), residual))


def are_gross(loss: Floats, spread: Floats) -> Bools:
    """Which limited residuals (n, k) stand for gross errors: their loss at the limit, both laws equally likely."""
    return np.asarray(np.square(loss / spread) > -2.0 * np.log1p((SELDOM - 1.0) / (1.0 + SELDOM)))


def usual_size(misses: Floats, used: Floats) -> Floats:
    """Scale of Student's t by maximum likelihood, (n, k) -> (k,); used: (n, k) 1 for misses that are ones."""
    return np.array([_scale(own[kept > 0.0]) for own, kept in zip(misses.T, used.T, strict=True)])


def _scale(misses: Floats) -> float:
    if not misses.size:
        return 0.0
    s = 1.4826 * float(np.median(np.abs(misses))) + 1e-9
    for _ in range(20):
        s = float(np.sqrt(np.mean((TAILS + 1.0) / (TAILS + (misses / s) ** 2) * misses**2))) + 1e-12
    return s


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

    @property
    def faint(self) -> Bools:
        """Whether a part of the noise alone remembers, (k,)."""
        return np.asarray((self.shared > 0.0) & (self.shared < MOST))

    def of_blocks(self, size: int, mean: bool) -> tuple[Colour, Floats]:
        """The law for every `size`-th reading, as block mean or as it is, and its standard deviation (k,)."""
        own = (self.interval, size) if mean else (self.interval * size, 1)
        after = Colour(self.shared, self.tau, *own)
        return after, np.sqrt(after._moments[0])

    @cached_property
    def _moments(self) -> Floats:
        """Variance of a reading and covariance of two neighbours, (2, k)."""
        apart = np.arange(1 - self.block, self.block)
        weight = (self.block - np.abs(apart)) / self.block**2
        lags = (self.block * np.arange(2)[:, None] + apart)[:, None]  # samples, (2, 1, pairs)
        held = self.shared[:, None] * np.exp(-np.abs(lags) * self.interval / self.tau[:, None])
        return np.asarray((held + (1.0 - self.shared)[:, None] * (lags == 0)) @ weight)

    @cached_property
    def memory(self) -> tuple[Floats, Floats]:
        """(k,) correlation of two neighbouring readings, and by what factor it falls with each one further apart."""
        variance, neighbours = self._moments
        return neighbours / variance, np.exp(-self.block * self.interval / self.tau)


@njit("void(float64[:, ::1], int64[::1], float64[::1], float64[::1])", cache=True)
def whiten(residual: Floats, rows: Ints, near: Floats, fade: Floats) -> None:
    """Residuals (n, k) become errors of prediction over their standard deviation, in place, window by window.

    rows: (w + 1,) first row of each window; near, fade: see `Colour.memory`.
    """
    for w in range(rows.size - 1):
        for c in range(residual.shape[1]):
            foreseen, known = 0.0, 0.0  # and its variance, over that of a reading
            for i in range(rows[w], rows[w + 1]):
                missed, left = residual[i, c] - foreseen, 1.0 - known
                pull = near[c] - fade[c] * known  # covariance of the next reading with what is missed
                residual[i, c] = missed / np.sqrt(left)
                foreseen = fade[c] * foreseen + pull / left * missed
                known = fade[c] ** 2 * known + pull**2 / left
