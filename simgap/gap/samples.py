"""Samples of the gap on a grid of states times a finite set of inputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simgap.errors import UserError
from simgap.gap.function import GapDomain
from simgap.geometry import Floats, Grid


@dataclass(frozen=True, eq=False)
class GapSamples:
    """The signed gap d = simulator - nominal at the cell centres of `grid` for every input.

    Attributes:
        grid: N cells that tile X; inputs: (M, nu); states, input_names: names in order.
        d: (N, M, nx). d_upper: the same shape where hidden states of the simulator spread the gap
            (then [d, d_upper] is its range), else None.
        free: state axes on which the gap does not depend by a declared symmetry.

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

    def __post_init__(self) -> None:
        shape = (self.grid.size, len(self.inputs), self.grid.box.size)
        for name, values in (("d", self.d), ("d_upper", self.d_upper)):
            if values is not None and values.shape != shape:
                raise UserError(f"the gap samples {name} have shape {values.shape}, not {shape}")
            if values is not None and not np.isfinite(values).all():
                raise UserError(
                    f"{int((~np.isfinite(values)).sum())} gap samples are not finite",
                    remedy="A roll-out diverged: lower tau or add sub-steps.",
                )

    @property
    def domain(self) -> GapDomain:
        """X and U with their names."""
        return GapDomain(self.states, self.input_names, self.grid.box, self.inputs, self.free)

    @cached_property
    def rounding(self) -> Floats:
        """(nx,) size of differences that may be rounding alone: the gap is a difference of numbers of the size of X."""
        return 64.0 * 2.0**-52 * (np.maximum(np.abs(self.grid.box.lo), np.abs(self.grid.box.hi)))

    def side(self, i: int, upper: bool) -> Floats:
        """(N, M) what one side has to cover in dimension i: d for `hi`, -d for `-lo`."""
        values = self.d if self.d_upper is None or not upper else self.d_upper
        return np.ascontiguousarray(values[:, :, i] if upper else -values[:, :, i])
