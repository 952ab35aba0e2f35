"""A plant that changed in mid-record: the times before and after are diagnosed apart, and what differs is told."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.faults.measurement import is_fault
from simgap.diagnosis.record.faults.registry import PlantChanged
from simgap.diagnosis.record.folds import Windows
from simgap.diagnosis.record.record import MIN_SAMPLES, Record
from simgap.diagnosis.result import Diagnosis, FoundEffect, RecordingFault
from simgap.diagnosis.search.equivalence import rivals
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.search.scoring import column, small_amplitude
from simgap.diagnosis.search.selection import taken_over
from simgap.diagnosis.seek import Hypothesis
from simgap.diagnosis.simulation.problem import Memo, Problem
from simgap.diagnosis.simulation.sensitivity import Direction, linearise, promised, slot_direction
from simgap.diagnosis.thresholds import BIC_GAIN, FEWEST_WINDOWS, MATTERS, MOST, SEVERAL
from simgap.diagnosis.verdict.answer import found_effects
from simgap.effects import EFFECTS, EffectParameter
from simgap.notation import joined

_RAMP_ENDS = 13  # instants, evenly spread, at which a slow change may begin and end: twelfths of a record

Answer = Callable[[Record], tuple[Diagnosis, Hypothesis] | None]


def sides_apart(record: Record, plain: Problem, whole: Hypothesis, answer: Answer) -> Diagnosis | None:
    """The answer for the longer side of a change, with the change among the faults of the recording.

    The shorter side has to come down to its noise with another value of one effect, or else by an answer of its own.
    None where no change promises much, where a side does not come down to its noise, where they differ in no number,
    or where one number each explains the whole: what the plant lacks may act on one side alone.

    Args:
        record: the data; plain: the same as a problem, of which nothing was left out.
        whole: what was found on all of it.
        answer: diagnoses a part of the record, and what was found there; None where that is not the whole of it.
    """
    change = None if whole.reached else change_promised(whole.search, whole.found)
    if change is None:
        return None
    sides = change.cut(record, whole.parts.window_s)
    if sides is None or not _alike(*sides, _is_driven(whole.search.problem, whole.found.fit)):
        return None
    longer = int(sides[1].rows > sides[0].rows)
    main, shorter = answer(sides[longer]), change.windows(plain)[1 - longer]
    if main is None:
        return None
    diagnosis, under = main
    other = _with_one_other(under.read_on(plain.on(shorter)), diagnosis.effects)
    if other is None and len(shorter) >= FEWEST_WINDOWS:
        own = answer(sides[1 - longer])
        other = None if own is None else (own[0].effects, own[1].found)
    if other is None or any(_explains(whole, found) for found in (under.found, other[1])):
        return None
    effects = [diagnosis.effects, other[0]]
    fault = _fault(change, record, effects[:: -1 if longer else 1], ("before", "after")[longer])
    return None if fault is None else _told(diagnosis, fault, record.measured, sides)


def _with_one_other(
    side: Hypothesis, elsewhere: Sequence[FoundEffect]
) -> tuple[tuple[FoundEffect, ...], Explanation] | None:
    """What was found elsewhere, with one number beside it if need be, where it is down to the noise here and one effect
    is another: more of them bend to whatever acted on a short side."""
    search, found = side.search, side.found
    if not side.reached:
        wider = search.joined(found) if len(found.members) < side.most else []
        more = [e for e in wider if e.count == found.count + 1 and search.reached(e)]
        if not more:
            return None
        found = min(more, key=lambda e: e.bic)
    effects = found_effects(search, found, rivals(search, found), True)
    own = tuple(e for e in effects if not is_fault(e.name))
    return (own, found) if len(_differing(elsewhere, own)) == 1 else None


def _explains(whole: Hypothesis, own: Explanation) -> bool:
    """Whether what was found on a side explains the whole, or is not tried on it."""
    here = taken_over(whole.search, whole.found.fit, own)
    return here.keys != own.keys or whole.search.reached(here)


def _told(
    main: Diagnosis, fault: RecordingFault, measured: Sequence[str], sides: tuple[Record, Record]
) -> Diagnosis | None:
    """The answer for a side with the change, at most `partial` where readings moved elsewhere on the other."""
    rows = [_rows(side, "y") for side in sides]
    beyond, told = _beyond(*rows), replace(main, recording=(*main.recording, fault))
    away = [name for name, moved in zip(measured, beyond | ~_like_size(*rows), strict=True) if moved]
    if not main.effects:
        return None if np.any(beyond) else told
    why = f"Before the change and after it {joined(away)} moved elsewhere: what depends on that would look like it."
    return replace(told, verdict="partial", doubts=(*main.doubts, why)) if away else told


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


def _fault(change: Change, record: Record, sides: Sequence[Sequence[FoundEffect]], about: str) -> RecordingFault | None:
    """The finding in words: when, and which effects have another number; None where the sides name different ones, as
    then neither set is what the plant lacks."""
    first, second = ({(e.name, e.on): e for e in side} for side in sides)
    keys = _differing(*sides)
    if not keys or not (first.keys() <= second.keys() or second.keys() <= first.keys()):
        return None
    then, now = (joined([_said(side.get(k), k) for k in keys]) for side in (first, second))
    own, lasts = record.traces[change.trace], change.end - change.begin
    when = f"Between {change.begin:.4g} and {change.end:.4g} s of {own.name}"
    if change.begin <= own.t[0]:
        when = f"Before {own.name}{f' or in its first {lasts:.3g} s' if lasts > 0.0 else ''}"
    elif change.end >= own.t[-1]:
        when = f"In the last {lasts:.3g} s of {own.name} or after it"
    same = next(filter(None, (_by_other_names(side, keys) for side in sides)), "")
    what = "a sensor" if all(EFFECTS[name].kind == "state" for name, _ in keys) else "the plant"
    sentence = f"{when} {what} changed: {then} before, {now} after{same}; the answer is about what came {about}."
    return PlantChanged().told("", 0.5 * (change.begin + change.end), sentence)


def _differing(first: Sequence[FoundEffect], second: Sequence[FoundEffect]) -> list[tuple[str, str]]:
    """Effects with another number on the other side."""
    a, b = ({(e.name, e.on): e for e in side} for side in (first, second))
    return [k for k in {**a, **b} if _differs(a.get(k), b.get(k), k[0])]


def _differs(a: FoundEffect | None, b: FoundEffect | None, name: str) -> bool:
    """Whether a number has intervals that do not meet; an effect that is not there is at its null."""

    def apart(p: EffectParameter) -> bool:
        (lo, hi), (low, high) = ((p.null, p.null) if e is None else e.parameters[p.symbol].ci95 for e in (a, b))
        turns = 2.0 * math.pi * round((low + high - lo - hi) / (4.0 * math.pi)) if p.unit == "rad" else 0.0
        return hi < low - turns or high - turns < lo

    return any(map(apart, EFFECTS[name].parameters))


def _by_other_names(side: Sequence[FoundEffect], keys: list[tuple[str, str]]) -> str:
    """What moves the plant the same way as the one effect that differs, if there is something, in brackets."""
    sets = [e.alternatives for e in side if [(e.name, e.on)] == keys]
    names = [
        EFFECTS[s[0][0]].phrase(s[0][1]) for options in sets for s in options if len(s) == 1 and s[0][0] in EFFECTS
    ]
    return f" ({joined(names, 'or')} would move it the same way)" if names else ""


def _said(found: FoundEffect | None, key: tuple[str, str]) -> str:
    effect = EFFECTS[key[0]]
    if found is None or not _differs(found, None, key[0]):
        return f"{effect.phrase(key[1])} as declared"
    return effect.describe(key[1], found.quoted)


@dataclass(frozen=True)
class Change:
    """Where it lies: in which trace and from when to when, s; before a trace where both are its start."""

    trace: int
    begin: float
    end: float

    def cut(self, record: Record, window_s: float) -> tuple[Record, Record] | None:
        """What is surely before and surely after, without pieces shorter than a window; None if nothing is left."""
        before, after = record.traces[: self.trace], record.traces[self.trace :]
        if self.begin != self.end:  # within a trace
            split, *later = after
            ends = split.part(split.t < self.begin), split.part(split.t > self.end)
            first, last = ([p] if len(p.t) >= MIN_SAMPLES and p.duration >= window_s else [] for p in ends)
            before, after = (*before, *first), (*last, *later)
        return (replace(record, traces=before), replace(record, traces=after)) if before and after else None

    def windows(self, problem: Problem) -> tuple[Windows, Windows]:
        """The windows before and after."""
        w, own = problem.windows, problem.windows.trace == self.trace
        middle = 0.5 * (problem.t[w.start] + problem.t[w.stop - 1])  # their ends may lie within a block of samples
        inside = own & (self.begin < self.end)
        before = (w.trace < self.trace) | (inside & (middle < self.begin))
        return w.pick(before), w.pick((w.trace >= self.trace) & ~(inside & (middle < self.end)))


def change_promised(search: Search, found: Explanation) -> Change | None:
    """The instant from which on another value of one number promises most; None if that is not most of the excess.

    In the window that holds it the number is in between. A change that takes a sixth of the record or longer and
    promises as much is a drift, and none; one of which that window alone has most is a push. With it both sides have
    `SEVERAL` windows.
    """
    problem, at = search.problem, found.fit
    order = np.argsort(problem.windows.start)
    excess, count = at.chi2 - problem.size, len(order)
    if count < SEVERAL or excess <= 0.0:
        return None
    own = [slot_direction(problem, at.theta, k, search.steps[k]) for k in at.slots]
    linear = linearise(problem, at.theta, at.x0, [*own, *_others(search, found)])
    grams, gradients = linear.window_gram[order], linear.window_gradient[order]
    windows, trace = np.arange(count), problem.windows.trace[order]
    plain = [_gain(grams, gradients, len(own), j, []) for j in range(linear.gram.shape[0])]
    cost = math.log(problem.size)  # of a number
    within = [(k, k + 1) for k in range(1, count - 1)]
    between = [(k, k) for k in range(1, count) if trace[k - 1] != trace[k]]

    def gain(j: int, steps: list[Floats | Bools]) -> float:
        return _gain(grams, gradients, len(own), j, steps) - plain[j] - cost * len(steps)

    gains = {
        (j, k, after): gain(j, [windows >= after, *([windows == k] if after > k else [])])
        for j in range(len(plain)) for k, after in (*within, *between)
    }  # fmt: skip
    seen = {at: g for at, g in gains.items() if min(at[2], count - at[1]) >= SEVERAL}
    (which, first, after), most = max(seen.items(), key=operator.itemgetter(1), default=((0, 0, 0), 0.0))
    least = most - max(BIC_GAIN, MATTERS**2 * most)  # what is promised is linear
    if most < MOST * excess or max(gains.values()) - most > most - least:
        return None
    if any(gain(which, [r]) >= most for r in _ramps(count)) or gain(which, [windows == first]) > MOST * most:
        return None  # it went slowly, or one window alone has another value
    if after > first:
        near = [k for (j, k, end), g in seen.items() if j == which and end > k and g > least]
        holding = [k for k in near if trace[k] == trace[first]]
        first, after = min(holding), max(holding) + 1
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
