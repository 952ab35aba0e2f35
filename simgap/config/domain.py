"""The `domain` section: sampling time, state box X and finite input set U."""

from __future__ import annotations

import itertools

import numpy as np
from pydantic import Field, model_validator

from simgap.arrays import Floats
from simgap.config.base import Interval, Seconds, Section

MOST_VALUES = 2.0**53
"""Most values of one input: beyond it doubles do not count by ones."""


class InputSet(Section):
    """The values that one input may take: `values`, or all of min, min + step, ..., max."""

    min: float | None = None
    """Smallest value."""
    max: float | None = None
    """Largest value."""
    step: float | None = Field(None, gt=0)
    """Distance between neighbours."""
    values: tuple[float, ...] | None = None
    """The values one by one, instead of a range."""

    @model_validator(mode="after")
    def _not_empty(self) -> InputSet:
        if self.values is not None:
            if not (self.min is None and self.max is None and self.step is None):
                raise ValueError("an input set has either values, or min, max and step")
            if len(self.values) == 0:
                raise ValueError("U is empty: list at least one value")
            return self
        if self.min is None or self.max is None or self.step is None:
            raise ValueError("an input set needs values, or min, max and step")
        if self.max < self.min:
            raise ValueError(f"U is empty: max {self.max} is below min {self.min}")
        if not (self.max - self.min) / self.step < MOST_VALUES:
            raise ValueError(
                f"a step of {self.step} from {self.min} to {self.max} gives more values than can be counted"
            )
        return self

    @property
    def count(self) -> int:
        """Number of values."""
        if self.values is not None:
            return len(self.values)
        low, high, step = (float(v) for v in (self.min, self.max, self.step) if v is not None)
        return int(np.floor((high - low) / step + 1e-9)) + 1

    def list(self) -> Floats:
        """The values in ascending order, (n,); decimal steps give the decimals a person would write."""
        if self.values is not None:
            return np.array(sorted(self.values))
        assert self.min is not None
        assert self.step is not None
        return np.round(self.min + self.step * np.arange(self.count), 12)


class DomainSection(Section):
    """Region in which the model is compared with the simulator and the controller works."""

    tau: Seconds = Field(gt=0)
    """Sampling time, in seconds or with a unit ('5 ms')."""
    X: dict[str, Interval]
    """For each state its lower and upper end, in its unit; angles in rad, not degrees."""
    U: dict[str, InputSet] = Field({})
    """For each input the values that it may take."""
    periodic: tuple[str, ...] = ()
    """States that wrap around at the ends of X, such as a heading; X is one turn."""

    @model_validator(mode="after")
    def _periodic_states(self) -> DomainSection:
        unknown = [name for name in self.periodic if name not in self.X]
        if unknown:
            raise ValueError(f"periodic names {unknown}, which are not states of X")
        return self

    def inputs(self, order: list[str]) -> Floats:
        """All of U as rows (M, nu), the last input running fastest."""
        return np.array(list(itertools.product(*(self.U[name].list() for name in order))), dtype=np.float64)
