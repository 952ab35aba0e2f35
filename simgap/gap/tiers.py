"""What a gap bound rests on: the guarantee tiers that are printed wherever gamma is.

1. deterministic: holds everywhere, given the Lipschitz constants it was padded with;
2. estimate: which of these constants are estimates, how they were obtained and how far they can be trusted;
3. statistical: fresh random samples that no fit has seen, violations among them, Clopper-Pearson upper bound.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import betaincinv

from simgap.errors import UserError
from simgap.geometry import Floats

if TYPE_CHECKING:
    from simgap.gap.function import GapFunction


@dataclass(frozen=True)
class Tier:
    """One statement: its level 1, 2 or 3 and its text, a full sentence for the reader of a report."""

    level: int
    text: str

    def to_json(self) -> dict[str, Any]:
        """Level and text."""
        return {"tier": self.level, "text": self.text}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Tier:
        """The inverse of `to_json`."""
        return Tier(int(data["tier"]), str(data["text"]))


def clopper_pearson_upper(n: int, violations: int, confidence: float = 0.95) -> float:
    """One-sided upper bound of a probability from `violations` among `n` iid trials (Clopper & Pearson 1934).

    Raises:
        UserError: for counts that cannot be.
    """
    if n < 1 or not 0 <= violations <= n:
        raise UserError(f"{violations} violations among {n} samples cannot be")
    return 1.0 if violations == n else float(betaincinv(violations + 1, n - violations, confidence))


@dataclass(frozen=True)
class FreshCheck:
    """A gap bound held against samples that no fit has seen.

    Attributes:
        samples, violations: rows, and rows that violate in at least one dimension.
        by_state: violations for each state; worst: largest excess over the bound for each state, 0 if none.
        upper, confidence: the violation probability is at most `upper` with this confidence.
        first: up to ten violating rows (x, u, d) for the report.
    """

    samples: int
    violations: int
    by_state: dict[str, int]
    worst: dict[str, float]
    upper: float
    confidence: float
    first: tuple[tuple[list[float], list[float], list[float]], ...] = ()

    @property
    def tier(self) -> Tier:
        """The statistical statement."""
        percent = f"{100 * self.confidence:g} %"
        return Tier(
            3,
            f"Checked on {self.samples:,} fresh random off-grid samples: {self.violations} violations; "
            f"the probability of one is at most {self.upper:.2g} with {percent} confidence (Clopper-Pearson).",
        )


def check_fresh(
    function: GapFunction, x: Floats, u: Floats, d: Floats, confidence: float = 0.95, d_upper: Floats | None = None
) -> FreshCheck:
    """Count violations of lo <= d <= hi: (n, nx), (n, nu), (n, nx); `d_upper` where hidden states spread the gap."""
    lo, hi = function.bounds(x, u)
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
        first,
    )


def deterministic_tier(padding: str) -> Tier:
    """Tier 1 for the three padding modes."""
    how = {
        "inflate": "the local Lipschitz constants of the gap on every cell; those of the basis are analytic",
        "per_axis": "the Lipschitz constants of the gap per axis; those of the basis are analytic bounds",
        "paper": "the Lipschitz constant of the gap; that of the basis is an analytic bound",
        "cells": "the Lipschitz constants of the gap per axis",
    }[padding]
    return Tier(1, f"The bound holds at every state of X and input of U, rounding included, given {how}.")


def estimate_tier(states: Sequence[str], lipschitz: Sequence[Floats], rough: Sequence[float], extra: str = "") -> Tier:
    """Tier 2: the Lipschitz constants are estimates on the grid; `rough` is each state's share of cells with a jump."""
    table = "; ".join(f"{s}: {', '.join(f'{v:.3g}' for v in row)}" for s, row in zip(states, lipschitz, strict=True))
    text = (
        "These Lipschitz constants are estimates (largest slope between neighbouring samples plus the local change "
        f"of slope), not bounds; per axis {table}."
    )
    jumps = [f"{100 * share:.2g} % of the cells for {s}" for s, share in zip(states, rough, strict=True) if share > 0]
    if jumps:
        text += f" The gap jumps in {', '.join(jumps)}; there the spread of the neighbouring samples stands in."
    return Tier(2, f"{text} {extra}".strip())
