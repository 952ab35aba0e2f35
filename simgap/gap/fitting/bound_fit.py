"""The bound of all dimensions from the fits of each: padded, put together and reported, for every form of bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.gap import GapSection
from simgap.errors import BrokenPromise, UserError
from simgap.gap.bases import Blocks
from simgap.gap.bounds.function import GapFunction
from simgap.gap.fitting.acceptance import remedy
from simgap.gap.fitting.cell_fit import BlockFit
from simgap.gap.fitting.dimension_fit import BoundInputs, DimensionFit, Sides
from simgap.gap.fitting.linear_fit import LinearFit
from simgap.gap.json_record import JsonRecord
from simgap.gap.lipschitz.grid import DimensionLipschitz, GridLipschitz, LipschitzRow
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid
from simgap.gap.thresholds import GATE

FITS: Mapping[str, type[DimensionFit]] = {
    "linear": LinearFit,
    "blocks": BlockFit,
}


def fit_dimension(samples: DimensionSamples, settings: GapSection) -> DimensionFit:
    """Fit one dimension; local slopes of the samples enter where they pad inside the program, no Lipschitz constant.

    Raises:
        UserError: for settings that do not fit the samples.
    """
    form = BlockFit if isinstance(settings.basis, Blocks) else LinearFit
    return form.of(samples, settings)


def fit_from_json(data: Mapping[str, Any]) -> DimensionFit:
    """A fit from what its `to_json` gave; KeyError, TypeError or ValueError for anything else."""
    return FITS[data["kind"]].from_json(data)


@dataclass(frozen=True, eq=False)
class DimensionReport(JsonRecord):
    """Bound, slopes and programs of one dimension.

    Attributes:
        largest_sampled_gap: largest |d|. sup_size, sup_width: see `GapSuprema`; the first over the largest sample.
        mean_size, mean_width: means of max(|lo|, |hi|) and of hi - lo over X x U, see `_means`.
        lipschitz, lipschitz_estimates: of its Lipschitz constant.
        scenario: fitted sides by name (`upper` and `lower`, or `both`), empty for bounds without a program.
    """

    state: str
    largest_sampled_gap: float
    sup_size: float
    sup_width: float
    sup_over_largest_sample: float
    mean_size: float
    mean_width: float
    lipschitz: GridLipschitz
    lipschitz_estimates: tuple[LipschitzRow, ...]
    scenario: Sides = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class GapResult:
    """A fitted gap function with its reports, one for each dimension."""

    function: GapFunction
    dimensions: tuple[DimensionReport, ...]
    samples: int

    def to_json(self) -> dict[str, Any]:
        """The content of gap.json."""
        return {
            **self.function.to_json(),
            "samples": self.samples,
            "dimensions": [d.to_json() for d in self.dimensions],
        }


def assemble(
    where: SampleGrid, settings: GapSection, fits: Sequence[DimensionFit], lipschitz: Sequence[DimensionLipschitz],
    deviation: Floats | None = None,
) -> GapResult:  # fmt: skip
    """The gap function of all dimensions, padded.

    `deviation`, (nx,), is added on both sides: by how much a declared symmetry does not hold, and its staircase.

    Raises:
        UserError: fits of different kinds.
        BrokenPromise: when the grid does not resolve the gap or a residual.
    """
    if len({type(fit) for fit in fits}) != 1:
        raise UserError("the fits of the dimensions are of different kinds", remedy="Run the scp stage again.")
    check_resolved(where, settings, lipschitz)
    given = BoundInputs(where, settings, lipschitz)
    function, sides = type(fits[0]).bound(fits, given)
    if deviation is not None:
        function = function.raised(deviation, deviation)
    return GapResult(function, _reports(where, settings, function, lipschitz, sides), where.size)


def check_resolved(where: SampleGrid, settings: GapSection, lipschitz: Sequence[DimensionLipschitz]) -> None:
    """Refuse where the grid does not resolve the gap and the padding has no local jump bound for it.

    Raises:
        BrokenPromise: naming the state.
    """
    local = settings.padding == "inflate"
    for name, known in zip(where.states, lipschitz, strict=True):
        found = known.grid
        if local and found.rough_share <= settings.lipschitz.rough_limit:
            continue
        if local or not found.resolved:
            raise BrokenPromise(
                f"the gap of {name} is not Lipschitz at this grid: L(h/2)/L(h) = {found.ratio.max():.2f} > {GATE}, "
                f"{100 * found.rough_share:.2g} % of the cells are rough; "
                f"{found.place(where.states)}",
                remedy(where, settings, found, found.rough_share),
            )


def _reports(
    where: SampleGrid, settings: GapSection, function: GapFunction, lipschitz: Sequence[DimensionLipschitz],
    sides: Sequence[Sides],
) -> tuple[DimensionReport, ...]:  # fmt: skip
    suprema = function.sup()
    size, width = _means(where, function, settings.seed)
    reports = []
    for i, (state, known) in enumerate(zip(where.states, lipschitz, strict=True)):
        sup, largest, means = suprema[state], known.largest, (float(size[i]), float(width[i]))
        ratio = sup.size / largest if largest > 0.0 else float("inf")
        bound = state, largest, sup.size, sup.width, ratio, *means
        reports.append(DimensionReport(*bound, known.grid, known.estimates, sides[i]))
    return tuple(reports)


def _means(where: SampleGrid, function: GapFunction, seed: int, chunk: int = 200_000) -> tuple[Floats, Floats]:
    """(nx,), (nx,) means of max(|lo|, |hi|) and hi - lo over X x U: one random point of each cell for each input."""
    x, m, rng = where.grid.centres(), len(where.inputs), np.random.default_rng([seed, 1])
    size, width = np.zeros(len(where.states)), np.zeros(len(where.states))
    step = max(1, chunk // m)
    for a in range(0, len(x), step):
        part = np.repeat(x[a : a + step], m, axis=0)
        part += where.grid.h * rng.uniform(-1.0, 1.0, part.shape)
        lo, hi = function.bounds(part, np.tile(where.inputs, (len(part) // m, 1)))
        size += np.maximum(np.abs(lo), np.abs(hi)).sum(axis=0)
        width += (hi - lo).sum(axis=0)
    return size / (len(x) * m), width / (len(x) * m)
