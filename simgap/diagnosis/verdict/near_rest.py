"""A wider bound near rest: where dry friction sticks, what is left is larger and the rest of X need not pay for it.

Mondrian conformal prediction (Vovk, Gammerman and Shafer 2005, sec. 4.5): transitions that begin slowly and those that
do not are two classes, each with a quantile of its own. Which velocity tells them apart, and below which size, is
chosen on the transitions that were fitted, so that the held-out ones set the quantiles alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.reading.table import Floats
from simgap.split_conformal import fewest, reach

_SHARES = np.arange(0.05, 0.65, 0.05)
"""Of the fitted transitions, the shares that may be slow."""
_WORTH = 0.9
"""The mean bound over X falls to this share at least, or one class is kept: two need twice the held-out data."""


@dataclass(frozen=True)
class NearRest:
    """Where |velocity| <= below: state -> bound of what is left."""

    velocity: str
    below: float
    by: Mapping[str, float]

    def words(self) -> str:
        """For the statement of coverage."""
        return (
            f" Transitions that begin with |{self.velocity}| of {self.below:.3g} at most have a bound of their own, as "
            "has motion: the coverage holds in either."
        )


@dataclass(frozen=True, eq=False)
class Scored:
    """Transitions: score (n,), and for each velocity of a coordinate its size where they begin."""

    score: Floats
    speed: Mapping[str, Floats]

    def slow(self, velocity: str, below: float) -> NDArray[np.bool_]:
        """Which begin slowly."""
        return self.speed[velocity] <= below


@dataclass(frozen=True)
class Split:
    """Quantiles of the scores below and above a speed."""

    velocity: str
    below: float
    slow: float
    fast: float


def slow_and_fast(fitted: Scored, fresh: Scored, level: float, widest: Mapping[str, float]) -> Split | None:
    """The split that narrows the mean bound over X most; None if none does by a tenth or is wider near rest.

    Args:
        fitted: transitions that choose the split; fresh: held-out ones, which set the quantiles.
        level: coverage asked for in each class.
        widest: velocity -> its largest size in X, symmetric; the largest that was fitted where not given.
    """
    if len(fitted.score) < 2 * fewest(level):
        return None
    options = []
    for velocity, speed in fitted.speed.items():
        top = max(widest.get(velocity, 0.0) or float(speed.max()), 1e-300)
        for below in np.unique(np.quantile(speed, _SHARES)).tolist():
            if min(_count(fresh, velocity, below), _count(fitted, velocity, below)) < fewest(level):
                continue
            found = _quantiles(fitted, velocity, below, level)
            share = min(below / top, 1.0)
            options.append((share * found.slow + (1.0 - share) * found.fast, velocity, below))
    if not options:
        return None
    mean, velocity, below = min(options)
    if mean > _WORTH * reach(fitted.score, level):
        return None
    split = _quantiles(fresh, velocity, below, level)
    return split if split.slow > split.fast else None


def _count(of: Scored, velocity: str, below: float) -> int:
    """Of the smaller class."""
    slow = int(np.sum(of.slow(velocity, below)))
    return min(slow, len(of.score) - slow)


def _quantiles(of: Scored, velocity: str, below: float, level: float) -> Split:
    slow = of.slow(velocity, below)
    return Split(velocity, below, reach(of.score[slow], level), reach(of.score[~slow], level))
