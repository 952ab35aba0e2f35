"""A plant that changed in mid-record: the times before and after are diagnosed apart, and what differs is told."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.faults.registry import PlantChanged
from simgap.diagnosis.record.record import MIN_SAMPLES, Record
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings, FoundEffect, RecordingFault
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.search.scoring import column, small_amplitude
from simgap.diagnosis.search.selection import taken_over
from simgap.diagnosis.simulation.problem import Memo, Problem
from simgap.diagnosis.simulation.sensitivity import Direction, linearise, promised, slot_direction
from simgap.diagnosis.thresholds import BIC_GAIN, FEWEST_WINDOWS, MATTERS, MOST
from simgap.effects import EFFECTS
from simgap.errors import UserError
from simgap.notation import joined

_RAMP_ENDS = 13  # instants, evenly spread, at which a slow change may begin and end: twelfths of a record

Answer = Callable[[Record, DiagnosisSettings], tuple[Diagnosis, Explanation] | None]


def sides_apart(
    record: Record, settings: DiagnosisSettings, search: Search, found: Explanation, answer: Answer
) -> Diagnosis | None:
    """The answer for the longer side of a change, with the change among the faults of the recording.

    None where no change promises much, where a side by itself is not down to its noise, where the sides differ in no
    number or in what they name, or where one number each explains the whole: what the plant lacks may act on one side
    alone.

    Args:
        record: the data; settings: of the diagnosis.
        search, found: on the whole record, off the noise.
        answer: diagnoses a part of the record, and what was found there; None where its search ends above the noise.
    """
    if search.watch.stopped or search.reached(found):
        return None
    change = change_promised(search, found)
    if change is None:
        return None
    before, after = _cut(record, change, settings.window_s)
    if before is None or after is None or not _alike(before, after, _is_driven(search.problem, found.fit)):
        return None

    def whole(side: Record) -> tuple[Diagnosis, Explanation] | None:
        """The answer for a side that is down to its noise, each effect asked for."""
        told = answer(side, _for(side, settings))
        return told if told is not None and told[0].verdict in ("none", "attributed") else None

    longer = before.rows >= after.rows
    sides: list[tuple[Diagnosis, Explanation]] = []
    try:
        for side in (before, after) if longer else (after, before):
            told = whole(side)
            if told is None:
                return None
            sides.append(told)
    except UserError:  # a side is too short for three folds
        return None
    if any(_explains(search, found, own) for _, own in sides):
        return None
    main, other = (d for d, _ in sides)
    fault = _fault(change, record, (main, other) if longer else (other, main), "before" if longer else "after")
    if fault is None:
        return None
    changed, rows = replace(main, recording=(*main.recording, fault)), [_rows(side, "y") for side in (before, after)]
    beyond = _beyond(*rows)
    away = [name for name, moved in zip(record.measured, beyond | ~_like_size(*rows), strict=True) if moved]
    if not main.effects:
        return None if np.any(beyond) else changed
    why = f"Before the change and after it {joined(away)} moved elsewhere: what depends on that would look like it."
    return replace(changed, verdict="partial", doubts=(*main.doubts, why)) if away else changed


def _explains(search: Search, found: Explanation, own: Explanation) -> bool:
    """Whether what was found on a side explains the whole, or is not tried on it."""
    here = taken_over(search, found.fit, own)
    return here.keys != own.keys or search.reached(here)


def _is_driven(problem: Problem, at: Fit) -> bool:
    """Whether inputs make a part that matters of what is read within windows: what moves by itself may just decay."""
    still = replace(problem, u=np.zeros_like(problem.u), memo=Memo())
    made = problem.predict(at.theta, at.x0) - still.predict(at.theta, at.x0)
    shown = problem.readings - np.repeat(_means(problem), np.diff(problem.rows), axis=0)
    return float(np.sum((made / problem.sigma) ** 2)) > MATTERS**2 * float(np.sum((shown / problem.sigma) ** 2))


def _means(problem: Problem) -> Floats:
    """Mean reading of each window, (w, k)."""
    return np.asarray(np.add.reduceat(problem.readings, problem.rows[:-1]) / np.diff(problem.rows)[:, None])


def _alike(before: Record, after: Record, driven: bool) -> bool:
    """Whether both sides have inputs of like size and level, and move over like ranges if these do not drive them.

    If not, an effect that no number of the library describes acts differently in each, and the plant is the same.
    """
    u, y = ([_rows(side, name) for side in (before, after)] for name in ("u", "y"))
    alike = [np.all(_like_size(*sides)) for sides in ((u,) if driven else (u, y))]
    apart = np.abs(np.subtract(*(np.concatenate(rows).mean(axis=0) for rows in u)))
    return bool(all(alike) and np.all(apart <= np.maximum(*map(_size, u))))


def _rows(side: Record, name: str) -> list[Floats]:
    return [getattr(trace, name) for trace in side.traces]


def _size(rows: Sequence[Floats]) -> Floats:
    """Standard deviation of each column, trace by trace together."""
    return np.asarray(np.sqrt(np.mean(np.concatenate([r - r.mean(axis=0) for r in rows]) ** 2, axis=0)))


def _like_size(before: Sequence[Floats], after: Sequence[Floats]) -> Bools:
    """Columns that move alike on both sides; one at rest in both does."""
    pair = _size(before), _size(after)
    return np.asarray(MOST * np.maximum(*pair) <= np.minimum(*pair))


def _beyond(before: Sequence[Floats], after: Sequence[Floats]) -> Bools:
    """Columns of which most values of either side lie beyond all of the other's."""
    a, b = map(np.concatenate, (before, after))
    met = [np.mean((x >= y.min(axis=0)) & (x <= y.max(axis=0)), axis=0) for x, y in ((a, b), (b, a))]
    return np.asarray(np.maximum(*met) < MOST)


def _for(part: Record, settings: DiagnosisSettings) -> DiagnosisSettings:
    """The settings for a part: traces that are held out if it has some of them and others."""
    names = {trace.name for trace in part.traces}
    held = tuple(n for n in settings.held_out_traces if n in names)
    return replace(settings, held_out_traces=held if len(held) < len(names) else ())


def _cut(record: Record, change: Change, window_s: float) -> tuple[Record | None, ...]:
    """What is surely before and surely after; pieces shorter than a window are left out."""
    before, after = record.traces[: change.trace], record.traces[change.trace :]
    if change.begin != change.end:  # within a trace
        split, *later = after
        ends = split.part(split.t < change.begin), split.part(split.t > change.end)
        first, last = ([p] if len(p.t) >= MIN_SAMPLES and p.duration >= window_s else [] for p in ends)
        before, after = (*before, *first), (*last, *later)
    return tuple(replace(record, traces=side) if side else None for side in (before, after))


def _fault(change: Change, record: Record, sides: tuple[Diagnosis, Diagnosis], about: str) -> RecordingFault | None:
    """The finding in words: when, and which effects have another number; None where the sides name different ones, as
    then neither set is what the plant lacks."""
    first, second = ({(e.name, e.on): e for e in d.effects} for d in sides)
    if not (first.keys() <= second.keys() or second.keys() <= first.keys()):
        return None
    keys = [k for k in {**first, **second} if _differs(first.get(k), second.get(k), k[0])]
    if not keys:
        return None
    then, now = (joined([_said(side.get(k), k) for k in keys]) for side in (first, second))
    own, lasts = record.traces[change.trace], change.end - change.begin
    when = f"Between {change.begin:.4g} and {change.end:.4g} s of {own.name}"
    if change.begin <= own.t[0]:
        when = f"Before {own.name}{f' or in its first {lasts:.3g} s' if lasts > 0.0 else ''}"
    elif change.end >= own.t[-1]:
        when = f"In the last {lasts:.3g} s of {own.name} or after it"
    same = next(filter(None, (_by_other_names(side, keys) for side in sides)), "")
    sentence = f"{when} the plant changed: {then} before, {now} after{same}; the answer is about what came {about}."
    return PlantChanged().told("", 0.5 * (change.begin + change.end), sentence)


def _differs(a: FoundEffect | None, b: FoundEffect | None, name: str) -> bool:
    """Whether a number has intervals that do not meet; an effect that is not there is at its null."""
    first, second = (
        [(p.null, p.null) if e is None else e.parameters[p.symbol].ci95 for p in EFFECTS[name].parameters]
        for e in (a, b)
    )
    return any(x[1] < y[0] or y[1] < x[0] for x, y in zip(first, second, strict=True))


def _by_other_names(side: Diagnosis, keys: list[tuple[str, str]]) -> str:
    """What moves the plant the same way as the one effect that differs, if there is something, in brackets."""
    sets = [e.alternatives for e in side.effects if [(e.name, e.on)] == keys]
    names = [
        EFFECTS[s[0][0]].phrase(s[0][1]) for options in sets for s in options if len(s) == 1 and s[0][0] in EFFECTS
    ]
    return f" ({joined(names, 'or')} would move it the same way)" if names else ""


def _said(found: FoundEffect | None, key: tuple[str, str]) -> str:
    effect = EFFECTS[key[0]]
    return f"{effect.phrase(key[1])} as declared" if found is None else effect.describe(key[1], found.quoted)


@dataclass(frozen=True)
class Change:
    """Where it lies: in which trace and from when to when, s; before a trace where both are its start."""

    trace: int
    begin: float
    end: float


def change_promised(search: Search, found: Explanation) -> Change | None:
    """The instant from which on another value of one number promises most; None if that is not most of the excess.

    In the window that holds it the number is in between. A change that takes a sixth of the record or longer and
    promises as much is a drift, and none. Both sides have at least `FEWEST_WINDOWS` windows.
    """
    problem, at = search.problem, found.fit
    order = np.argsort(problem.windows.start)
    excess, count = at.chi2 - problem.size, len(order)
    if count < 2 * FEWEST_WINDOWS or excess <= 0.0:
        return None
    own = [slot_direction(problem, at.theta, k, search.steps[k]) for k in at.slots]
    linear = linearise(problem, at.theta, at.x0, [*own, *_others(search, found)])
    grams, gradients = linear.window_gram[order], linear.window_gradient[order]
    windows, trace = np.arange(count), problem.windows.trace[order]
    plain = [_gain(grams, gradients, len(own), j, []) for j in range(linear.gram.shape[0])]
    last, cost = count - FEWEST_WINDOWS, math.log(problem.size)  # what a number costs
    within = [(k, k + 1) for k in range(FEWEST_WINDOWS, last)]
    between = [(k, k) for k in range(FEWEST_WINDOWS, last + 1) if trace[k - 1] != trace[k]]

    def gain(j: int, steps: list[Floats | Bools]) -> float:
        return _gain(grams, gradients, len(own), j, steps) - plain[j] - cost * len(steps)

    gains = {
        (j, k, after): gain(j, [windows >= after, *([windows == k] if after > k else [])])
        for j in range(len(plain)) for k, after in (*within, *between)
    }  # fmt: skip
    (which, first, after), most = max(gains.items(), key=operator.itemgetter(1), default=((0, 0, 0), 0.0))
    if most < MOST * excess or any(gain(which, [r]) >= most for r in _ramps(count)):  # or it went slowly
        return None
    if after > first:
        least = most - max(BIC_GAIN, MATTERS**2 * most)  # what is promised is linear
        near = [(k, end) for (j, k, end), g in gains.items() if j == which and end > k and g > least]
        own_trace = [(k, end) for k, end in near if trace[k] == trace[first]]
        first, after = min(k for k, _ in own_trace), max(end for _, end in own_trace)
    return _between(problem, *(int(k) for k in order[[first - 1, first, after]]))


def _between(problem: Problem, before: int, first: int, after: int) -> Change:
    """From the end of a window to the begin of another, as far as they are in the trace of the one that it is in."""
    w, t = problem.windows, problem.t
    trace = int(w.trace[first])
    begin = float(t[w.stop[before] - 1] if w.trace[before] == trace else t[w.start[first]])
    if after == first:
        return Change(trace, begin, begin)
    inside = problem.edges[trace + 1] - 1 if w.trace[after] != trace else w.start[after]
    return Change(trace, begin, float(t[inside]))


def _others(search: Search, found: Explanation) -> list[Direction]:
    """One direction of every candidate that is not in the set and has one near its null."""
    seen, out = set(found.keys), []
    for index, (c, start) in enumerate(search.starts.items):
        if start.size != 1 or c.key in seen or c.of_recording:
            continue
        seen.add(c.key)
        amplitude = small_amplitude(search.problem, found.fit, c, start, index, search.starts)
        out.append(column(found.fit.theta, c, start, 0, amplitude))
    return out


def _gain(grams: Floats, gradients: Floats, own: int, j: int, steps: Sequence[Floats | Bools]) -> float:
    """What the first `own` coefficients and j promise, j also by itself in windows as each of the steps weighs them."""
    free, m = sorted({*range(own), j}), len(steps)
    p, ways = len(free), np.array(steps, dtype=float).reshape(m, len(grams))
    wide = np.empty((p + m, p + m))
    wide[:p, :p] = grams[:, free][:, :, free].sum(axis=0)
    wide[p:, :p] = ways @ grams[:, j, free]
    wide[:p, p:] = wide[p:, :p].T
    wide[p:, p:] = (ways * grams[:, j, j]) @ ways.T
    slope = np.concatenate([gradients[:, free].sum(axis=0), ways @ gradients[:, j]])
    return promised(wide, slope)[0]


def _ramps(count: int) -> list[Floats]:
    """Slow changes: from 0 at one window to 1 at another that is at least a sixth of the record later."""
    ends = np.linspace(0.0, count - 1.0, _RAMP_ENDS)
    at = np.arange(count, dtype=float)
    least = max((count - 1.0) / 6.0, 2.0)
    return [np.clip((at - a) / (b - a), 0.0, 1.0) for a in ends for b in ends if b - a >= least]
