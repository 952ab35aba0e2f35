"""What was before a window, as the measured motion tells it: effects with a state of their own, motors behind joints.

The rates of such states vanish at rest and are affine in the state, so that measured positions tell it: smoothed (a
local polynomial, Savitzky, Golay (1964), Analytical Chemistry 36(8)), as noise would be motion back and forth, and
followed from the beginning of each trace. What it was there is unknown, taken as 0, and forgotten after a few
reversals.

Where a motor is at the start of a window follows from the motion and the drive before it. Where the link is read, the
motor is simulated along each trace with it as it was measured (smoothed); what is not known is where it was at the
first sample, taken as where the drive then holds it. Where the motor is read, the torque that it passes on tells where
the link is.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.late import njit
from simgap.model.symbolic import Coordinate
from simgap.signals import savgol_filter

_SPAN_S, _ORDER = 0.15, 4
"""Length and order of the local polynomial. Of an arm that turns round often under Dahl friction (200 Hz, 1e-3 rad) the
windows that confirm had chi^2/dof 1.15 at 0.055 s, 1.20 at 0.075, 1.08 at 0.155 and 1.11 at 0.205 s."""
_LINK_S = 0.1  # length of it for a link with a motor behind it, which it must follow through a resonance. Judgement
_FEWEST, _MOST = 7, 61  # samples of it


def _traces(t: Floats, firsts: Ints, span: float) -> Iterator[tuple[int, int, float, int]]:
    """Of each trace with two stamps at least: from, to, interval (s), samples of a local polynomial over a span (s)."""
    for a, b in zip(firsts.tolist(), [*firsts[1:].tolist(), len(t)], strict=True):
        if b - a > 1:
            dt = float(np.median(np.diff(t[a:b])))
            yield a, b, dt, min(max(2 * (round(span / dt) // 2) + 1, _FEWEST), _MOST, b - a - 1 + (b - a) % 2)  # odd


def measured_speeds(on: Sequence[Coordinate], measured: Sequence[str], t: Floats, y: Floats, firsts: Ints) -> Floats:
    """Mean speed from each stamp to the next of some coordinates, (n, h); 0 where nothing was measured of one."""
    out = np.zeros((len(t), len(on)))
    for j, c in enumerate(on):
        for a, b, _, size in _traces(t, firsts, _SPAN_S):
            if c.position in measured and size > 3:
                q = savgol_filter(y[a:b, measured.index(c.position)], size, min(_ORDER, size - 1))
                out[a : b - 1, j] = np.diff(q) / np.diff(t[a:b])
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


def memories(past: Any, theta: Floats, t: Floats, speeds: Floats, firsts: Ints) -> Floats:
    """The effects' own states at every stamp: theta (q,), (n, h) -> (n, h), exact for speeds held between stamps.

    past: their rates, as in `SuperModel`.
    """
    none, one = np.zeros_like(speeds.T), np.ones_like(speeds.T)
    rates = zip(past(none, speeds.T, theta), past(one, speeds.T, theta), strict=True)
    edges, zero = np.append(firsts, t.size), np.zeros(t.size)
    return np.stack([_followed(t, zero + free, zero + free - loaded, edges) for free, loaded in rates], axis=1)


@njit("float64[::1](float64[::1], float64[::1], float64[::1], int64[::1])", cache=True)
def _followed(t: Floats, drive: Floats, fade: Floats, edges: Ints) -> Floats:
    """Solve z' = drive - fade z from 0 at the first stamp of each trace, exactly between stamps."""
    out = np.zeros(t.size)
    for trace in range(edges.size - 1):
        for k in range(edges[trace] + 1, edges[trace + 1]):
            h, a, b = t[k] - t[k - 1], drive[k - 1], fade[k - 1]
            if abs(b * h) < 1e-9:
                out[k] = out[k - 1] + a * h
            else:
                out[k] = a / b + (out[k - 1] - a / b) * np.exp(-b * h)
    return out


def twists_by_torque(t: Floats, v: Floats, u: Floats, law: Floats, edges: Ints) -> Floats:
    """Twist of a spring and its rate at every stamp, (n, 2), with the motor as measured: from what it passes on.

    That is the drive less what the motor's inertia takes; a place to begin at, from where windows are fitted.

    Args:
        t: (n,) s; v: (n,) the motor's speed, smoothed; u: (n,) the drive, held from each stamp on.
        law: its numbers; edges: first sample of each trace, and their number.
    """
    inertia, k, *_ = law
    out = np.zeros((t.size, 2))
    for a, b in itertools.pairwise(edges.tolist()):
        if b - a > 1 and k > 0.0:
            acting = np.append(u[a], (u[a : b - 1] + u[a + 1 : b]) / 2)
            out[a:b, 0] = (acting - inertia * np.gradient(v[a:b], t[a:b])) / k
            out[a:b, 1] = np.gradient(out[a:b, 0], t[a:b])
    return out


@njit("float64[:, ::1](float64[::1], float64[::1], float64[::1], float64[::1], float64[::1], int64[::1])", cache=True)
def twists(t: Floats, q: Floats, v: Floats, u: Floats, law: Floats, edges: Ints) -> Floats:
    """Twist and its rate at every stamp, (n, 2), with the link as measured, (n,): semi-implicit steps between stamps.

    Args:
        t: (n,) s; q, v: (n,) the link; u: (n,) the drive, held from each stamp on; law: (I, k, c, half, h).
        edges: first sample of each trace, and their number.
    """
    inertia, k, c, half, stops, pressed, depth = law
    quick = math.sqrt((k + stops) / inertia)
    out = np.empty((t.size, 2))
    for trace in range(edges.size - 1):
        first = edges[trace]
        side = 1.0 if u[first] > 0.0 else -1.0
        p, r = q[first] + u[first] / (k + stops) + side * half, v[first]
        out[first, 0], out[first, 1] = p - q[first], 0.0
        for i in range(first + 1, edges[trace + 1]):
            dt = t[i] - t[i - 1]
            count = max(math.ceil(quick * dt / 0.15), 2)
            h = dt / count
            for j in range(count):
                share = (j + 0.5) / count
                w = p - q[i - 1] - share * (q[i] - q[i - 1])
                s = r - v[i - 1] - share * (v[i] - v[i - 1])
                up, down = max(w - half, 0.0), max(-w - half, 0.0)
                held = max(stops * up + pressed * s * min(1.0, up * depth), 0.0)
                back = max(stops * down - pressed * s * min(1.0, down * depth), 0.0)
                r += h * (u[i - 1] - k * w - c * s - held + back) / inertia
                p += h * r
            out[i, 0], out[i, 1] = p - q[i], r - v[i]
    return out
