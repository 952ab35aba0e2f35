"""What effects with a state of their own remember of the motion before a window.

Their rates vanish at rest and are affine in the state, so that measured positions tell it: smoothed (a local
polynomial, Savitzky, Golay (1964), Analytical Chemistry 36(8)), as noise would be motion back and forth, and followed
from the beginning of each trace. What it was there is unknown, taken as 0, and forgotten after a few reversals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.late import njit
from simgap.model.symbolic import Coordinate
from simgap.signals import savgol_filter

if TYPE_CHECKING:
    from simgap.diagnosis.simulation.supermodel import SuperModel

_SPAN_S, _ORDER = 0.15, 4
"""Length and order of the local polynomial. Of an arm that turns round often under Dahl friction (200 Hz, 1e-3 rad) the
windows that confirm had chi^2/dof 1.15 at 0.055 s, 1.20 at 0.075, 1.08 at 0.155 and 1.11 at 0.205 s."""
_LINK_S = 0.1  # length of it for a link with a motor behind it, which it must follow through a resonance. Judgement
_FEWEST, _MOST = 7, 61  # samples of it


def _traces(t: Floats, firsts: Ints, span: float) -> Iterator[tuple[int, int, float, int]]:
    """Of each trace with two stamps at least: from, to, interval (s), samples of a local polynomial over a span (s)."""
    for a, b in zip(firsts.tolist(), [*firsts[1:].tolist(), len(t)], strict=True):
        if b - a > 1:
            dt = max(float(np.median(np.diff(t[a:b]))), 1e-9)
            yield a, b, dt, min(max(2 * (round(span / dt) // 2) + 1, _FEWEST), _MOST, b - a - 1 + (b - a) % 2)  # odd


def measured_speeds(on: Sequence[Coordinate], measured: Sequence[str], t: Floats, y: Floats, firsts: Ints) -> Floats:
    """Mean speed from each stamp to the next of some coordinates, (n, h); 0 where nothing was measured of one."""
    out = np.zeros((len(t), len(on)))
    for j, c in enumerate(on):
        for a, b, _, size in _traces(t, firsts, _SPAN_S):
            if c.position in measured and size > 3:
                q = savgol_filter(y[a:b, measured.index(c.position)], size, min(_ORDER, size - 1))
                out[a : b - 1, j] = np.diff(q) / np.maximum(np.diff(t[a:b]), 1e-9)
            elif c.velocity in measured:
                out[a:b, j] = y[a:b, measured.index(c.velocity)]
    return out


def measured_link(
    on: Coordinate, measured: Sequence[str], t: Floats, y: Floats, firsts: Ints
) -> tuple[Floats, Floats]:  # fmt: skip
    """Place and speed of a coordinate at every stamp, smoothed, (n,) each; a place that nothing measures adds up."""
    place, speed = np.zeros(len(t)), np.zeros(len(t))
    for a, b, dt, size in _traces(t, firsts, _LINK_S):
        if on.position in measured and size > _ORDER:
            q = y[a:b, measured.index(on.position)]
            place[a:b] = savgol_filter(q, size, _ORDER)
            speed[a:b] = savgol_filter(q, size, _ORDER, deriv=1, delta=dt)
        if on.velocity in measured:
            v = y[a:b, measured.index(on.velocity)]
            speed[a:b] = savgol_filter(v, size, _ORDER) if size > _ORDER else v
            if on.position not in measured:
                place[a + 1 : b] = np.cumsum(np.diff(t[a:b]) * (speed[a : b - 1] + speed[a + 1 : b]) / 2)
    return place, speed


def memories(model: SuperModel, theta: Floats, t: Floats, speeds: Floats, firsts: Ints) -> Floats:
    """The effects' own states at every stamp: theta (q,), (n, h) -> (n, h), exact for speeds held between stamps."""
    none, one = np.zeros_like(speeds.T), np.ones_like(speeds.T)
    free, loaded = (model.past(z, speeds.T, theta) for z in (none, one))
    out = np.empty_like(speeds)
    for j in range(speeds.shape[1]):
        drive = np.broadcast_to(free[j], t.shape).astype(np.float64)
        fade = drive - np.broadcast_to(loaded[j], t.shape)
        column = np.empty(t.size)
        _followed(t, np.ascontiguousarray(drive), np.ascontiguousarray(fade), firsts, column)
        out[:, j] = column
    return out


@njit("void(float64[::1], float64[::1], float64[::1], int64[::1], float64[::1])", cache=True)
def _followed(t: Floats, drive: Floats, fade: Floats, firsts: Ints, out: Floats) -> None:
    """Solve z' = drive - fade z from 0 at the first stamp of each trace, exactly between stamps."""
    trace = 0
    for k in range(t.size):
        if trace < firsts.size and k == firsts[trace]:
            trace += 1
            out[k] = 0.0
            continue
        h, a, b = t[k] - t[k - 1], drive[k - 1], fade[k - 1]
        if abs(b * h) < 1e-9:
            out[k] = out[k - 1] + a * h
        else:
            out[k] = a / b + (out[k - 1] - a / b) * np.exp(-b * h)
