"""From samples to a bound in one call, where nothing is kept between the steps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from simgap.arrays import Floats
from simgap.config.gap import GapSection
from simgap.gap.bounds.enclosures import ClosedFormGap
from simgap.gap.checked_bound import GapResult, assemble, check_resolved
from simgap.gap.fitting.dimension_fit import fit_dimension
from simgap.gap.lipschitz.estimates import dimension_lipschitz
from simgap.gap.sampling.borders import Directed
from simgap.gap.sampling.samples import DimensionSamples, SampleGrid
from simgap.gap.sampling.values import check_numbers, values
from simgap.geometry import Grid


@dataclass(frozen=True, eq=False)
class GapSamples:
    """The signed gap d = simulator - nominal at the cell centres of `grid` for every input.

    Attributes:
        grid, inputs, states, input_names, free, periodic: see `SampleGrid`.
        d: (N, M, nx). d_upper: the same shape where hidden states of the simulator spread the gap
            (then [d, d_upper] is its range), else None. known: see `SampleGrid`.
        directed: for each dimension, samples beside those of the grid; none if empty.

    Raises:
        UserError: for shapes that do not fit or values that are not finite.
    """

    grid: Grid
    inputs: Floats
    d: Floats
    states: tuple[str, ...]
    input_names: tuple[str, ...]
    d_upper: Floats | None = None
    free: tuple[int, ...] = ()
    periodic: tuple[int, ...] = ()
    directed: tuple[Directed, ...] = ()
    known: ClosedFormGap | None = None

    def __post_init__(self) -> None:
        shape = (self.grid.size, len(self.inputs), self.grid.box.size)
        check_numbers(shape, {"d": self.d, "d_upper": self.d_upper})

    @cached_property
    def where(self) -> SampleGrid:
        """The samples without their values."""
        names = self.states, self.input_names
        return SampleGrid(self.grid, self.inputs, *names, self.free, self.periodic, self.known)

    def dimension(self, i: int) -> DimensionSamples:
        """The samples of one dimension."""
        upper = None if self.d_upper is None else values(self.d_upper[:, :, i])
        beside = self.directed[i] if self.directed else None
        return DimensionSamples(self.where, i, values(self.d[:, :, i]), upper, beside)


def fit_gap(samples: GapSamples, settings: GapSection) -> GapResult:
    """Fit the bound that the settings ask for.

    Raises:
        UserError: for settings that do not fit the samples.
        BrokenPromise: when the grid does not resolve the gap, so that no Lipschitz constant can be trusted.
    """
    parts = [samples.dimension(i) for i in range(len(samples.states))]
    lipschitz = [dimension_lipschitz(part, settings) for part in parts]
    check_resolved(samples.where, settings, lipschitz)
    fits = [fit_dimension(p, settings) for p in parts]
    return assemble(samples.where, settings, fits, lipschitz)
