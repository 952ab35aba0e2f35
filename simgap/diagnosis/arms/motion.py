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
from simgap.model.symbolic import Coordinate

_OF_THE_RATE = 0.2  # the cut is at most this share of the sampling rate, so that central differences are derivatives
_STILL = 1e-2  # a trace whose joints never exceed this speed, rad/s or m/s, is at rest: what moves is noise


@dataclass(frozen=True, eq=False)
class Motion:
    """One trace on an even grid.

    Attributes:
        trace: its name.
        t: (N,) s; q, v, a, torque: (N, n) smooth.
        used: (N,) rows away from the ends, where the filter sees both sides, thinned to what the cut leaves.
        low_pass: the filter.
    """

    trace: str
    t: Floats
    q: Floats
    v: Floats
    a: Floats
    torque: Floats
    used: np.ndarray
    low_pass: Filter


@dataclass(frozen=True, eq=False)
class Filter:
    """A Butterworth low pass of fourth order, forwards and backwards along axis 0, at `cut` Hz of `rate` Hz."""

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


def motions(record: Record, ends: Sequence[Coordinate], torques: Sequence[str]) -> tuple[Motion, ...]:
    """Every trace, with one low pass for all: its cut is `BAND` times the frequency below which the motion lies.

    Args:
        ends: the coordinate of each joint; torques: the input of each.

    Raises:
        UserError: a position that was not measured; nothing moves.
    """
    for c in ends:
        if c.position not in record.measured:
            raise UserError(
                f"the position '{c.position}' is not measured", remedy="An arm's diagnosis needs every position."
            )
    rate = 1.0 / float(np.median(np.concatenate([np.diff(t.t) for t in record.traces])))
    raw = [_even(record, trace, ends, torques, rate) for trace in record.traces]
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


def _even(
    record: Record, trace: Trace, ends: Sequence[Coordinate], torques: Sequence[str], rate: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Stamps, positions, velocities and torques; a velocity that was not measured is the derivative of the position."""
    t = np.arange(trace.t[0], trace.t[-1], 1.0 / rate)
    columns = zip((*record.measured, *record.inputs), (*trace.y.T, *trace.u.T), strict=True)
    grid = {name: np.interp(t, trace.t, column) for name, column in columns}
    q, u = (np.stack([grid[n] for n in names], axis=1) for names in ([c.position for c in ends], torques))
    slopes = np.gradient(q, 1.0 / rate, axis=0)
    return t, q, np.stack([grid.get(c.velocity, slopes[:, j]) for j, c in enumerate(ends)], axis=1), u


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
