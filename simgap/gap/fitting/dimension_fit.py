"""Base of every form of bound: fits of a dimension, the gap function made of all of them, and what it rests on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from simgap.arrays import Floats
from simgap.config.gap import GapSection
from simgap.gap.bounds.function import PROVEN, GapFunction, Tier
from simgap.gap.fitting.padding import PaddedSide
from simgap.gap.json_record import JsonRecord
from simgap.gap.lipschitz.grid import DimensionLipschitz
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid

Sides = dict[str, PaddedSide]
"""Fitted sides by name (`upper` and `lower`, or `both`)."""


@dataclass(frozen=True, eq=False)
class BoundInputs:
    """Inputs of a bound beside its fits.

    Attributes:
        where: the places of the samples. settings: of the fit. lipschitz: constants of each dimension.
    """

    where: SampleGrid
    settings: GapSection
    lipschitz: Sequence[DimensionLipschitz]


class DimensionFit(JsonRecord, ABC):
    """Fit of one dimension; a form of bound is a subclass."""

    @classmethod
    @abstractmethod
    def of(cls, samples: DimensionSamples, settings: GapSection) -> Self:
        """Fit one dimension.

        Raises:
            UserError: for settings that do not fit the samples.
        """

    @classmethod
    @abstractmethod
    def bound(cls, fits: Sequence[Self], given: BoundInputs) -> tuple[GapFunction, list[Sides]]:
        """The gap function of all dimensions, padded, and the fitted sides of each; none of a bound without a program.

        Raises:
            BrokenPromise: when the grid does not resolve a residual, or the bound stays upside down.
        """


def guarantee(
    padding: str, given: BoundInputs, rough: Sequence[float], directed: int, factors: Sequence[float], extra: str = ""
) -> tuple[Tier, ...]:
    """Tiers of a padded bound.

    Args:
        padding: see `deterministic_tier`. given: what the bound was made of.
        rough: each state's share of cells with a jump that a sample stands in for.
        directed, factors: see `directed_words`. extra: a sentence on the padding.
    """
    slopes, states = [known.grid for known in given.lipschitz], given.where.states
    if all(known.proven for known in slopes):
        return (PROVEN,)
    text = f"{extra} {directed_words(states, directed, factors)}".strip()
    return deterministic_tier(padding), estimate_tier(states, [known.constants for known in slopes], rough, text)


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
            f" The gap jumps in {', '.join(jumps)}; there the spread of the neighbouring samples is used instead. It "
            "covers a jump between two samples, and misses a peak narrower than a cell by any factor."
        )
    return Tier(2, f"{text} {extra}".strip())


def directed_words(states: Sequence[str], count: int, factors: Sequence[float]) -> str:
    """Sentence on the samples on borders and beside switching surfaces; empty without them."""
    if not count:
        return ""
    table = ", ".join(f"{factor:.2g} for {s}" for s, factor in zip(states, factors, strict=True))
    return (
        f"{count:,} states on the border of X and on both sides of the switching surfaces that the case declares are "
        "covered too. Between the centre of its cell and such a state the gap rises by at most this factor times "
        f"what the slopes allow: {table}. Where a surface is not declared, that factor is unlimited."
    )
