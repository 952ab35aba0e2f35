"""What every form of bound has: the fit of one dimension, and the gap function made of the fits of all."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from simgap.arrays import Floats
from simgap.config.gap import GapSection
from simgap.gap.bounds.function import GapFunction
from simgap.gap.fitting.padding import PaddedSide
from simgap.gap.json_record import JsonRecord
from simgap.gap.lipschitz.grid import DimensionLipschitz
from simgap.gap.sampling.borders import Directed
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid

Sides = dict[str, PaddedSide]
"""Fitted sides by name (`upper` and `lower`, or `both`)."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Fresh iid samples: x (n, nx), u (n, nu), d (n, nx)."""

    x: Floats
    u: Floats
    d: Floats


@dataclass(frozen=True, eq=False)
class BoundInputs:
    """What a bound takes beside its fits.

    Attributes:
        where: the places of the samples. settings: of the fit. lipschitz: constants of each dimension.
        calibration: samples of a conformal bound. directed: samples of each dimension beside the grid, for an envelope.
    """

    where: SampleGrid
    settings: GapSection
    lipschitz: Sequence[DimensionLipschitz]
    calibration: Calibration | None = None
    directed: Sequence[Directed] = ()


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
            UserError: inputs that the form needs and that are missing or too few.
            BrokenPromise: when the grid does not resolve a residual, or the bound stays upside down.
        """
