"""Measured data as the numerical core of diagnosis sees them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.errors import UserError

MIN_SAMPLES = 8
"""Fewer samples make no piece of a trace and no window: the noise estimate alone takes seven."""


@dataclass(frozen=True, eq=False)
class Trace:
    """One uninterrupted stretch of samples.

    Attributes:
        name: what messages call it.
        t: (n,) true time stamps in s, strictly increasing; they may jitter and start anywhere.
        y: (n, k) measured states, columns as in `Record.measured`.
        u: (n, m) recorded inputs, columns as in `Record.inputs`; each row holds from its stamp until the next.
        used: (n, k) which readings are measurements; None: all. Others were bridged, and nothing is compared with them.
        told: (n,) whether what was commanded from the row on is known; None: always. No window holds others.
    """

    name: str
    t: Floats
    y: Floats
    u: Floats
    used: Bools | None = None
    told: Bools | None = None

    @property
    def compared(self) -> Floats:
        """(n, k) 1 for readings that are measurements, 0 for others."""
        return np.ones_like(self.y) if self.used is None else self.used.astype(np.float64)

    def __post_init__(self) -> None:
        if (self.t.ndim, self.y.ndim, self.u.ndim) != (1, 2, 2) or not len(self.t) == len(self.y) == len(self.u):
            raise UserError(f"trace '{self.name}' has times, states and inputs of different lengths")
        if not (np.all(np.isfinite(self.t)) and np.all(np.isfinite(self.y)) and np.all(np.isfinite(self.u))):
            raise UserError(f"trace '{self.name}' holds a number that is not finite", remedy="Drop or fill such rows.")
        if np.any(np.diff(self.t) <= 0):
            raise UserError(f"time stands still or runs backwards in trace '{self.name}'", remedy="Sort or split it.")

    def part(self, which: Bools) -> Trace:
        """Some of its rows, (n,)."""
        used, told = (None if mask is None else mask[which] for mask in (self.used, self.told))
        return Trace(self.name, self.t[which], self.y[which], self.u[which], used, told)

    def showing(self, k: int, reading: Floats) -> Trace:
        """The same with other readings of channel k, (n,)."""
        y = self.y.copy()
        y[:, k] = reading
        return replace(self, y=y)

    @property
    def duration(self) -> float:
        """Seconds from the first stamp to the last."""
        return float(self.t[-1] - self.t[0]) if len(self.t) else 0.0


@dataclass(frozen=True)
class Record:
    """Traces of one plant, all in the units of the case.

    Attributes:
        traces: the stretches of data.
        measured: state names of the columns of `Trace.y`.
        inputs: input names of the columns of `Trace.u`, in the order of the model.
    """

    traces: tuple[Trace, ...]
    measured: tuple[str, ...]
    inputs: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Samples of all traces together."""
        return sum(len(trace.t) for trace in self.traces)

    @property
    def interval(self) -> float:
        """Median interval of the stamps, s."""
        return float(np.median(np.concatenate([np.diff(trace.t) for trace in self.traces])))

    def with_columns(self, y: Sequence[int], u: Sequence[int], y_factor: Floats, u_factor: Floats) -> Record:
        """The same with readings and inputs from other columns of its own, in this order, times factors (k,), (m,)."""

        def true(trace: Trace) -> Trace:
            used = None if trace.used is None else trace.used[:, y]
            own = (np.ascontiguousarray(trace.y[:, y] * y_factor), np.ascontiguousarray(trace.u[:, u] * u_factor))
            return replace(trace, y=own[0], u=own[1], used=used)

        return replace(self, traces=tuple(map(true, self.traces)))


def exchanged(order: Iterable[int], i: int, j: int) -> tuple[int, ...]:
    """The same order with two places exchanged."""
    return tuple(j if k == i else i if k == j else k for k in order)


def runs(flags: Bools) -> list[tuple[int, int]]:
    """Runs of True as half-open index ranges."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
