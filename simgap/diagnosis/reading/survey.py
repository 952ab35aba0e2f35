"""A look at the data before any fit: rates, noise, lag, limits, stillness, excitation, with advice in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.reading.encoder import worth
from simgap.diagnosis.reading.lag import VelocityLag, velocity_lag
from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.reading.stillness import Stretch, at_limit, frozen_stretches, resolution, still_stretches
from simgap.diagnosis.thresholds import A_FEW, DERIVATIVE_SCALE, LAG_WORTH_SAYING_S, MOST, REST_SHARE, SMALL_SWING_RAD
from simgap.late import sympy as sp
from simgap.model.symbolic import Coordinate, SymbolicModel, symbol
from simgap.units import full_turn


@dataclass(frozen=True)
class TraceLook:
    """Timing of one trace: samples, seconds, median rate (Hz), spread of the interval (s), longest interval (s)."""

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
    quantum = resolution(record)
    sigma = worth(record).sigma
    for name, value in (noise or {}).items():
        if name in record.measured:
            sigma[record.measured.index(name)] = value
    lags = tuple(
        lag
        for c in model.coordinates
        if c.position in record.measured and c.velocity in record.measured
        if (lag := velocity_lag(record, c.position, c.velocity)) is not None
    )
    still = still_stretches(record, sigma, quantum)
    frozen = frozen_stretches(record, still)
    channels = (*_state_looks(record, model, sigma, quantum), *_input_looks(record, model))
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
        yield TraceLook(
            trace.name, len(trace.t), trace.duration, float(1.0 / np.median(dt)), float(np.std(dt)), float(np.max(dt))
        )


def _state_looks(record: Record, model: SymbolicModel, sigma: Floats, quantum: Floats) -> Iterator[ChannelLook]:
    units = {v.name: v.unit for v in model.states}
    for k, name in enumerate(record.measured):
        lo, hi, rms = _range(record, k)
        yield ChannelLook(name, units[name], lo, hi, rms, float(sigma[k]), float(quantum[k]))


def _input_looks(record: Record, model: SymbolicModel) -> Iterator[ChannelLook]:
    units = {v.name: v.unit for v in model.inputs}
    for k, name in enumerate(record.inputs):
        u = np.concatenate([trace.u[:, k] for trace in record.traces])
        low, high, _ = at_limit(u)
        rms = float(np.sqrt(np.mean(u**2)))
        yield ChannelLook(name, units[name], float(u.min()), float(u.max()), rms, None, 0.0, low + high)


def _range(record: Record, k: int) -> tuple[float, float, float]:
    lo = min(float(trace.y[:, k].min()) for trace in record.traces)
    hi = max(float(trace.y[:, k].max()) for trace in record.traces)
    square = sum(float(np.sum(trace.y[:, k] ** 2)) for trace in record.traces) / record.rows
    return lo, hi, float(np.sqrt(square))


def _excitation(record: Record, model: SymbolicModel) -> Iterator[str]:
    for k, name in enumerate(record.inputs):
        spread = max(float(np.ptp(trace.u[:, k])) for trace in record.traces)
        if spread <= 1e-9:
            yield (
                f"input {name} is constant: its gain, bias, delay and dead zone cannot be told; "
                f"drive it with a sum of sines over 0.1 to 8 Hz"
            )
    for c in model.coordinates:
        if c.position in record.measured:
            yield from _motion(record, model, c)


def _motion(record: Record, model: SymbolicModel, c: Coordinate) -> Iterator[str]:
    k = record.measured.index(c.position)
    swing = max(float(np.ptp(trace.y[:, k])) for trace in record.traces) / 2
    unit = next(v.unit for v in model.states if v.name == c.position)
    turn = full_turn(unit)
    if turn is not None and swing * 2 * np.pi / turn < SMALL_SWING_RAD and _has_sine(model, c.position):
        yield (
            f"{c.position} swings by no more than {swing:.2g} {unit} to a side: a spring, gravity and the mass look "
            f"alike; swing beyond {SMALL_SWING_RAD:g} rad"
        )
    forward = np.concatenate([np.diff(_thinned(trace.y[:, k])) for trace in record.traces])
    total = float(np.sum(np.abs(forward)))
    if total > 0.0:
        share = min(float(np.sum(forward[forward > 0])), -float(np.sum(forward[forward < 0]))) / total
        if share < A_FEW:
            yield (
                f"{c.position} moves in one direction only: friction cannot be told from a bias; "
                f"let it reverse several times"
            )


def _thinned(y: Floats) -> Floats:
    """About 200 values a trace: slow motion without the noise's own reversals."""
    return y[:: max(1, y.size // 200)]


def _has_sine(model: SymbolicModel, name: str) -> bool:
    return any(symbol(name) in f.free_symbols for e in model.xdot for f in sp.sympify(e).atoms(sp.sin, sp.cos))


def _limits(channels: tuple[ChannelLook, ...]) -> Iterator[str]:
    for c in channels:
        if c.at_limit > A_FEW:
            yield (
                f"input {c.name} sits at its extreme {100 * c.at_limit:.0f} % of the time "
                f"({c.lowest:.3g} to {c.highest:.3g} {c.unit}): if this is a command that a drive then limits, "
                f"the plant felt less"
            )


def _lag_words(lags: tuple[VelocityLag, ...], traces: tuple[TraceLook, ...]) -> Iterator[str]:
    dt = float(np.median([1.0 / t.rate_hz for t in traces]))
    for lag in lags:
        if lag.mismatch > MOST:
            yield (
                f"{lag.velocity} is not the derivative of {lag.position} ({100 * lag.mismatch:.0f} % of it differs): "
                f"check the columns"
            )
        elif not DERIVATIVE_SCALE[0] < lag.scale < DERIVATIVE_SCALE[1]:
            yield (
                f"{lag.velocity} is {lag.scale:.4g} times the derivative of {lag.position}: "
                f"check the units and scale of both columns"
            )
        elif abs(lag.lag_s) > max(LAG_WORTH_SAYING_S, 0.5 * dt):
            side = "trails" if lag.lag_s > 0 else "leads"
            yield (
                f"{lag.velocity} {side} the derivative of {lag.position} by {1e3 * abs(lag.lag_s):.1f} ms: "
                f"it was filtered; leave it out if the diagnosis blames a delay"
            )


def _still_words(still: tuple[Stretch, ...], frozen: tuple[Stretch, ...], total: float) -> Iterator[str]:
    rest = sum(s.seconds for s in still)
    if rest > REST_SHARE * total:
        yield (
            f"nothing moves for {rest:.3g} s of {total:.3g} s (longest: {_longest(still)}): "
            f"that time says little; drop it with measured.masks"
        )
    if frozen:
        names = ", ".join(sorted({s.channel or "" for s in frozen}))
        yield (
            f"{names} repeats one number while the rest moves (longest: {_longest(frozen)}): "
            f"a sensor that hangs; drop such times with measured.masks"
        )


def _longest(stretches: tuple[Stretch, ...]) -> str:
    s = max(stretches, key=lambda item: item.seconds)
    return f"{s.start:.3g} to {s.stop:.3g} s of {s.trace}"
