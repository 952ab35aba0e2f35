"""Samples of the gap on a grid of states times a finite set of inputs, all dimensions or one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.gap.bounds.closed_form import CellRanges, ClosedFormGap
from simgap.gap.bounds.function import GapDomain
from simgap.gap.sampling.borders import Borders
from simgap.gap.sampling.values import Combined, Held, Room, Values, values
from simgap.geometry import Grid


@dataclass(frozen=True, eq=False)
class SampleGrid:
    """The places of the samples: the cell centres of `grid`, for every input.

    Attributes:
        grid: N cells that tile X; inputs: (M, nu); states, input_names: names in order.
        free: state axes on which the gap does not depend by a declared symmetry.
        periodic: state axes along which it repeats itself with the width of X.
        known: the gap as expressions where the simulator is known in closed form; None for a black box.
    """

    grid: Grid
    inputs: Floats
    states: tuple[str, ...]
    input_names: tuple[str, ...]
    free: tuple[int, ...] = ()
    periodic: tuple[int, ...] = ()
    known: ClosedFormGap | None = None

    @property
    def domain(self) -> GapDomain:
        """X and U with their names."""
        return GapDomain(self.states, self.input_names, self.grid.box, self.inputs, self.free, self.periodic)

    @property
    def size(self) -> int:
        """Number of samples, N M."""
        return self.grid.size * len(self.inputs)

    @cached_property
    def rounding(self) -> Floats:
        """(nx,) size of differences that may be rounding alone: the gap is a difference of numbers of the size of X.

        A sixteenth of it is added to a bound; where the gap is known that is a bound of its rounding, twice over.
        """
        box = self.grid.box
        usual = 64.0 * 2.0**-52 * (np.maximum(np.abs(box.lo), np.abs(box.hi)))
        if self.known is None:
            return usual
        proven = [self.known.rounding(i, box.lo, box.hi, self.inputs) for i in range(len(usual))]
        return np.maximum(usual, 32.0 * np.array(proven))

    @cached_property
    def moving_half_widths(self) -> Floats:
        """(nx,) half-widths of a cell, 0 along the free axes."""
        return np.where(np.isin(np.arange(len(self.grid.cells)), self.free), 0.0, self.grid.h)


@dataclass(frozen=True, eq=False)
class Directed:
    """The gap of one dimension on borders of X and beside switching surfaces, where cell centres never lie.

    Attributes:
        at: where they lie, E states.
        lower, upper: (E, M), ends of the gap; equal where nothing spreads it.

    Raises:
        UserError: for shapes that do not fit or values that are not finite.
    """

    at: Borders
    lower: Floats
    upper: Floats

    @property
    def x(self) -> Floats:
        """(E, nx) states."""
        return self.at.x

    def __post_init__(self) -> None:
        _check((len(self.x), self.lower.shape[-1]), {"on borders": self.lower, "on borders, upper": self.upper})

    def side(self, upper: bool) -> Floats:
        """(E, M) what one side has to cover: the upper end for `hi`, minus the lower one for `-lo`."""
        return self.upper if upper else -self.lower


@dataclass(frozen=True, eq=False)
class DimensionSamples:
    """The signed gap of one dimension: d (N, M), and d_upper where hidden states of the simulator spread it.

    `directed` are samples beside those of the grid; `room` is where more numbers of their kind are kept.

    Raises:
        UserError: for shapes that do not fit or values that are not finite.
    """

    where: SampleGrid
    i: int
    d: Values
    d_upper: Values | None = None
    directed: Directed | None = None
    room: Room = Held.room

    def __post_init__(self) -> None:
        shape = self.where.grid.size, len(self.where.inputs)
        for own in self.ends:
            if own.shape != shape:
                raise UserError(f"the gap samples have shape {own.shape}, not {shape}")
            for block in own.blocks():
                part = own.rows(*block)
                _check(part.shape, {"d": part})

    @property
    def ends(self) -> tuple[Values, ...]:
        """The gap, (N, M); both ends of its range where it has one."""
        return (self.d,) if self.d_upper is None else (self.d, self.d_upper)

    @property
    def beside(self) -> Directed | None:
        """`directed`, where the fit has to cover them for themselves; enclosures of a known gap cover them already."""
        return self.directed if self.where.known is None else None

    @property
    def floor(self) -> float:
        """Size of differences that may be rounding alone."""
        return float(self.where.rounding[self.i])

    @cached_property
    def ranges(self) -> CellRanges | None:
        """Enclosures of the gap on every cell, held against the samples; None for a black box.

        Raises:
            UserError: a gap that cannot be enclosed.
            BrokenPromise: samples that are not those of the equations.
        """
        if self.where.known is None:
            return None
        if self.where.free or self.d_upper is not None:
            raise UserError(
                "a gap in closed form has neither a declared symmetry nor hidden states", key="simulator",
                remedy="Leave out `symmetry`, or say simulator.slopes: sampled.",
            )  # fmt: skip
        found = self.where.known.ranges(self.i, self.where.grid, self.where.inputs)
        found.check_samples(self.d.whole(), self.where.states[self.i])
        return found

    def side(self, upper: bool) -> Values:
        """(N, M) what one side has to cover: d for `hi`, -d for `-lo`."""
        own = self.d if self.d_upper is None or not upper else self.d_upper
        return own if upper else Combined(np.negative, (own,))

    @cached_property
    def largest(self) -> float:
        """Largest sampled |d|."""
        return max(abs(end) for own in self.ends for end in own.ends())


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
        _check(shape, {"d": self.d, "d_upper": self.d_upper})

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


def _check(shape: tuple[int, ...], given: dict[str, Floats | None]) -> None:
    for name, own in given.items():
        if own is not None and own.shape != shape:
            raise UserError(f"the gap samples {name} have shape {own.shape}, not {shape}")
        if own is not None and not np.isfinite(own).all():
            raise UserError(
                f"{int((~np.isfinite(own)).sum())} gap samples are not finite",
                remedy="A roll-out diverged: lower tau or add sub-steps.",
            )
