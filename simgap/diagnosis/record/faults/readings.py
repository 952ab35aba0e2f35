"""Readings that are no measurement: lost rows, a sensor at its limit, stale ones, spikes. They are bridged by straight
lines, and nothing is held against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.record.noise import ORDER, difference_weights, noise_floor, resolution
from simgap.diagnosis.record.record import Record, Trace, runs
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.thresholds import A_FEW, LEAST_STALE, MATTERS, MOST, SPIKE, STALE_MISS, STALE_STEPS

_ENOUGH = 50_000  # readings for a median
_HELD = 3  # readings that equal the extreme of a channel without counts are at a limit
_LONGEST = 4  # samples from one fresh count to the next across stale ones


def repaired(record: Record) -> tuple[Record, tuple[RecordingFault, ...]]:
    """The record with such readings bridged and marked as unused, and what was found."""
    quantum, faults = resolution(record), list[RecordingFault]()
    rows = record.rows
    record = replace(record, traces=tuple(_filled(trace) for trace in record.traces))
    if record.rows > rows:
        faults.append(_said("missing_rows", "", 1.0 - rows / record.rows, "are missing"))
    lost = [~trace.compared.astype(bool) for trace in record.traces]
    sigma = noise_floor(record)
    for k, name in enumerate(record.measured):
        held = _held([trace.y[:, k] for trace in record.traces], quantum[k] == 0.0)
        if any(m.any() for m in held):
            faults.append(_said("saturated_reading", name, _share(held), "are at the limit of the sensor"))
            lost = [_with(mask, k, found) for mask, found in zip(lost, held, strict=True)]
        stale = [
            _stale(trace, k, float(sigma[k]), float(quantum[k])) & ~mask[:, k]
            for trace, mask in zip(record.traces, lost, strict=True)
        ]
        share = _share(stale)
        if LEAST_STALE < share <= MOST:
            faults.append(_said("stale", name, share, "repeat the one before while it moves"))
            lost = [_with(mask, k, found) for mask, found in zip(lost, stale, strict=True)]
        whole = [_bridged(trace, mask) for trace, mask in zip(record.traces, lost, strict=True)]
        scale = _scale(whole, k, float(quantum[k]))
        spikes = [_spikes(trace.y[:, k], scale) for trace in whole]
        share = _share(spikes)
        if 0.0 < share <= A_FEW:
            faults.append(_said("spikes", name, share, f"jump away for one sample by more than {SPIKE * scale:.2g}"))
            lost = [_with(mask, k, found) for mask, found in zip(lost, spikes, strict=True)]
    if not faults and not any(mask.any() for mask in lost):
        return record, ()
    traces = tuple(_bridged(trace, mask) for trace, mask in zip(record.traces, lost, strict=True))
    return replace(record, traces=traces), tuple(faults)


def _said(fault: str, name: str, share: float, what: str) -> RecordingFault:
    of = f"readings of {name}" if name else "rows"
    sentence = f"{100 * share:.2g} % of the {of} {what}; they are not compared."
    remedy = {
        "missing_rows": "Log every row: what was commanded there is taken from the rows around them.",
        "saturated_reading": f"Choose a wider range for the sensor of {name}, or a smaller motion.",
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


def _filled(trace: Trace) -> Trace:
    """The trace with the rows that are missing from evenly spaced stamps, between those around them and unused.

    What is commanded is held from row to row; across one that is missing it would be held for too long.
    """
    steps = np.diff(trace.t)
    each = steps / np.median(steps)
    count = np.round(each).astype(np.int64)
    if not np.any(count > 1) or np.any(count < 1) or np.any(np.abs(each - count) > MATTERS * count):
        return trace
    place = np.concatenate([[0], np.cumsum(count)])
    every = np.arange(int(place[-1]) + 1)

    def between(column: Floats) -> Floats:
        return np.interp(every, place, column)

    y, u = (np.stack([between(c) for c in block.T], axis=1) for block in (trace.y, trace.u))
    used = np.zeros(y.shape, dtype=bool)
    used[place] = trace.compared > 0.0
    return Trace(trace.name, between(trace.t), y, u, used)


def _held(columns: Sequence[Floats], fine: bool) -> list[Bools]:
    """Readings of one channel at its extremes over all traces, where several in a row are; none of a coarse one."""
    low, high = min(float(y.min()) for y in columns), max(float(y.max()) for y in columns)
    out = []
    for y in columns:
        mask = np.zeros(len(y), dtype=bool)
        for end in (low, high):
            for a, b in runs(y == end):
                mask[a:b] |= b - a >= _HELD
        out.append(mask & (fine and low < high))
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
