"""Readings that are no measurement: lost rows, a sensor at its limit, one that overflows, spikes, stale ones.

What is lost is bridged by straight lines and marked, and nothing is compared with it; what a counter lost of its range
is given back.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.diagnosis.record.faults.base import Mended, SeenFault
from simgap.diagnosis.record.noise import ORDER, noise_floor, resolution, sixth_differences, white_noise
from simgap.diagnosis.record.record import Record, Trace, runs
from simgap.diagnosis.thresholds import (
    A_FEW,
    BRIEF_S,
    BY_CHANCE,
    COUNTS,
    FAR,
    LEAST_STALE,
    MATTERS,
    MOST,
    SEVERAL,
    SPIKE,
)
from simgap.model.symbolic import SymbolicModel
from simgap.notation import number

_ENOUGH = 50_000  # readings for a median
_COUNTS = 16  # counts before an extreme by which a motion shows whether it slows down
_STOPS = 0.4  # between the quarter of a motion that is stopped and the half of one that is cut off
_EDGE = 2  # samples within which an end of a range stops a motion that turns within so many half as far
_LONGEST = 4  # samples from one fresh count to the next across stale ones
_AROUND = 7  # changes whose median is the motion's own
_SOON = 0.25 * BRIEF_S  # a plant that moved away is not back before; one reading may last longer
_ALIKE = 0.25  # a jump away and the one back differ by less than this share


class MissingRows(SeenFault):
    """Evenly spaced stamps lack rows.

    Detected: intervals that are whole multiples of the usual one; bridged, with inputs from the rows around them.
    Windows end at gaps across which the inputs cannot be inferred.
    """

    name = "missing_rows"
    remedy = "Log every row: what was commanded there is taken from the rows around them."

    def mend(self, record: Record, model: SymbolicModel) -> Mended:
        """The record with the rows that lack, unused."""
        filled = replace(record, traces=tuple(_filled(trace) for trace in record.traces))
        if filled.rows == record.rows:
            return record, ()
        share = 1.0 - record.rows / filled.rows
        sentence = f"{number(100 * share, 2)} % of the rows within traces are missing; they are not compared."
        return filled, (self.told("", share, sentence),)


class _LostReadings(SeenFault):
    """Readings of a channel that are no measurement."""

    what: ClassVar[str]
    """What they do, after 'of the readings of q'."""
    fewest: ClassVar[float] = 0.0
    most: ClassVar[float] = 1.0
    """Shares of the readings between which they are taken for that."""

    def mend(self, record: Record, model: SymbolicModel) -> Mended:
        """The record with such readings bridged."""
        quantum, faults = resolution(record), []
        lost = [trace.compared == 0.0 for trace in record.traces]
        for k, name in enumerate(record.measured):
            found = [m & ~own[:, k] for m, own in zip(self.lost(record, k, float(quantum[k])), lost, strict=True)]
            share = sum(int(m.sum()) for m in found) / record.rows
            if self.fewest < share <= self.most:
                sentence = f"{number(100 * share, 2)} % of the readings of {name} {self.what}; they are not compared."
                faults.append(self.told(name, share, sentence))
                for own, m in zip(lost, found, strict=True):
                    own[:, k] |= m
        if not faults:
            return record, ()
        traces = tuple(bridged(trace, mask) for trace, mask in zip(record.traces, lost, strict=True))
        return replace(record, traces=traces), tuple(faults)

    @abstractmethod
    def lost(self, record: Record, k: int, quantum: float) -> list[Bools]:
        """Which readings of channel k, (n,) for each trace; quantum: its count, 0 where it looks continuous."""


class SaturatedReading(_LostReadings):
    """A reading stands at its largest or smallest value, the limit of its sensor.

    Detected: three readings in a row equal an extreme of the channel, of an encoder more than its noise would leave
    there after a motion that did not slow down, or where the motion stops and starts too abruptly to turn round; not
    where most readings stand. Excluded from the error.
    """

    name = "saturated_reading"
    remedy = "If it did not rest there: choose a wider range for the sensor of {}, or a smaller motion."
    what = "stand at its extreme, at the limit of the sensor or at rest there"

    def lost(self, record: Record, k: int, quantum: float) -> list[Bools]:
        """Readings at an extreme over all traces, where so many in a row are as noise would not leave there."""
        columns = [trace.y[:, k] for trace in record.traces]
        low, high = min(float(y.min()) for y in columns), max(float(y.max()) for y in columns)
        usual, repeats = _turning(columns), 0.0
        if quantum > 0.0:
            white = white_noise(record, k, quantum, float(noise_floor(record)[k]))
            flicker = min(white, *(_scatter(trace.t, trace.y[:, k]) for trace in record.traces))
            repeats = math.erf(0.5 * quantum / max(math.sqrt(2.0) * flicker, 1e-300))
        out = [np.zeros(len(y), dtype=bool) for y in columns]
        for end in (low, high) if low < high else ():
            seldom = sum(int((y == end).sum()) for y in columns) <= MOST * record.rows
            held = [(y, a, b) for y in columns for a, b in runs(y == end) if seldom and b - a >= SEVERAL]
            # what slows down to its extreme, or speeds up from there, rests
            if any(
                (repeats ** (b - a) < BY_CHANCE and _meets(y, a, b, quantum)) or _cut_off(y, a, b, usual)
                for y, a, b in held
            ):
                out = [mask | (y == end) for mask, y in zip(out, columns, strict=True)]
        return out


def _meets(y: Floats, a: int, b: int, quantum: float) -> bool:
    """Whether a motion comes to its extreme over [a, b), or leaves it, at its speed: as one that is cut off does.

    Of the last `_COUNTS` counts of the way, half are gone in half of the time at a constant speed, a quarter in the
    last half of it where a constant force stops the motion.
    """
    for way in (y[a::-1], y[b - 1 :]):  # from the extreme on
        gone = np.abs(way - way[0])
        far = np.flatnonzero(gone >= _COUNTS * quantum)
        if far.size and (far[0] < 2 or gone[far[0] // 2] / gone[far[0]] > _STOPS):
            return True
    return False


def _cut_off(y: Floats, a: int, b: int, usual: float) -> bool:
    """Whether a motion comes to its extreme over [a, b) and leaves it faster than a turn or a start from rest does.

    usual: by how much the motion turns within as many samples elsewhere.
    """
    if a < _EDGE or b + _EDGE > len(y):
        return False
    return bool(min(abs(y[a] - y[a - _EDGE]), abs(y[b - 1] - y[b - 1 + _EDGE])) > usual / MOST)


def _turning(columns: Sequence[Floats]) -> float:
    """By how much a channel turns within `_EDGE` samples, at most times."""
    turns = [np.abs(y[2 * _EDGE :] - 2.0 * y[_EDGE:-_EDGE] + y[: -2 * _EDGE]) for y in columns]
    return float(np.quantile(np.concatenate(turns), 1.0 - A_FEW))


class Overflow(SeenFault):
    """A reading beyond one end of its range goes on at the other end.

    Detected: jumps of one size between the ends of what the channel shows; given back.
    """

    name = "overflow"
    unit = ""
    remedy = "Choose a wider range for the sensor of {}, or map an angle with wrapped: true."

    def mend(self, record: Record, model: SymbolicModel) -> Mended:
        """The record with whole ranges given back."""
        quantum, faults = resolution(record), []
        for k, name in enumerate(record.measured):
            size = _range(record, k, float(quantum[k]))
            if size > 0.0:
                traces = tuple(trace.showing(k, np.unwrap(trace.y[:, k], period=size)) for trace in record.traces)
                record = replace(record, traces=traces)
                sentence = f"{name} jumps by {size:.4g} from one end of its range to the other; that was undone."
                faults.append(self.told(name, size, sentence, unit=model.units[name]))
        return record, tuple(faults)


def _range(record: Record, k: int, quantum: float) -> float:
    """By how much channel k overflows; 0 if it does not."""
    scale, columns = _usual(record.traces, k, quantum), [trace.y[:, k] for trace in record.traces]
    jumps = [_jumps(y, scale) for y in columns]
    sizes, every = np.concatenate([np.abs(size) for _, size in jumps]), np.concatenate(columns)
    low, high = float(every.min()), float(every.max())
    near = 0.1 * (high - low)  # what moves between two readings is seen at neither end
    if sizes.size < 2 or np.ptp(sizes) > near or float(np.median(sizes)) < high - low - near:
        return 0.0
    if np.mean((every > low + near) & (every < high - near)) < MOST:  # between two places a plant may step
        return 0.0
    ends = [np.sort([y[at - 1], y[at]], axis=0) for y, (at, _) in zip(columns, jumps, strict=True)]
    if any(np.any((less > low + near) | (more < high - near)) for less, more in ends):
        return 0.0
    size = float(np.median(sizes))
    straight = [np.unwrap(y, period=size) for y in columns]
    if any(len(_jumps(y, scale)[0]) for y in straight):  # what reads a number of its own out there is no counter
        return 0.0
    return size


class Spikes(_LostReadings):
    """Readings jump away and return, one or a few in a row.

    Detected: a change that stands out of those around it, and one back within 50 ms or at the next reading; where much
    else jumps single readings alone. Bridged, and excluded from the error, if they are a twentieth of the readings at
    most.
    """

    name = "spikes"
    remedy = "Look at the wiring and the bus of {}; drop such rows."
    what = "jump away and come back"
    most = A_FEW

    def lost(self, record: Record, k: int, quantum: float) -> list[Bools]:
        """Readings between a jump away and the one back; where much else jumps, those that stand alone."""
        scale = _usual(record.traces, k, quantum)
        found = [_away(trace.t, trace.y[:, k], scale) for trace in record.traces]
        jumpy = sum(left for *_, left in found) > MATTERS * sum(int(every.sum()) for _, every, _ in found)
        return [alone if jumpy else every for alone, every, _ in found]


def _changes(y: Floats) -> Floats:
    """What the change up to each reading but the first is beside that of the motion around, (n - 1,)."""
    change = np.diff(y)
    if len(change) < _AROUND:
        return np.zeros_like(change)
    padded = np.pad(change, _AROUND // 2, mode="reflect")
    return np.asarray(change - np.median(np.lib.stride_tricks.sliding_window_view(padded, _AROUND), axis=1))


def _usual(traces: Sequence[Trace], k: int, quantum: float) -> float:
    """Robust standard deviation of what bends of a channel: its noise, and the motion's curvature."""
    bends = np.concatenate([np.abs(np.diff(trace.y[:, k], 2)) for trace in traces])
    return max(0.5 * 1.4826 * float(np.median(bends)) if bends.size else 0.0, quantum)


def _jumps(y: Floats, scale: float) -> tuple[Ints, Floats]:
    """Readings (j,) up to which a channel jumps, and by how much."""
    beside = _changes(y)
    at = np.flatnonzero(np.abs(beside) > SPIKE * scale) if scale > 0.0 else np.zeros(0, dtype=np.int64)
    return at + 1, beside[at]


def _away(t: Floats, y: Floats, scale: float) -> tuple[Bools, Bools, int]:
    """Readings (n,) between a jump away and the jumps that add up to its way back, if that is soon.

    Those that stand alone, all of them, and how many jumps are left.
    """
    alone, every, (at, size) = np.zeros(len(y), dtype=bool), np.zeros(len(y), dtype=bool), _jumps(y, scale)
    k = left = 0
    while k < len(at):
        total, last, back = float(size[k]), k, False
        while not back and last + 1 < len(at) and (last == k or t[at[last + 1]] - t[at[k]] <= _SOON):
            last += 1
            total += float(size[last])
            back = abs(total) <= _ALIKE * abs(float(size[k]))
        one = back and at[last] - at[k] == 1
        if one or (back and t[at[last]] - t[at[k]] <= _SOON):
            every[at[k] : at[last]] = True
            alone[at[k]] |= one
            k = last + 1
        else:
            k, left = k + 1, left + 1
    return alone, every, left


class Stale(_LostReadings):
    """A reading repeats its predecessor although its neighbours show motion.

    Detected: it misses the line between the readings around it; bridged, and excluded from the error.
    """

    name = "stale"
    remedy = "Log {} when it is fresh, or with the stamp at which it was read."
    what = "repeat the one before while it moves"
    fewest, most = LEAST_STALE, MOST

    def lost(self, record: Record, k: int, quantum: float) -> list[Bools]:
        """Stale readings; few of them are chance."""
        sigma = float(noise_floor(record)[k])
        return [_stale(trace, k, sigma, quantum) for trace in record.traces]


def _stale(trace: Trace, k: int, sigma: float, quantum: float) -> Bools:
    """Readings (n,) that repeat the one before although what lies around them says that it moved.

    Continuous readings with noise never repeat: there all that do are stale, if some of them visibly are. Counts repeat
    where a motion is slow or rests: there only those of short runs are stale that miss the line between their
    neighbours by more than steps, and whose end catches up. What turns round or breaks away has runs that miss too.
    Where the noise is more than a count, less than half of all readings repeat by chance, and no long run does: all of
    one whose end catches up is stale.
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
        noise = min(sigma, _scatter(t, y))
        least = max(COUNTS * quantum, FAR * noise)
        stuck = (noise > quantum) & _standing(y, begins)[place]
        return np.asarray(repeats & (stuck | short & (miss > least)) & (_catching_up(t, y, begins)[place] > least))
    visible = np.mean(miss[repeats] > sigma)
    return repeats if visible > 0.2 else np.zeros(len(y), dtype=bool)


def _standing(y: Floats, begins: Ints) -> Bools:
    """Runs of equal readings that are too long for chance, (r,), where no other one stands at the same value, nor at 0:
    there something is off, or at its end."""
    long = np.diff(np.append(begins, len(y))) > -np.log2(BY_CHANCE)
    which = np.unique(y[begins], return_inverse=True)[1]
    return np.asarray(long & (np.bincount(which, weights=long)[which] == 1.0) & (y[begins] != 0.0))


def _scatter(t: Floats, y: Floats) -> float:
    """Noise of a channel from the median of its differences, which a few stale readings do not raise."""
    if len(t) <= ORDER:
        return np.inf
    t, y = t[:_ENOUGH], y[:_ENOUGH]
    return 1.4826 * float(np.median(np.abs(sixth_differences(t, y[:, None]))))


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


def _filled(trace: Trace) -> Trace:
    """The trace with the rows that are missing from evenly spaced stamps, between those around them and unused.

    What is commanded is held from row to row; across one that is missing it would be held for too long.
    """
    steps = np.diff(trace.t)
    each = steps / np.median(steps)
    count = np.round(each).astype(np.int64)
    uneven = float(np.sqrt(np.mean((each - count) ** 2)))
    if not np.any(count > 1) or np.any(count < 1) or uneven > 2.0 * MATTERS:
        return trace
    place = np.concatenate([[0], np.cumsum(count)])
    every = np.arange(int(place[-1]) + 1)

    t, y, u = (np.empty((len(every), block.shape[1])) for block in (trace.t[:, None], trace.y, trace.u))
    for column, known in zip((*t.T, *y.T, *u.T), (trace.t, *trace.y.T, *trace.u.T), strict=True):
        column[:] = np.interp(every, place, known)
    used = np.zeros(y.shape, dtype=bool)
    used[place] = trace.compared > 0.0
    unsure = [n for n in np.unique(count[count > 1]).tolist() if _guessed(trace.u, n) > MATTERS]
    told = np.append(~np.repeat(np.isin(count, unsure), count), True)
    return Trace(trace.name, t[:, 0], y, u, used, None if told.all() else told)


def _guessed(u: Floats, apart: int) -> float:
    """How far a straight line across so many intervals misses what was commanded there, over its spread; the worst."""
    spread = np.std(u, axis=0)
    if len(u) <= apart or not spread.any():
        return 0.0
    first, last = u[:-apart], u[apart:]
    misses = [first + (last - first) * (i / apart) - u[i : len(first) + i] for i in range(1, apart)]
    size = np.sqrt(np.mean(np.square(misses), axis=(0, 1)))
    return float(np.max(size[spread > 0.0] / spread[spread > 0.0]))


def bridged(trace: Trace, lost: Bools) -> Trace:
    """The trace with lines across what is lost, (n, k)."""
    if not lost.any():
        return trace
    y = trace.y.copy()
    for k in range(y.shape[1]):
        bad = lost[:, k]
        if bad.any() and not bad.all():
            y[bad, k] = np.interp(trace.t[bad], trace.t[~bad], y[~bad, k])
    return replace(trace, y=y, used=~lost)
