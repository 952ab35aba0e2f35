"""The guarantee tiers of a gap bound: the statements it rests on, printed wherever gamma is.

1. deterministic: holds everywhere, given the Lipschitz constants it was padded with;
2. estimate: which of these constants are estimates, how they were obtained and how far they can be trusted;
3. statistical: fresh random samples that no fit has seen (`fresh_check`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from simgap.arrays import Floats
from simgap.gap.json_record import JsonRecord


@dataclass(frozen=True)
class Tier(JsonRecord, names={"level": "tier"}):
    """One statement: its level 1, 2 or 3 and its text, a full sentence for the reader of a report."""

    level: int
    text: str


PROVEN = Tier(
    1,
    "The bound holds at every state of X and input of U, rounding included: simulator and model are both known as "
    "equations, and slope and value of their difference are enclosed on every cell by interval arithmetic. No "
    "Lipschitz constant is given or estimated.",
)


class Slopes(Protocol):
    """Slopes of one dimension."""

    @property
    def constants(self) -> Floats:
        """Per axis, (nx,)."""

    @property
    def proven(self) -> bool:
        """True if they are bounds and no estimates."""


def guarantee(
    padding: str, states: Sequence[str], slopes: Sequence[Slopes], rough: Sequence[float], extra: str = ""
) -> tuple[Tier, ...]:
    """Tiers of a padded bound; `rough` is each state's share of cells with a jump that a sample stands in for."""
    if all(known.proven for known in slopes):
        return (PROVEN,)
    return deterministic_tier(padding), estimate_tier(states, [known.constants for known in slopes], rough, extra)


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
    """Tier 2: Lipschitz constants, (nx,) a state, are estimates; `rough` is each state's share of cells with a jump."""
    table = "; ".join(f"{s}: {', '.join(f'{v:.3g}' for v in row)}" for s, row in zip(states, lipschitz, strict=True))
    text = (
        "These Lipschitz constants are estimates (largest slope between neighbouring samples plus the local change "
        f"of slope), not bounds; per axis {table}."
    )
    jumps = [f"{100 * share:.2g} % of the cells for {s}" for s, share in zip(states, rough, strict=True) if share > 0]
    if jumps:
        text += (
            f" The gap jumps in {', '.join(jumps)}; there the spread of the neighbouring samples stands in. It holds a "
            "jump between two samples whole, and misses a peak narrower than a cell by any factor."
        )
    return Tier(2, f"{text} {extra}".strip())


def directed_words(states: Sequence[str], count: int, factors: Sequence[float]) -> str:
    """Sentence on the samples on borders and beside switching surfaces; empty without them."""
    if not count:
        return ""
    table = ", ".join(f"{factor:.2g} for {s}" for s, factor in zip(states, factors, strict=True))
    return (
        f"{count:,} states on the border of X and on both sides of the switching surfaces that the case declares are "
        "covered besides. From the centre of its cell to one of them the gap rises by at most so many times what "
        f"slopes allow: {table}. Where a surface is not declared, nothing limits that factor."
    )
