"""A look at the data before any fit: rates, noise, lag, limits, stillness, excitation, with advice in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.faults.columns import VelocityLag, velocity_lags
from simgap.diagnosis.record.faults.registry import READINGS, mended
from simgap.diagnosis.record.noise import Worth, worth
from simgap.diagnosis.record.record import Record, runs
from simgap.diagnosis.thresholds import A_FEW, BRIEF_S, FAR, MATTERS, MOST, SELDOM, SEVERAL
from simgap.late import sympy as sp
from simgap.model.symbolic import Coordinate, SymbolicModel, symbol
from simgap.notation import from_to, pretty_unit
from simgap.units import full_turn


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


def still_stretches(record: Record, sigma: Floats) -> Iterator[Stretch]:
    """Three blocks or more in which every channel stays within its noise, (k,), that of rounding included.

    So do the means of the blocks, of which less is noise: a slow motion is one.
    """
    limit = 2.0 * FAR * sigma
    for trace in record.traces:
        starts = np.searchsorted(trace.t, np.arange(trace.t[0], trace.t[-1], BRIEF_S))
        edges = np.unique(np.append(starts, len(trace.t)))
        blocks = [trace.y[a:b] for a, b in pairwise(edges.tolist())]
        means = np.stack([block.mean(axis=0) for block in blocks])
        rows = np.diff(edges)
        near = limit / np.sqrt(np.minimum(rows, np.append(rows[1:], rows[-1])))[:, None]
        quiet = np.stack([np.ptp(block, axis=0) for block in blocks]) <= limit
        steady = np.abs(np.diff(means, axis=0, append=means[-1:])) <= near
        for a, b in runs(np.all(quiet & steady, axis=1)):
            stretch = Stretch(trace.name, float(trace.t[edges[a]]), float(trace.t[edges[b] - 1]))
            together = np.all(np.ptp(means[a:b], axis=0) <= 2 * near[a:b].max(axis=0))
            if together and stretch.seconds >= (SEVERAL - 1) * BRIEF_S:
                yield stretch


def frozen_stretches(record: Record, still: tuple[Stretch, ...]) -> Iterator[Stretch]:
    """Stretches of at least `BRIEF_S` in which one channel repeats the very same number while the trace moves."""
    for trace in record.traces:
        span = np.ptp(trace.y, axis=0)
        rests = [s for s in still if s.trace == trace.name]
        for k, name in enumerate(record.measured):
            for a, b in runs(np.diff(trace.y[:, k]) == 0.0):
                s = Stretch(trace.name, float(trace.t[a]), float(trace.t[b]), name)
                rested = any(o.start <= s.stop and s.start <= o.stop for o in rests)
                moved = np.delete(np.ptp(trace.y[a : b + 1], axis=0) > MOST * span, k)
                if s.seconds >= BRIEF_S and not rested and moved.any():
                    yield s


def at_limit(u: Floats) -> float:
    """Share of samples (n,) held at the lowest or highest value.

    A sample counts when a neighbour is at the same extreme; inputs of few levels (bang-bang, steps) have no limit.
    """
    lo, hi = float(u.min()), float(u.max())
    levels = np.unique(u[:: max(1, u.size // 20000)])
    if hi == lo or levels.size <= 8:
        return 0.0
    slack = 1e-6 * (hi - lo)
    held = [b - a for side in (u <= lo + slack, u >= hi - slack) for a, b in runs(side)]
    return sum(n for n in held if n >= SEVERAL) / u.size


@dataclass(frozen=True)
class TraceLook:
    """Timing of a trace: samples, seconds, median rate (Hz), spread of intervals without lost rows, longest one (s)."""

    name: str
    samples: int
    duration_s: float
    rate_hz: float
    jitter_s: float
    longest_interval_s: float


@dataclass(frozen=True)
class ChannelLook:
    """One channel: its unit, its range, RMS, noise floor (None for an input) and resolution (0: continuous)."""

    name: str
    unit: str
    lowest: float
    highest: float
    rms: float
    noise: float | None
    resolution: float
    at_limit: float = 0.0


@dataclass(frozen=True)
class Survey:
    """What the data look like, and what a person should do about it."""

    traces: tuple[TraceLook, ...]
    channels: tuple[ChannelLook, ...]
    lags: tuple[VelocityLag, ...]
    still: tuple[Stretch, ...]
    frozen: tuple[Stretch, ...]
    warnings: tuple[str, ...]


def survey(record: Record, model: SymbolicModel, noise: Mapping[str, float] | None = None) -> Survey:
    """Look at a record.

    Args:
        record: traces in the model's units.
        model: gives units, coordinates and the shape of the dynamics.
        noise: standard deviations that are known, by channel; the others are estimated.
    """
    clean, _ = mended(record, model, READINGS)  # spikes are no noise, within which all would be at rest
    readings = worth(clean, noise)
    lags = tuple(velocity_lags(clean, model))
    still = tuple(still_stretches(clean, readings.sigma))
    frozen = tuple(frozen_stretches(record, still))
    channels = tuple(_looks(record, model, readings))
    traces = tuple(_timing(record))
    warnings = (
        *_excitation(record, model),
        *_limits(channels),
        *_lag_words(lags, traces),
        *_still_words(still, frozen, sum(t.duration_s for t in traces)),
    )
    return Survey(traces, channels, lags, still, frozen, warnings)


def _timing(record: Record) -> Iterator[TraceLook]:
    for trace in record.traces:
        dt = np.diff(trace.t)
        usual, whole = float(np.median(dt)), dt[dt < 1.5 * np.median(dt)]
        yield TraceLook(trace.name, len(trace.t), trace.duration, 1.0 / usual, float(np.std(whole)), float(np.max(dt)))


def _looks(record: Record, model: SymbolicModel, readings: Worth) -> Iterator[ChannelLook]:
    """Every state that was measured, then every input."""
    read, put = (np.concatenate([getattr(trace, n) for trace in record.traces]) for n in ("y", "u"))
    for k, (name, x) in enumerate(zip((*record.measured, *record.inputs), (*read.T, *put.T), strict=True)):
        range_ = float(x.min()), float(x.max()), float(np.sqrt(np.mean(x**2)))
        is_input = k >= len(record.measured)
        own = (None, 0.0, at_limit(x)) if is_input else (float(readings.sigma[k]), float(readings.steps[k]))
        yield ChannelLook(name, model.units[name], *range_, *own)


def _excitation(record: Record, model: SymbolicModel) -> Iterator[str]:
    for k, name in enumerate(record.inputs):
        spread = max(float(np.ptp(trace.u[:, k])) for trace in record.traces)
        if spread <= 1e-9:
            same = float(np.ptp([trace.u[0, k] for trace in record.traces])) <= 1e-9
            lost = "gain, bias, dead zone, delay and lag" if same else "delay and lag"
            yield (
                f"input {name} is constant{'' if same else ' within each trace'}: its {lost} cannot be identified, nor "
                "a lag of a sensor; change it within the record, as a sum of sines or in steps that the plant has time "
                "to answer, and begin before the first: a step in the first row hides what follows it late"
            )
    for c in model.coordinates:
        if c.position in record.measured:
            yield from _motion(record, model, c)


def _motion(record: Record, model: SymbolicModel, c: Coordinate) -> Iterator[str]:
    k = record.measured.index(c.position)
    unit = model.units[c.position]
    turn = full_turn(unit)
    sines = {s for e in model.xdot for f in sp.sympify(e).atoms(sp.sin, sp.cos) for s in f.free_symbols}
    if turn is not None and symbol(c.position) in sines:
        angle = np.concatenate([trace.y[:, k] for trace in record.traces]) * (2 * np.pi / turn)
        a, b = (x - x.mean() for x in (angle, np.sin(angle)))
        if (a @ b) ** 2 >= (1.0 - SELDOM) ** 2 * (a @ a) * (b @ b):
            swing = max(float(np.ptp(trace.y[:, k])) for trace in record.traces) / 2
            yield (
                f"{c.position} stays within {swing:.2g} {unit} of its middle: a spring, gravity and the mass "
                f"look alike; swing further"
            )
    # about 200 values a trace: slow motion without the noise's own reversals
    forward = np.concatenate([np.diff(trace.y[:: max(1, len(trace.y) // 200), k]) for trace in record.traces])
    total = float(np.sum(np.abs(forward)))
    if total > 0.0:
        share = min(float(np.sum(forward[forward > 0])), -float(np.sum(forward[forward < 0]))) / total
        if share < A_FEW:
            yield (
                f"{c.position} moves in one direction only: friction cannot be separated from a bias; let it reverse "
                "several times"
            )


def _limits(channels: tuple[ChannelLook, ...]) -> Iterator[str]:
    for c in channels:
        if c.at_limit > A_FEW:
            ends = f"{c.lowest:.3g} to {c.highest:.3g} {pretty_unit(c.unit)}".rstrip()
            yield (
                f"input {c.name} sits at its extreme {100 * c.at_limit:.0f} % of the time "
                f"({ends}): if this is a command that a drive then limits, the plant "
                "felt less"
            )


def _lag_words(lags: tuple[VelocityLag, ...], traces: tuple[TraceLook, ...]) -> Iterator[str]:
    dt = float(np.median([1.0 / t.rate_hz for t in traces]))
    for lag in lags:
        if not lag.related:
            yield (
                f"{lag.velocity} is not the derivative of {lag.position} ({100 * lag.mismatch:.0f} % of it differs): "
                f"check the columns"
            )
        elif not lag.agrees:
            yield (
                f"{lag.velocity} is {lag.scale:.4g} times the derivative of {lag.position}: "
                f"check the units and scale of both columns"
            )
        elif abs(lag.lag_s) > MOST * dt:
            side = "trails" if lag.lag_s > 0 else "leads"
            yield (
                f"{lag.velocity} {side} the derivative of {lag.position} by {1e3 * abs(lag.lag_s):.1f} ms: "
                f"it was filtered; leave it out if the diagnosis names a delay"
            )


def _still_words(still: tuple[Stretch, ...], frozen: tuple[Stretch, ...], total: float) -> Iterator[str]:
    rest = sum(s.seconds for s in still)
    if rest > MATTERS * total:
        yield (
            f"no reading changes by more than its noise for {rest:.3g} s of {total:.3g} s "
            f"(longest: {_longest(still)}): such time tells little; drop it with measured.masks"
        )
    if frozen:
        names = ", ".join(sorted({s.channel or "" for s in frozen}))
        yield (
            f"{names} repeats one value while the rest moves (longest: {_longest(frozen)}): a stuck sensor; drop "
            "such times with measured.masks"
        )


def _longest(stretches: tuple[Stretch, ...]) -> str:
    s = max(stretches, key=lambda item: item.seconds)
    return f"{from_to(s.start, s.stop)} of {s.trace}"
