"""What the samples of one dimension give before the dimensions are put together, for every kind of bound."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from simgap.gap.fitting.cell_fit import BlockFit, fit_blocks
from simgap.gap.fitting.conformal import CentreFit, fit_centre
from simgap.gap.fitting.envelope import NodeFit, fit_envelope
from simgap.gap.fitting.linear_fit import LinearFit, fit_linear
from simgap.gap.kinds.blocks import Blocks
from simgap.gap.sampling.samples import DimensionSamples
from simgap.gap.settings import GapSettings

DimensionFit = LinearFit | BlockFit | NodeFit | CentreFit


class Kind(Protocol):
    """What a kind of fit offers to be read back."""

    def from_json(self, data: Mapping[str, Any]) -> DimensionFit:
        """The inverse of its `to_json`."""


FITS: Mapping[str, Kind] = {"linear": LinearFit, "blocks": BlockFit, "envelope": NodeFit, "centre": CentreFit}


def fit_dimension(samples: DimensionSamples, settings: GapSettings) -> DimensionFit:
    """Fit one dimension; local slopes of the samples enter where they pad inside the program, no Lipschitz constant.

    Raises:
        UserError: for settings that do not fit the samples.
    """
    if settings.bound == "conformal":
        return fit_centre(samples, settings)
    if settings.bound == "envelope":
        return fit_envelope(samples, settings)
    if settings.bound == "scenario" and isinstance(settings.basis, Blocks):
        return fit_blocks(samples, settings)
    return fit_linear(samples, settings)


def fit_from_json(data: Mapping[str, Any]) -> DimensionFit:
    """A fit from what its `to_json` gave; KeyError, TypeError or ValueError for anything else."""
    return FITS[data["kind"]].from_json(data)
