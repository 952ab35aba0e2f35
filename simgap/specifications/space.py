"""The states of a case as a specification sees them: names, units, the box X, what wraps around, what drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.notation import pretty_unit


@dataclass(frozen=True, eq=False)
class Space:
    """States in order.

    Attributes:
        states: names, nx of them; units: by name, none where they do not matter.
        box: the state box X.
        periodic: axes that wrap around at the ends of X.
        pose: axes of x, y and heading of a body with a round footprint that drives on a floor; None for other plants.
    """

    states: tuple[str, ...]
    box: Box
    periodic: tuple[int, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    pose: tuple[int, int, int] | None = None

    @staticmethod
    def of(case: Case) -> Space:
        """The states of a case.

        Raises:
            UserError: a case without a domain.
        """
        if case.domain is None:
            raise UserError("a specification needs the section", key="domain", remedy="Add `domain:`.")
        states = tuple(case.plant.states)
        ends = [case.domain.X[name] for name in states]
        wheels = case.plant.symbolic.wheels if case.plant.symbolic is not None else None
        pose = (states.index(wheels.x), states.index(wheels.y), states.index(wheels.heading)) if wheels else None
        return Space(
            states=states,
            box=Box([lo for lo, _ in ends], [hi for _, hi in ends]),
            periodic=tuple(states.index(name) for name in case.domain.periodic),
            units={name: state.unit for name, state in case.plant.states.items()},
            pose=pose,
        )

    @property
    def size(self) -> int:
        """Number of states nx."""
        return len(self.states)

    def wrapping(self, region: Box) -> tuple[int, ...]:
        """Periodic axes along which a region takes the whole period; along others it ends like any interval."""
        return tuple(j for j in self.periodic if region.lo[j] == self.box.lo[j] and region.hi[j] == self.box.hi[j])

    def grid(self, region: Box, cells: Sequence[int]) -> Grid:
        """Cells that tile a region."""
        return Grid(region, cells, self.wrapping(region))

    def wrapped(self, x: Floats) -> Floats:
        """Periodic states brought into X: (..., nx) -> (..., nx)."""
        return x - self._turns(x) if self.periodic else x

    def unwound(self, x: Floats, following: Floats) -> tuple[Floats, Floats]:
        """States with the periodic ones brought into X, successors moved by the same whole turns: (k, nx) twice."""
        if not self.periodic:
            return x, following
        turns = self._turns(x)
        return x - turns, following - turns

    def _turns(self, x: Floats) -> Floats:
        turns = np.zeros_like(x)
        for j in self.periodic:
            period = self.box.hi[j] - self.box.lo[j]
            turns[..., j] = np.floor((x[..., j] - self.box.lo[j]) / period) * period
        return turns

    def vector(self, named: Mapping[str, float]) -> Floats:
        """Numbers by state as an array (nx,), 0 for states that are not named."""
        return np.array([float(named.get(name, 0.0)) for name in self.states])

    def quantity(self, name: str, value: float) -> str:
        """A number with the unit of a state."""
        return f"{value:g} {pretty_unit(self.units.get(name, ''))}".strip()

    def interval(self, name: str, ends: tuple[float, float]) -> str:
        """'x in [0, 1] m'."""
        return f"{name} in [{ends[0]:g}, {ends[1]:g}] {pretty_unit(self.units.get(name, ''))}".strip()
