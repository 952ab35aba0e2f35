"""What a search says of faults of the recording: pushes, velocities to be left out, noise that remembers.

A push may be none. A stop at the end of a range, a collision, a drive that saturates: what the model lacks at places
that nothing else visits looks like one. It acts from where the plant is: readings that leave the prediction while
everything is still within what *confirm* saw were not driven off by a place, a speed or a command beyond that. What
happens after they left it is the push's own doing. The data that it was cut out of count too, as they are down to the
noise, where they clearly go further; of a push in *confirm* they are that, and fitted data what *confirm* saw.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.faults.measurement import FilteredVelocity
from simgap.diagnosis.record.faults.registry import ColouredNoise, Push
from simgap.diagnosis.record.folds import Span, Windows, cut_at, merged
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, states_fitted
from simgap.diagnosis.search.noise_colour import OWN, memory_left
from simgap.diagnosis.simulation.noise_law import are_gross
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import foreseen_variance, state_columns, state_steps
from simgap.diagnosis.thresholds import A_FEW, BRIEF_S, FAR, SEVERAL
from simgap.diagnosis.verdict.sets import negligible
from simgap.notation import capitalised, few, from_to, joined

_SPAN = 0.25 * BRIEF_S  # s over which a rate is taken


def gross_spans(known: Problem, at: Fit) -> tuple[Span, ...]:
    """Times of fitted windows in which gross errors follow one another: a push, a contact, a lost signal."""
    gross = are_gross(known.residuals(at.theta, at.x0), known.spread).any(axis=1)
    t, trace = known.t[known.samples][gross], np.repeat(known.windows.trace, np.diff(known.rows))[gross]
    breaks = np.flatnonzero((np.diff(trace) != 0) | (np.diff(t) > 0.5 * known.brief)) + 1
    groups = zip(np.split(trace, breaks), np.split(t, breaks), strict=True)
    return tuple((int(own[0]), float(at[0]), float(at[-1])) for own, at in groups if len(at) >= SEVERAL)


def around(spans: Sequence[Span], problem: Problem) -> tuple[Span, ...]:
    """The times in which gross errors follow one another with what may belong to them, before and after."""
    aside = 0.25 * problem.brief
    return tuple((k, a - aside, b + aside) for k, a, b in spans)


def pushes(held: Problem, theta: Floats) -> tuple[Span, ...]:
    """Times in which gross errors follow one another in windows that nothing is fitted to; none where they last long.

    A second look cuts the windows where they begin and end, as the motion after them starts from a new state. Where
    nothing stands out then, as all of it was cut out, the first look holds.
    """
    spans: tuple[Span, ...] = ()
    for _ in range(2):
        part = replace(held.on(cut_at(held.windows, held.t, spans)), usual=held.sigma)
        spans = gross_spans(part, states_fitted(part, theta)) or spans
    w = held.windows
    whole = around(spans, held)
    few = sum(b - a for _, a, b in whole) <= A_FEW * float(np.sum(held.t[w.stop - 1] - held.t[w.start]))
    return whole if few else ()


def push_faults(spans: Sequence[Span], problem: Problem, names: Sequence[str]) -> tuple[RecordingFault, ...]:
    """What weighed nothing beside the windows of a problem, in words."""
    if not spans:
        return ()
    first, last = problem.t[problem.firsts], problem.t[problem.edges[1:] - 1]
    spans = [(k, max(a, float(first[k])), min(b, float(last[k]))) for k, a, b in sorted(spans)]
    places, lasts = [f"{from_to(a, b)} of {names[k]}" for k, a, b in spans], sum(b - a for _, a, b in spans)
    kept = float(np.sum(problem.t[problem.windows.stop - 1] - problem.t[problem.windows.start]))
    sentence = (
        f"{capitalised(joined(few(places)))} (a push?): {100 * lasts / (lasts + kept):.2g} % of the time has no "
        "weight: it stands out, and no effect that was tried explains it."
    )
    return (Push().told("", lasts, sentence),)


def filtered_channels(search: Search, found: Explanation) -> tuple[RecordingFault, ...]:
    """Velocities that were found to be filtered, by what matters, while their position is measured: they are left out
    from here on."""
    model = search.problem.model
    position = {c.velocity: c.position for c in model.model.coordinates}
    return tuple(
        c.effect.left_out(c.on, float(found.fit.theta[c.slots[0]]))
        for c in found.members
        if isinstance(c.effect, FilteredVelocity) and position[c.on] in model.measured
        if not negligible(search, found, [c])
    )


def faint_memory(problem: Problem, at: Fit) -> tuple[str, ...]:
    """Channels of which a part of the noise alone remembers: by its law, and where it has none, by what a fit misses.

    A law is sought only where more than the noise is left: a misfit that adds less than that remembers as well.
    """
    names = problem.model.measured
    if problem.colour is not None:
        return tuple(names[k] for k in np.flatnonzero(problem.colour.faint))
    return tuple(names[k] for k in memory_left(problem, at) if np.mean(problem.weight[:, k]) > OWN)


def noise_faults(problem: Problem) -> Iterable[RecordingFault]:
    """What is to be said of a noise that remembers."""
    if problem.colour is None:
        return ()
    lasts = float(problem.t[problem.windows.stop[0] - 1] - problem.t[problem.windows.start[0]])
    shared, tau = (map(float, each) for each in (problem.colour.shared, problem.colour.tau))
    return ColouredNoise().of(zip(problem.model.measured, shared, tau, strict=True), lasts)


def extrapolated(record: Record, parts: Parts, at: Fit, held: Floats) -> tuple[str, ...]:
    """Readings and inputs that are, where a time left out begins, where nothing else in the record was, by name.

    It begins until a reading leaves the prediction from the window before; where there is none, all of it counts. A
    reading counts too where it moves as fast as nowhere else: a brake may act on speed. Inputs count from as long
    before as they still act. In one piece of data everything between its least and its largest number was visited.

    Args:
        record: the data; parts: its folds, without the times left out.
        at: the answer, fitted to what is known; held: (w, nx) initial states of
            the windows that confirm, as `Parts.every` holds them.
    """
    known, confirm = parts.known, parts.confirm
    k, reach = len(record.measured), known.reach(at.theta)
    noise = np.concatenate([confirm.sigma, np.zeros(len(record.inputs)), np.sqrt(2.0) * confirm.sigma / _SPAN])
    slack, further = FAR * noise, np.zeros(len(noise), dtype=bool)
    every, states = parts.every, np.vstack([at.x0, held])
    for spans, own, others in ((parts.left_out, known, confirm), (parts.disturbed, confirm, known)):
        pairs = zip(_ranges(others, slack), _ranges(own, -slack), strict=True)
        low, high = (np.concatenate(each) for each in pairs)
        for left in spans:
            trace, begin, end = record.traces[left[0]], left[1], _leaves(every, at.theta, states, left)
            beside = _between(trace, begin - _SPAN, max(end, begin + _SPAN))
            for columns, values in (
                (slice(0, k), trace.y[_between(trace, begin, end)]),
                (slice(k, -k), trace.u[_between(trace, begin - reach, end)]),
                (slice(-k, None), _rates(trace.t[beside], trace.y[beside])),
            ):
                inside = (values[:, None] >= low[:, columns]) & (values[:, None] <= high[:, columns])
                further[columns] |= ~inside.any(axis=1).all(axis=0)  # somewhere in none of the ranges
    further[:k] |= further[-k:]
    return tuple(n for n, is_further in zip((*record.measured, *record.inputs), further, strict=False) if is_further)


def _between(trace: Trace, begin: float, end: float) -> Bools:
    return np.asarray((trace.t >= begin) & (trace.t <= end))


def _ranges(problem: Problem, slack: Floats) -> tuple[Floats, Floats]:
    """Least and largest readings, inputs and rates of each piece of data (s, 2k + m), further apart by slack."""
    low, high = [], []
    for a, b, *_ in merged(problem.windows):
        each = problem.y[a:b], problem.u[a:b], _rates(problem.t[a:b], problem.y[a:b])
        low.append(np.concatenate([np.min(x, axis=0, initial=np.inf) for x in each]) - slack)
        high.append(np.concatenate([np.max(x, axis=0, initial=-np.inf) for x in each]) + slack)
    return np.array(low), np.array(high)


def _rates(t: Floats, y: Floats) -> Floats:
    """Mean rates over about `_SPAN`: times (n,), readings (n, k) -> (n - m, k)."""
    if len(t) < 3:
        return np.zeros((0, y.shape[1]))
    m = max(2, round(_SPAN / float(np.median(np.diff(t)))))
    return np.asarray((y[m:] - y[:-m]) / (t[m:] - t[:-m])[:, None])


def _leaves(problem: Problem, theta: Floats, states: Floats, left: Span) -> float:
    """When a reading leaves what is foreseen from the window before, for good; the end of the time if none does, s.

    For good: it and the next one are `FAR` standard deviations off, of the noise and of what the noise of that
    window does to the state that it ends in.
    """
    which, begin, end = left
    w, t = problem.windows, problem.t
    before = np.flatnonzero((w.trace == which) & (t[w.stop - 1] < begin))
    if not before.size:
        return end
    own = before[np.argmax(w.stop[before])]
    a, b = int(w.start[own]), int(w.stop[own])
    until = problem.edges[which + 1]
    last = b + int(np.searchsorted(t[b:until], end, side="right"))
    if t[b] < begin or last - b < 2:  # something else lies between
        return end
    part = problem.on(Windows(*(np.array([v]) for v in (a, last, which))))
    x0 = states[own : own + 1]
    miss, moved = state_columns(part, theta, x0, state_steps(x0), Problem.misses)
    size = np.sqrt(foreseen_variance(moved[:, : b - a], moved))
    off = np.any(np.abs(miss) > FAR * size, axis=1)[b - a :]
    gone = np.flatnonzero(off[:-1] & off[1:])
    return float(t[b + gone[0]]) if gone.size else end
