"""Whether what was left out of the fit began where other data were that need nothing more.

A stop at the end of a range, a collision, a drive that saturates: what the model lacks at places that nothing else
visits looks like a push. It acts from where the plant is: readings that leave the prediction while everything is still
within what *confirm* saw were not driven off by a place, a speed or a command beyond that. What happens after they left
it is the push's own doing. Fitted data count too, as they are down to the noise, where they clearly go further.
"""

from __future__ import annotations

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.diagnosis.record.folds import Span, Windows, joined
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.sensitivity import state_columns, state_steps
from simgap.diagnosis.thresholds import BRIEF_S, FAR

_SPAN = 0.25 * BRIEF_S  # s over which a rate is taken


def extrapolated(record: Record, spans: tuple[Span, ...], known: Problem, at: Fit, confirm: Problem) -> tuple[str, ...]:
    """Readings and inputs that are, where a time left out begins, where nothing else in the record was, by name.

    It begins until a reading leaves the prediction from the window before; where there is none, all of it counts. A
    reading counts too where it moves as fast as nowhere else: a brake may act on speed. Inputs count from as long
    before as they still act. In one piece of data everything between its least and its largest number was visited.

    Args:
        record: the data; spans: the times left out; known: the windows without them.
        at: the answer, fitted to these; confirm: the windows that confirm.
    """
    k, reach = len(record.measured), known.reach(at.theta)
    noise = np.concatenate([confirm.sigma, np.zeros(len(record.inputs)), np.sqrt(2.0) * confirm.sigma / _SPAN])
    slack = FAR * noise
    low, high = (np.concatenate(each) for each in zip(_ranges(confirm, slack), _ranges(known, -slack), strict=True))
    further = np.zeros(len(slack), dtype=bool)
    for left in spans:
        trace, begin, end = record.traces[left[0]], left[1], _leaves(known, at, left)
        around = _between(trace, begin - _SPAN, max(end, begin + _SPAN))
        for columns, values in (
            (slice(0, k), trace.y[_between(trace, begin, end)]),
            (slice(k, -k), trace.u[_between(trace, begin - reach, end)]),
            (slice(-k, None), _rates(trace.t[around], trace.y[around])),
        ):
            further[columns] |= _outside(values, low[:, columns], high[:, columns])
    further[:k] |= further[-k:]
    return tuple(n for n, is_further in zip((*record.measured, *record.inputs), further, strict=False) if is_further)


def _between(trace: Trace, begin: float, end: float) -> Bools:
    return np.asarray((trace.t >= begin) & (trace.t <= end))


def _ranges(problem: Problem, slack: Floats) -> tuple[Floats, Floats]:
    """Least and largest readings, inputs and rates of each piece of data (s, 2k + m), further apart by slack."""
    rows = []
    for a, b, *_ in joined(problem.windows):
        rates = _rates(problem.t[a:b], problem.y[a:b])
        each = [*problem.y[a:b].T, *problem.u[a:b].T, *rates.T]
        rows.append([(np.min(c, initial=np.inf), np.max(c, initial=-np.inf)) for c in each])
    table = np.array(rows)
    return table[:, :, 0] - slack, table[:, :, 1] + slack


def _outside(own: Floats, low: Floats, high: Floats) -> Bools:
    """Which columns of own (n, c) are somewhere in none of the ranges (s, c)."""
    inside = (own[:, None] >= low) & (own[:, None] <= high)
    return np.asarray(~inside.any(axis=1).all(axis=0))


def _rates(t: Floats, y: Floats) -> Floats:
    """Mean rates over about `_SPAN`: times (n,), readings (n, k) -> (n - m, k)."""
    if len(t) < 3:
        return np.zeros((0, y.shape[1]))
    m = max(2, round(_SPAN / float(np.median(np.diff(t)))))
    return np.asarray((y[m:] - y[:-m]) / (t[m:] - t[:-m])[:, None])


def _leaves(known: Problem, at: Fit, left: Span) -> float:
    """When a reading leaves what is foreseen from the window before, for good; the end of the time if none does, s.

    For good: it and the next one are `FAR` standard deviations off, of the noise and of what the noise of that
    window does to the state that it ends in.
    """
    which, begin, end = left
    w, t = known.windows, known.t
    before = np.flatnonzero((w.trace == which) & (t[w.stop - 1] < begin))
    if not before.size:
        return end
    own = before[np.argmax(w.stop[before])]
    a, b, first = int(w.start[own]), int(w.stop[own]), int(w.first[own])
    last = b + int(np.searchsorted(t[b:][: _rest(known, first, b)], end, side="right"))
    if t[b] < begin or last - b < 2:  # something else lies between
        return end
    part = known.on(Windows(*(np.array([v]) for v in (a, last, first, which))))
    x0 = at.x0[own : own + 1]
    miss, states = state_columns(part, at.theta, x0, state_steps(x0), Problem.misses)
    fitted = states[:, : b - a].reshape(len(states), -1)
    spread = np.linalg.pinv(fitted @ fitted.T, rcond=1e-12)
    size = np.sqrt(1.0 + np.einsum("irk,ij,jrk->rk", states, spread, states))
    off = np.any(np.abs(miss) > FAR * size, axis=1)[b - a :]
    gone = np.flatnonzero(off[:-1] & off[1:])
    return float(t[b + gone[0]]) if gone.size else end


def _rest(known: Problem, first: int, b: int) -> int:
    """Samples of the trace that begins at `first` from b on."""
    later = known.firsts[known.firsts > first]
    return int(later.min(initial=len(known.t))) - b
