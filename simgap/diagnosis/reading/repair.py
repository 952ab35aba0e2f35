"""Readings that are no measurement: stale ones and spikes. They are bridged, and nothing is held against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.reading.noise import ORDER, difference_weights, noise_floor
from simgap.diagnosis.reading.record import Record, Trace
from simgap.diagnosis.reading.stillness import resolution
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.thresholds import LEAST_STALE, MOST_SPIKES, MOST_STALE, SPIKE, STALE_MISS, STALE_STEPS

_ENOUGH = 50_000  # readings for a median
_LONGEST = 4  # samples from one fresh count to the next across stale ones


def repaired(record: Record) -> tuple[Record, tuple[RecordingFault, ...]]:
    """The record with stale readings and spikes bridged by straight lines and marked as unused, and what was found."""
    sigma, quantum = noise_floor(record), resolution(record)
    lost = [np.zeros(trace.y.shape, dtype=bool) for trace in record.traces]
    faults: list[RecordingFault] = []
    for k, name in enumerate(record.measured):
        stale = [_stale(trace, k, float(sigma[k]), float(quantum[k])) for trace in record.traces]
        share = _share(stale)
        if LEAST_STALE < share <= MOST_STALE:
            faults.append(_said("stale", name, share, "repeat the one before while it moves"))
            lost = [_with(mask, k, found) for mask, found in zip(lost, stale, strict=True)]
        whole = [_bridged(trace, mask) for trace, mask in zip(record.traces, lost, strict=True)]
        scale = _scale(whole, k, float(quantum[k]))
        spikes = [_spikes(trace.y[:, k], scale) for trace in whole]
        share = _share(spikes)
        if 0.0 < share <= MOST_SPIKES:
            faults.append(_said("spikes", name, share, f"jump away for one sample by more than {SPIKE * scale:.2g}"))
            lost = [_with(mask, k, found) for mask, found in zip(lost, spikes, strict=True)]
    if not faults:
        return record, ()
    traces = tuple(_bridged(trace, mask) for trace, mask in zip(record.traces, lost, strict=True))
    return replace(record, traces=traces), tuple(faults)


def _said(fault: str, name: str, share: float, what: str) -> RecordingFault:
    sentence = f"{100 * share:.2g} % of the readings of {name} {what}; they are not compared."
    remedy = {
        "stale": f"Log {name} when it is fresh, or with the stamp at which it was read.",
        "spikes": f"Look at the wiring and the bus of {name}; drop such rows.",
    }[fault]
    return RecordingFault(fault, name, share, "1", sentence, remedy)


def _share(masks: list[Bools]) -> float:
    return sum(int(m.sum()) for m in masks) / max(sum(m.size for m in masks), 1)


def _with(mask: Bools, k: int, found: Bools) -> Bools:
    out = mask.copy()
    out[:, k] |= found
    return out


def _stale(trace: Trace, k: int, sigma: float, quantum: float) -> Bools:
    """Readings (n,) that repeat the one before although what lies around them says that it moved.

    Continuous readings with noise never repeat: there all that do are stale, if some of them visibly are. Counts repeat
    where a motion is slow or rests: there only those of short runs are stale that miss the line between their
    neighbours by more than steps, and whose end catches up. What turns round or breaks away has runs that miss too.
    """
    y, t = trace.y[:, k], trace.t
    repeats = np.concatenate([[False], np.diff(y) == 0.0])
    if not repeats.any() or repeats.all():
        return np.zeros(len(y), dtype=bool)
    fresh = np.flatnonzero(~repeats)
    begins = np.concatenate([[0], fresh])
    place = np.searchsorted(begins, np.arange(len(y)), side="right") - 1
    before = begins[place]
    after = np.append(begins, len(y) - 1)[np.minimum(place + 1, len(begins))]
    span = np.maximum(t[after] - t[before], 1e-300)
    miss = np.abs(y[before] + (y[after] - y[before]) * (t - t[before]) / span - y)
    if quantum > 0.0:
        short = after - before <= _LONGEST  # a longer run is a rest, and the line across it begins where the rest did
        least = max(STALE_STEPS * quantum, 3.0 * min(sigma, _scatter(t, y)))
        return np.asarray(repeats & short & (miss > least) & (_catching_up(t, y, begins)[place] > least))
    visible = np.mean(miss[repeats] > STALE_MISS * sigma)
    return repeats if visible > 0.2 else np.zeros(len(y), dtype=bool)


def _scatter(t: Floats, y: Floats) -> float:
    """Noise of a channel from the median of its differences, which a few stale readings do not raise."""
    if len(t) <= ORDER:
        return np.inf
    t, y = t[:_ENOUGH], y[:_ENOUGH]
    differences = np.einsum("rj,rj->r", np.lib.stride_tricks.sliding_window_view(y, ORDER + 1), difference_weights(t))
    return 1.4826 * float(np.median(np.abs(differences)))


def _catching_up(t: Floats, y: Floats, begins: Ints) -> Floats:
    """By how much the change that ends each run of equal readings is larger than the steps before and after it, (r,).

    Behind stale readings it makes up for the time that they hid, while a motion that begins goes on faster.
    """
    ends = np.append(begins[1:], len(y) - 1)
    beyond = np.append(ends[1:], len(y) - 1)
    step = np.maximum(t[ends] - t[np.maximum(ends - 1, 0)], 1e-300)
    earlier = np.maximum(begins - 1, 0)
    change = y[ends] - y[begins]
    rates = [(y[b] - y[a]) / np.maximum(t[b] - t[a], 1e-300) for a, b in ((earlier, begins), (ends, beyond))]
    usual = np.maximum(*(np.sign(change) * rate for rate in rates)) * step
    return np.asarray(np.abs(change) - np.maximum(usual, 0.0))


def _bend(y: Floats) -> Floats:
    """Each reading less the mean of its neighbours, (n - 2,)."""
    return np.asarray(y[1:-1] - 0.5 * (y[2:] + y[:-2]))


def _scale(traces: Sequence[Trace], k: int, quantum: float) -> float:
    """Robust standard deviation of what bends of a channel: its noise, and the motion's curvature."""
    bends = np.concatenate([_bend(trace.y[:, k]) for trace in traces])
    return max(1.4826 * float(np.median(np.abs(bends))) if bends.size else 0.0, quantum)


def _spikes(y: Floats, scale: float) -> Bools:
    """Single readings (n,) that jump away and come back: their neighbours bend the other way by half as much."""
    out = np.zeros(len(y), dtype=bool)
    if len(y) < 5 or scale <= 0.0:
        return out
    bend = _bend(y)
    far = np.abs(bend[1:-1]) > SPIKE * scale
    for side in (bend[:-2], bend[2:]):
        far &= np.abs(side + 0.5 * bend[1:-1]) < 0.25 * np.abs(bend[1:-1])
    out[2:-2] = far
    return out


def _bridged(trace: Trace, lost: Bools) -> Trace:
    y = trace.y.copy()
    for k in range(y.shape[1]):
        bad = lost[:, k]
        if bad.any() and not bad.all():
            y[bad, k] = np.interp(trace.t[bad], trace.t[~bad], y[~bad, k])
    return replace(trace, y=y, used=~lost)
