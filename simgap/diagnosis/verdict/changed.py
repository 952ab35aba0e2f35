"""Did the plant change in mid-record? From when on another value of one number would fit, by the windows' scores.

A change promises a drop of chi^2 beside the fit: one more coefficient that acts on the windows from some instant on, by
the windows' shares of gradient and Gram matrix, initial states eliminated. It is the score test for a change at an
unknown time. Source: Andrews (1993), Tests for parameter instability and structural change with unknown change point,
Econometrica 61(4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.scoring import column, small_amplitude
from simgap.diagnosis.simulation.sensitivity import Direction, linearise, slot_direction
from simgap.diagnosis.thresholds import FEWEST_WINDOWS, MOST, RAMP_ENDS


@dataclass(frozen=True)
class Change:
    """Between which windows it lies: the trace, and the span (s) from the start of the one to the end of the other."""

    trace: int
    begin: float
    end: float
    share: float


def change_promised(search: Search, found: Explanation) -> Change | None:
    """The instant from which on another value of one number promises most; None if that is not most of the excess.

    A change that takes a sixth of the record or longer and promises as much is a drift, and none. Both sides have at
    least `FEWEST_WINDOWS` windows.
    """
    problem, at = search.problem, found.fit
    w = problem.windows
    order = np.argsort(w.start)
    excess = at.chi2 - problem.size
    if len(w) < 2 * FEWEST_WINDOWS or excess <= 0.0:
        return None
    own = [slot_direction(problem, at.theta, k, search.steps[k]) for k in at.slots]
    linear = linearise(problem, at.theta, at.x0, [*own, *_others(search, found)])
    grams, gradients = linear.window_gram[order], linear.window_gradient[order]
    best, place, which = 0.0, 0, 0
    count = len(w)
    plain = [_gain(grams, gradients, len(own), j, None) for j in range(linear.gram.shape[0])]
    for j, without in enumerate(plain):
        for k in range(FEWEST_WINDOWS, count - FEWEST_WINDOWS + 1):
            gain = _gain(grams, gradients, len(own), j, (np.arange(count) >= k).astype(float)) - without
            if gain > best:
                best, place, which = gain, k, j
    if best < MOST * excess:
        return None
    if any(_gain(grams, gradients, len(own), which, r) - plain[which] >= best for r in _ramps(count)):
        return None  # it went slowly
    before, after = int(order[place - 1]), int(order[place])
    t = problem.t
    if w.trace[before] != w.trace[after]:
        edge = float(t[w.start[after]])
        return Change(int(w.trace[after]), edge, edge, best / excess)
    return Change(int(w.trace[after]), float(t[w.start[before]]), float(t[w.stop[after] - 1]), best / excess)


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


def _drop(gram: Floats, gradient: Floats) -> float:
    """What the coefficients promise together: (p, p), (p,)."""
    if not len(gradient):
        return 0.0
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return float(np.linalg.lstsq(gram / np.outer(scale, scale), gradient / scale, rcond=1e-10)[0] @ (gradient / scale))


def _gain(grams: Floats, gradients: Floats, own: int, j: int, weights: Floats | None) -> float:
    """What the first `own` coefficients and j promise, j also by itself in windows as they are weighted: (n,)."""
    free = sorted({*range(own), j})
    gram, gradient = grams[:, free][:, :, free].sum(axis=0), gradients[:, free].sum(axis=0)
    if weights is None:
        return _drop(gram, gradient)
    p = len(free)
    wide, slope = np.empty((p + 1, p + 1)), np.append(gradient, weights @ gradients[:, j])
    wide[:p, :p] = gram
    wide[:p, p] = wide[p, :p] = weights @ grams[:, free, j]
    wide[p, p] = weights**2 @ grams[:, j, j]
    return _drop(wide, slope)


def _ramps(count: int) -> list[Floats]:
    """Slow changes: from 0 at one window to 1 at another that is at least a sixth of the record later."""
    ends = np.linspace(0.0, count - 1.0, RAMP_ENDS)
    at = np.arange(count, dtype=float)
    least = max((count - 1.0) / 6.0, 2.0)
    return [np.clip((at - a) / (b - a), 0.0, 1.0) for a in ends for b in ends if b - a >= least]
