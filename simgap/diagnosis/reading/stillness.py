"""Stretches in which nothing moves, channels that freeze while others move, inputs that sit at their limit."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.reading.record import Record, Trace
from simgap.diagnosis.thresholds import CUT_OFF, MOST, STILL_NOISE, STILL_STEPS, WHOLE_WITHIN

BLOCK_S, STILL_S = 0.25, 0.75


@dataclass(frozen=True)
class Stretch:
    """A stretch of a trace: from, to (s, the trace's own stamps) and the channel it is about (None: all)."""

    trace: str
    start: float
    stop: float
    channel: str | None = None

    @property
    def seconds(self) -> float:
        """Its length, s."""
        return self.stop - self.start


def resolution(record: Record) -> Floats:
    """Step of each channel's readings, (k,); 0 if they look continuous.

    The smallest steps are one count; decimals that a file cut off spread them, by as much as they may spread multiples.
    """
    out = np.zeros(len(record.measured))
    for k in range(len(record.measured)):
        steps = np.concatenate([np.abs(np.diff(trace.y[:, k])) for trace in record.traces])
        steps = steps[steps > 1e-12 * (float(np.max(np.abs(steps))) + 1e-300)] if steps.size else steps
        if steps.size > 20:
            single = steps[steps < 1.5 * np.min(steps)]
            count, cut = float(np.mean(single)), float(np.ptp(single) / np.mean(single))
            for reach in 3.0 ** np.arange(1, 8):  # more of the steps, each time counted by what is known so far
                few = steps[steps < reach * count]
                times = np.round(few / count)
                count = float(few @ times / (times @ times))
            ratio = steps / count
            off = np.abs(ratio - np.round(ratio))
            whole = float(np.mean(off < WHOLE_WITHIN * np.maximum(1.0, ratio * 1e-3) + cut))
            out[k] = count if whole > 1.0 - WHOLE_WITHIN and cut < CUT_OFF else 0.0
    return out


def still_stretches(record: Record, sigma: Floats, quantum: Floats) -> tuple[Stretch, ...]:
    """Stretches of at least 0.75 s with every channel within its noise (k,) or two steps of its resolution (k,)."""
    limit = np.maximum(STILL_NOISE * sigma, STILL_STEPS * quantum)
    found: list[Stretch] = []
    for trace in record.traces:
        edges = _block_edges(trace)
        still = np.array([bool(np.all(np.ptp(trace.y[a:b], axis=0) <= limit)) for a, b in pairwise(edges)])
        for a, b in runs(still):
            together = np.ptp(trace.y[edges[a] : edges[b]], axis=0) <= 2 * limit
            stretch = Stretch(trace.name, float(trace.t[edges[a]]), float(trace.t[edges[b] - 1]))
            if together.all() and stretch.seconds >= STILL_S - BLOCK_S:
                found.append(stretch)
    return tuple(found)


def frozen_stretches(record: Record, still: tuple[Stretch, ...]) -> tuple[Stretch, ...]:
    """Stretches of at least 0.25 s in which one channel repeats the very same number while the trace moves."""
    found: list[Stretch] = []
    for trace in record.traces:
        span = np.ptp(trace.y, axis=0)
        rests = [s for s in still if s.trace == trace.name]
        for k, name in enumerate(record.measured):
            for a, b in runs(np.diff(trace.y[:, k]) == 0.0):
                s = Stretch(trace.name, float(trace.t[a]), float(trace.t[b]), name)
                if s.seconds < BLOCK_S or any(o.start <= s.stop and s.start <= o.stop for o in rests):
                    continue
                moved = np.delete(np.ptp(trace.y[a : b + 1], axis=0) > MOST * span, k)
                if moved.any():
                    found.append(s)
    return tuple(found)


def at_limit(u: Floats) -> tuple[float, float, float]:
    """Share of samples held at the lowest and highest value, and the larger magnitude of the two: (n,) -> floats.

    A sample counts when a neighbour is at the same extreme; inputs of few levels (bang-bang, steps) have no limit.
    """
    lo, hi = float(u.min()), float(u.max())
    levels = np.unique(u[:: max(1, u.size // 20000)])
    if hi == lo or levels.size <= 8:
        return 0.0, 0.0, max(abs(lo), abs(hi))
    slack = 1e-6 * (hi - lo)
    low, high = (_in_runs(side) for side in (u <= lo + slack, u >= hi - slack))
    return low, high, max(abs(lo), abs(hi))


def _in_runs(flags: Bools) -> float:
    return sum(b - a for a, b in runs(flags) if b - a >= 3) / flags.size


def _block_edges(trace: Trace) -> list[int]:
    edges = np.searchsorted(trace.t, np.arange(trace.t[0], trace.t[-1], BLOCK_S))
    return np.unique(np.append(edges, len(trace.t))).tolist()


def runs(flags: Bools) -> list[tuple[int, int]]:
    """Runs of True as half-open index ranges."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
