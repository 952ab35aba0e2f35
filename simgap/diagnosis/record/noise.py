"""Noise of the readings, without a model: white noise, and what each reading of an encoder is worth.

White noise is what is left where no smooth motion can be. The error of rounding is a function of the place. While a
motion crosses several counts between readings it is as good as white, with a variance of step^2 / 12; while it stays
within one count the error stays the same, and all readings of that time together are worth hardly more than one. White
noise before the rounding dithers: what is left of the error at a given place falls with
exp(-2 pi^2 (sigma / step)^2). A reading is therefore weighed by one over the design effect of the readings that share
its count, 1 + rho (n - 1), with rho the share of the variance that they have in common.
Source: Widrow, Kollar (2008), Quantization Noise, ch. 5, 9; Kish (1965), Survey Sampling, sec. 5.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from simgap.arrays import Floats, Ints
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.thresholds import CUT_OFF, WITHIN
from simgap.late import njit

ORDER = 6
_HOP = 5  # samples
_BLOCK = 50_000  # rows at a time: memory stays small for long records


def sixth_differences(t: Floats, y: Floats) -> Floats:
    """Sixth divided differences over true times, their weights scaled to unit length: (n,), (n, k) -> (n - 6, k).

    The weights are orthogonal to every polynomial below that order at their stamps. For even spacing they are the
    binomial difference over sqrt(924).
    """
    stamps = sliding_window_view(t, ORDER + 1)
    scale = (stamps[:, -1] - stamps[:, 0])[:, None] / ORDER
    gaps = (stamps[:, :, None] - stamps[:, None, :]) / scale[:, :, None] + np.eye(ORDER + 1)
    weights = 1.0 / np.prod(gaps, axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return np.asarray(np.einsum("rkj,rj->rk", sliding_window_view(y, ORDER + 1, axis=0), weights))


def noise_floor(record: Record) -> Floats:
    """Standard deviation of white noise on each measured channel, (k,), in the channel's unit.

    sigma^2 is the mean square of the sixth difference of unit weight (for even spacing mean((6th difference)^2) / 924):
    a motion that is smooth over seven samples drops out. Coloured or quantised noise is not seen in full.
    Readings that are no measurement are not used.
    """
    total, count = np.zeros(len(record.measured)), np.zeros(len(record.measured))
    for trace in record.traces:
        for a in range(0, len(trace.t) - ORDER, _BLOCK):  # none of a trace that is too short
            part = slice(a, min(a + _BLOCK + ORDER, len(trace.t)))
            used = sliding_window_view(trace.compared[part], ORDER + 1, axis=0).all(axis=2)
            total += (used * np.square(sixth_differences(trace.t[part], trace.y[part]))).sum(axis=0)
            count += used.sum(axis=0)
    spread = np.sqrt(np.mean([np.var(trace.y, axis=0) for trace in record.traces], axis=0))
    floor = 1e-7 * np.maximum(spread, 1e-12)  # data without noise: below the accuracy of the simulation
    return np.maximum(np.sqrt(total / np.maximum(count, 1.0)), floor)


def rates(t: Floats, y: Floats) -> Floats:
    """Rates of a channel over `_HOP` samples, of which noise says less than of one: (n,) s, (n,).

    Not across what lies between two traces.
    """
    span = t[_HOP:] - t[:-_HOP]
    near = (span > 0.0) & (span < 2.0 * np.median(span))
    return np.asarray((y[_HOP:] - y[:-_HOP])[near] / span[near])


def samples_as_one(stretches: Sequence[Floats], most: int) -> float:
    """Samples that one independent sample is worth: 1 + 2 sum of the autocorrelation, at least 1.

    The sum stops where the autocorrelation first turns negative (Geyer (1992), Statistical Science 7(4)).

    Args:
        stretches: (n, k) each, in which samples follow one another; most: lags that are looked at.
    """
    sums = np.zeros(most)
    for part in stretches:
        size = 1 << (2 * len(part) - 1).bit_length()
        power = np.abs(np.fft.rfft(part, size, axis=0)) ** 2
        own = np.fft.irfft(power, size, axis=0).sum(axis=1)[: min(most, len(part))]
        sums[: len(own)] += own
    rho = sums / max(float(sums[0]), 1e-300)
    last = int(np.argmax(np.append(rho, 0.0) <= 0.0))  # all lags where none is negative
    return max(1.0, 1.0 + 2.0 * float(rho[1:last].sum()))


def resolution(record: Record) -> Floats:
    """Step of each channel's readings, (k,); 0 if they look continuous.

    The smallest steps are one count; decimals that a file cut off spread them, by as much as they may spread multiples.
    """
    out = np.zeros(len(record.measured))
    for k in range(len(record.measured)):
        read = [trace.y[trace.compared[:, k] > 0.0, k] for trace in record.traces]  # what was bridged shows no counts
        steps = np.concatenate([np.abs(np.diff(y)) for y in read])
        steps = steps[steps > 1e-12 * (np.max(steps, initial=0.0) + 1e-300)]
        if steps.size > 20:
            single = steps[steps < 1.5 * np.min(steps)]
            count, cut = float(np.mean(single)), float(np.ptp(single) / np.mean(single))
            for reach in 3.0 ** np.arange(1, 8):  # more of the steps, each time counted by what is known so far
                few = steps[steps < reach * count]
                times = np.round(few / count)
                count = float(few @ times / (times @ times))
            ratio = steps / count
            off = np.abs(ratio - np.round(ratio))
            whole = float(np.mean(off < WITHIN * np.maximum(1.0, ratio * 1e-3) + cut))
            out[k] = count if whole > 1.0 - WITHIN and cut < CUT_OFF else 0.0
    return out


_HARMONICS = np.arange(1, 50)
_FEWEST = 50  # slow readings from which the white noise is estimated
_SPAN, _NEAR = 9, 1.0  # readings, and counts within which they lie, that are slow
_AT_ONE_PLACE = 20  # slow readings that count of one stay
_LOUD = 0.35  # of a count: of white noise this large the place is gone from the error (rho < 0.003)


@dataclass(frozen=True, eq=False)
class Worth:
    """Noise and worth of the readings.

    Attributes:
        sigma: (k,) standard deviation of one reading, rounding included.
        weight: (n, k) what each reading is worth, of all traces one after another; 1 where nothing is rounded.
        steps: (k,) counts, 0 where nothing is rounded.
        shared: (k,) share of the variance that readings of one count have in common.
    """

    sigma: Floats
    weight: Floats
    steps: Floats
    shared: Floats


def worth(record: Record, known: Mapping[str, float] | None = None) -> Worth:
    """Noise and worth of every reading of a record; `known`: standard deviations that need no estimate, by channel."""
    sigma, steps = noise_floor(record), resolution(record)
    shared = np.zeros(len(steps))
    for k in np.flatnonzero(steps > 0.0):
        step = float(steps[k])
        white = white_noise(record, int(k), step, float(sigma[k]))
        sigma[k] = max(sigma[k], np.hypot(white, step / np.sqrt(12.0)))  # few slow readings tell little of the noise
        shared[k] = _placed(white / step) * (step / sigma[k]) ** 2
    weight = [weights(trace.y, steps, shared) for trace in record.traces]
    given = known or {}
    sigma = np.array([float(given.get(name, s)) for name, s in zip(record.measured, sigma, strict=True)])
    return Worth(sigma, np.concatenate(weight), steps, shared)


def weights(y: Floats, steps: Floats, shared: Floats) -> Floats:
    """What each reading of one trace is worth, (n, k), from where it is: steps and shared as in `Worth`."""
    out = np.ones(y.shape)
    for k in np.flatnonzero(steps > 0.0):
        place = np.round((y[:, k] - y[0, k]) / steps[k]).astype(np.int64)
        out[:, k] = 1.0 / (1.0 + shared[k] * (_company(place) - 1.0))
    return out


def white_noise(record: Record, k: int, step: float, every: float) -> float:
    """Standard deviation of the white noise of channel k before it was rounded to a step.

    Where a motion is slow, steady readings change by whole counts in one direction, and only noise sends them back: two
    changes one after the other have a mean product of minus the variance of the readings at a place. Sixth differences
    (`every`) tell it too, but show rounding at half a count a reading as noise three times as large; they stand where
    the noise is larger than rounding by far, or nothing is slow.
    """
    of_all = max(every**2 / step**2 - 1.0 / 12.0, 0.0)
    products = np.concatenate([_returns(np.round((tr.y[:, k] - tr.y[0, k]) / step)) for tr in record.traces])
    if of_all > _LOUD**2 or products.size < _FEWEST:
        return step * float(np.sqrt(of_all))
    at_place = max(-float(np.mean(products)), 0.0)
    ratios = np.linspace(0.0, 2.0 * _LOUD, 200)
    return step * float(np.interp(at_place, [1.0 / 12.0 + r * r - _placed(float(r)) for r in ratios], ratios))


def _returns(place: Floats) -> Floats:
    """Products of successive changes (counts^2) in the middle of readings that all lie within `_NEAR` counts.

    Of a long rest only so many count as of a slow crossing: the edge of a count may be near its place, or not.
    """
    if len(place) < _SPAN:
        return np.zeros(0)
    slow = np.ptp(sliding_window_view(place, _SPAN), axis=1) <= _NEAR
    change = np.diff(place)[_SPAN // 2 - 1 :][: len(slow) + 1]
    at = np.arange(len(slow))
    since = at - np.maximum.accumulate(np.where(slow, -1, at))  # slow readings up to here, one after the other
    return np.asarray((change[1:] * change[:-1])[: len(slow)][slow & (since <= _AT_ONE_PLACE)])


def _placed(ratio: float) -> float:
    """Variance over step^2 of the error's mean at a place, over all places; ratio: white noise over the step."""
    return float(np.sum(np.exp(-4.0 * (np.pi * ratio * _HARMONICS) ** 2) / _HARMONICS**2) / (2.0 * np.pi**2))


@njit("float64[::1](int64[::1])", cache=True)
def _company(place: Ints) -> Floats:
    """How many readings (n,) each shares its count with.

    A stretch of two neighbouring counts with one change between them is a motion across both and holds two stays; with
    none, or with more (the noise flickers at the edge of a count), it is one.
    """
    n = place.size
    out = np.ones(n)
    a = 0
    while a < n:
        low = high = place[a]
        b, changes, last = a + 1, 0, a
        while b < n and max(high, place[b]) - min(low, place[b]) <= 1:
            low, high = min(low, place[b]), max(high, place[b])
            if place[b] != place[b - 1]:
                changes += 1
                last = b
            b += 1
        long = (b - a) * (0.5 if changes == 1 else 1.0)
        for i in range(a, b):
            out[i] = max(out[i], long)
        a = last if last > a and b < n else b
    return out
