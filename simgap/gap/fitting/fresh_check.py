"""A gap bound held against fresh random samples that no fit has seen: violations and their Clopper-Pearson bound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.errors import UserError
from simgap.gap.bounds.function import GapFunction
from simgap.gap.bounds.outside import Outside, worst_outside
from simgap.gap.bounds.tiers import Tier
from simgap.late import scipy


def clopper_pearson_upper(n: int, violations: int, confidence: float = 0.95) -> float:
    """One-sided upper bound of a probability from `violations` among `n` iid trials (Clopper & Pearson 1934).

    Raises:
        UserError: for counts that cannot be.
    """
    if n < 1 or not 0 <= violations <= n:
        raise UserError(f"{violations} violations among {n} samples cannot be")
    return 1.0 if violations == n else float(scipy.special.betaincinv(violations + 1, n - violations, confidence))


@dataclass(frozen=True)
class FreshCheck:
    """A gap bound held against samples that no fit has seen.

    Attributes:
        samples, violations: independent trials, and those that violate in at least one dimension: rows, or whole
            sequences of steps where a simulator remembers; `steps` is then how many steps they have together.
        by_state: violations for each state; worst: largest excess over the bound for each state, 0 if none.
        upper, confidence: the violation probability is at most `upper` with this confidence.
        first: up to ten violating rows (x, u, d) for the report; outside: the worst of all, None if there is none.
    """

    samples: int
    violations: int
    by_state: dict[str, int]
    worst: dict[str, float]
    upper: float
    confidence: float
    steps: int | None = None
    first: tuple[tuple[list[float], list[float], list[float]], ...] = ()
    outside: Outside | None = None

    @property
    def tier(self) -> Tier:
        """The statistical statement."""
        percent = f"{100 * self.confidence:g} %"
        if self.steps is not None:
            return Tier(
                3,
                f"Checked on {self.samples:,} fresh random sequences of {self.steps:,} steps together: "
                f"{self.violations} of them with a step outside; the probability that a sequence has one is at most "
                f"{self.upper:.2g} with {percent} confidence (Clopper-Pearson; sequences are independent, their steps "
                "are not).",
            )
        return Tier(
            3,
            f"Checked on {self.samples:,} fresh random off-grid samples: {self.violations} violations; "
            f"the probability of one is at most {self.upper:.2g} with {percent} confidence (Clopper-Pearson).",
        )


@dataclass(frozen=True)
class BorderCheck:
    """A bound held against samples on the border of X and on both sides of switching surfaces: directed, not random.

    Attributes:
        samples, violations: pairs of a state and an input, and those that violate in at least one dimension.
        surfaces: switching surfaces of the case. worst: largest excess over the bound for each state, 0 if none.
        outside: the worst of all, None if there is none.
    """

    samples: int
    violations: int
    surfaces: int
    worst: dict[str, float]
    outside: Outside | None = None

    @property
    def tier(self) -> Tier:
        """The count; it is no part of the statistical statement."""
        surfaces = f" and on both sides of {self.surfaces} declared switching surfaces" if self.surfaces else ""
        return Tier(
            3,
            f"Checked besides on {self.samples:,} samples on faces, edges and corners of X{surfaces}: "
            f"{self.violations} outside. They are directed, not random, and no part of that probability.",
        )


def check_fresh(
    function: GapFunction, x: Floats, u: Floats, d: Floats, confidence: float = 0.95, d_upper: Floats | None = None
) -> FreshCheck:
    """Count violations of lo <= d <= hi: (n, nx), (n, nu), (n, nx); `d_upper` where hidden states spread the gap.

    Raises:
        UserError: samples outside of X x U, where there is no bound that they could confirm.
    """
    lo, hi = function.bounds(x, u)
    unbounded = int((~np.isfinite(lo) | ~np.isfinite(hi)).any(axis=1).sum())
    if unbounded:
        raise UserError(
            f"{unbounded} of {len(x)} samples lie outside the X or U of the bound: they say nothing of it",
            remedy="Run `fresh` again.",
        )
    top = d if d_upper is None else d_upper
    excess = np.maximum(lo - d, top - hi)
    bad = ~(excess <= 0.0)
    rows = bad.any(axis=1)
    states = function.domain.states
    count = int(rows.sum())
    first = tuple((x[k].tolist(), u[k].tolist(), d[k].tolist()) for k in np.flatnonzero(rows)[:10])
    return FreshCheck(
        len(x),
        count,
        {s: int(bad[:, i].sum()) for i, s in enumerate(states)},
        {s: float(max(excess[:, i].max(initial=0.0), 0.0)) for i, s in enumerate(states)},
        clopper_pearson_upper(len(x), count, confidence),
        confidence,
        first=first,
        outside=worst_outside((states, function.domain.inputs), x, u, (d, top), lo, hi),
    )


def check_sequences(
    excess: Floats, path: Floats, begins: Ints, states: Sequence[str], confidence: float = 0.95
) -> FreshCheck:
    """Count sequences with any step outside.

    Args:
        excess: (n, nx) by how much each step's gap lies outside, negative inside; path: (n,) the same of its path.
        begins: rows at which a sequence begins, the first of them 0.
        states: names.
        confidence: of the Clopper-Pearson bound.
    """
    bad = ~((excess <= 0.0).all(axis=1) & (path <= 0.0))
    failed = int(np.logical_or.reduceat(bad, begins).sum())
    worst = {s: float(max(excess[:, i].max(), 0.0)) for i, s in enumerate(states)}
    return FreshCheck(
        len(begins), failed, {s: int((excess[:, i] > 0).sum()) for i, s in enumerate(states)},
        worst | ({"path": float(path.max())} if (path > 0).any() else {}),
        clopper_pearson_upper(len(begins), failed, confidence), confidence, steps=len(excess),
    )  # fmt: skip
