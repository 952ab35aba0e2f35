"""From traces of an arm to smooth motion and torques on an even grid: positions, velocities, accelerations, torques.

A zero-phase low pass is applied to everything alike, so that no side of the equations is late (Gautier (1997), IEEE
ICRA, "Dynamic identification of robots with power model": parallel filtering; Butterworth forwards and backwards).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.thresholds import AT_REST, BAND, SELDOM
from simgap.errors import UserError

_OF_THE_RATE = 0.2  # the cut is at most this share of the sampling rate, so that central differences are derivatives
_STILL = 1e-2  # a trace whose joints never exceed this speed, rad/s or m/s, is at rest: what moves is noise


@dataclass(frozen=True)
class Columns:
    """Where a record has each joint's position and velocity among `measured`, and its torque among `inputs`.

    A velocity that was not measured is None: it is the derivative of the position.
    """

    position: tuple[int, ...]
    velocity: tuple[int | None, ...]
    torque: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Motion:
    """One trace on an even grid.

    Attributes:
        trace: its name.
        t: (N,) s; q, v, a, torque: (N, n) smooth.
        used: (N,) rows away from the ends, where the filter sees both sides, thinned to what the cut leaves.
        smooth: the filter, along axis 0.
    """

    trace: str
    t: Floats
    q: Floats
    v: Floats
    a: Floats
    torque: Floats
    used: np.ndarray
    low_pass: Filter

    def smooth(self, x: Floats) -> Floats:
        """The same low pass on something else of this trace, (N, ...)."""
        return self.low_pass(x)


@dataclass(frozen=True, eq=False)
class Filter:
    """A Butterworth low pass of fourth order, forwards and backwards, at `cut` Hz of samples at `rate` Hz."""

    cut: float
    rate: float

    def __call__(self, x: Floats) -> Floats:
        """(N, ...) -> (N, ...)."""
        from scipy.signal import butter, sosfiltfilt

        sections = butter(4, self.cut / (0.5 * self.rate), output="sos")
        reach = min(len(x) - 1, int(3 * self.rate / self.cut))
        return np.ascontiguousarray(sosfiltfilt(sections, x, axis=0, padlen=reach))

    @property
    def noise_gain(self) -> float:
        """Standard deviation of white noise behind it, as a share of that before it."""
        pulse = np.zeros(int(20 * self.rate / self.cut) | 1)
        pulse[len(pulse) // 2] = 1.0
        return float(np.linalg.norm(self(pulse)))


def columns_of(positions: Sequence[str], velocities: Sequence[str], torques: Sequence[str], record: Record) -> Columns:
    """The columns of the joints' positions, velocities and torques.

    Raises:
        UserError: a position that was not measured.
    """
    for name in positions:
        if name not in record.measured:
            raise UserError(f"the position '{name}' is not measured", remedy="An arm's diagnosis needs every position.")
    measured = list(record.measured)
    return Columns(
        tuple(measured.index(n) for n in positions),
        tuple(measured.index(n) if n in measured else None for n in velocities),
        tuple(record.inputs.index(n) for n in torques),
    )


def motions(record: Record, where: Columns) -> tuple[Motion, ...]:
    """Every trace, with one low pass for all: its cut is `BAND` times the frequency below which the motion lies.

    Raises:
        UserError: nothing moves.
    """
    rate = 1.0 / float(np.median(np.concatenate([np.diff(t.t) for t in record.traces])))
    raw = [_even(trace, where, rate) for trace in record.traces]
    band = max(_band(v, rate) for _, _, v, _ in raw)
    if not band > 0.0:
        raise UserError(
            f"no joint moves in any recording (faster than {_STILL:g} rad/s or m/s)", key="measured.files",
            remedy="Name recordings in which the arm moves: at rest dry friction balances any force.",
        )  # fmt: skip
    cut = min(BAND * band, _OF_THE_RATE * rate)
    low_pass = Filter(cut, rate)
    return tuple(_smooth(trace.name, raw_trace, low_pass) for trace, raw_trace in zip(record.traces, raw, strict=True))


def rest_speeds(every: Sequence[Motion]) -> Floats:
    """(n,) speed below which a joint counts as at rest: dry friction is then any force up to its size."""
    fastest = np.max([np.abs(m.v).max(axis=0) for m in every], axis=0)
    return np.maximum(AT_REST * fastest, 1e-9)


def _even(trace: Trace, where: Columns, rate: float) -> tuple[Floats, Floats, Floats, Floats]:
    t = np.arange(trace.t[0], trace.t[-1], 1.0 / rate)

    def on_grid(block: Floats, k: int) -> Floats:
        return np.interp(t, trace.t, block[:, k])

    q = np.stack([on_grid(trace.y, k) for k in where.position], axis=1)
    slopes = np.gradient(q, 1.0 / rate, axis=0)
    v = np.stack([slopes[:, j] if k is None else on_grid(trace.y, k) for j, k in enumerate(where.velocity)], axis=1)
    return t, q, v, np.stack([on_grid(trace.u, k) for k in where.torque], axis=1)


def _band(v: Floats, rate: float) -> float:
    """Frequency, Hz, below which all but `SELDOM` of the velocities' energy lies."""
    taper = np.hanning(len(v))[:, None]  # the ends of a trace are no jumps
    power = np.square(np.abs(np.fft.rfft(taper * (v - v.mean(axis=0)), axis=0))).sum(axis=1)
    if not power.sum() > 0.0 or np.abs(v).max() < _STILL:  # at rest: what moves is noise
        return 0.0
    share = np.cumsum(power) / power.sum()
    return float(np.fft.rfftfreq(len(v), 1.0 / rate)[np.searchsorted(share, 1.0 - SELDOM)])


def _smooth(name: str, raw: tuple[Floats, Floats, Floats, Floats], low_pass: Filter) -> Motion:
    t, q, v, u = raw
    v = low_pass(v)
    rows = np.zeros(len(t), dtype=bool)
    edge = int(low_pass.rate / low_pass.cut)
    every = max(1, int(low_pass.rate / (2.5 * low_pass.cut)))
    rows[edge : len(t) - edge : every] = True
    a = np.gradient(v, 1.0 / low_pass.rate, axis=0)
    return Motion(name, t, low_pass(q), v, a, low_pass(u), rows, low_pass)
