"""How far a velocity channel trails the position it belongs to, and whether the two agree in scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.reading.record import Record, Trace


@dataclass(frozen=True)
class VelocityLag:
    """A velocity channel against the derivative of its position.

    Attributes:
        position, velocity: the two states.
        lag_s: by how much the velocity trails (s); negative: it leads.
        scale: velocity channel over derivative of the position; 1 when their units agree.
        mismatch: RMS of what lag and scale leave, over the RMS of the velocity.
    """

    position: str
    velocity: str
    lag_s: float
    scale: float
    mismatch: float


def velocity_lag(record: Record, position: str, velocity: str, reach_s: float = 0.1) -> VelocityLag | None:
    """Lag and scale between two channels, by least squares over shifts up to `reach_s`; None where nothing moves.

    Both sides are averaged over the same +-m samples, so that noise is tamed and no phase is added: the mean of v over
    [t - m dt, t + m dt] is compared with (q(t + m dt) - q(t - m dt)) / (2 m dt). Source: difference quotient and
    cross-correlation, as in Ljung (1999), System Identification, sec. 6.1; the optimum is refined by a parabola.
    """
    j, k = record.measured.index(position), record.measured.index(velocity)
    dt = float(np.median(np.concatenate([np.diff(trace.t) for trace in record.traces])))
    m, reach = max(1, round(0.01 / dt)), max(2, round(reach_s / dt))
    sums = np.zeros((2 * reach + 1, 3))  # for each shift: v.d, d.d, v.v
    for trace in record.traces:
        sums += _shifted_products(trace, j, k, dt, m, reach)
    cross, power, own = sums.T
    if np.min(power) <= 0.0 or np.min(own) <= 0.0:
        return None
    loss = 1.0 - cross**2 / (power * own)
    best = int(np.argmin(loss))
    shift = float(best - reach)
    if 0 < best < 2 * reach:
        left, mid, right = loss[best - 1 : best + 2]
        bend = left - 2 * mid + right
        shift += 0.5 * float((left - right) / bend) if bend > 0 else 0.0
    scale = float(cross[best] / power[best])
    return VelocityLag(position, velocity, shift * dt, scale, float(np.sqrt(max(loss[best], 0.0))))


def _shifted_products(trace: Trace, j: int, k: int, dt: float, m: int, reach: int) -> Floats:
    """Inner products of the averaged velocity with the derivative of the position at every shift, (2 reach + 1, 3)."""
    even = np.arange(trace.t[0], trace.t[-1], dt)
    if even.size < 4 * (reach + m):
        return np.zeros((2 * reach + 1, 3))
    q, v = (np.interp(even, trace.t, trace.y[:, c]) for c in (j, k))
    slope = (q[2 * m :] - q[: -2 * m]) / (2 * m * dt)
    running = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]))])
    mean = (running[2 * m :] - running[: -2 * m]) / (2 * m)
    inner = slope[reach:-reach]
    out = np.empty((2 * reach + 1, 3))
    for s in range(2 * reach + 1):
        moved = mean[s : s + inner.size]
        out[s] = moved @ inner, inner @ inner, moved @ moved
    return out
