"""Whether what was left out of the fit lies where the data that confirm were.

A stop at the end of a range, a collision, a drive that saturates: what the model lacks at places that *confirm* never
visits looks like a push. Held-out data that were there and need nothing more are what tells it from one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import CELL_S, WITHIN_NOISE

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def beyond(record: Record, confirm: Problem) -> tuple[str, ...]:
    """Readings and inputs that go further in the times left out than anywhere in *confirm*, by name.

    A reading counts too where it came there faster than *confirm* ever moves: a brake may act on speed. What it does
    after that is the push's own doing.
    """
    inside = confirm.samples
    names = (*record.measured, *record.inputs)
    seen = np.column_stack([confirm.y, confirm.u])[inside]
    slack = np.concatenate([WITHIN_NOISE * confirm.sigma, np.zeros(len(record.inputs))])
    span, ends = 0.5 * CELL_S, zip(confirm.windows.start, confirm.windows.stop, strict=True)
    moved = np.concatenate([_rates(confirm.t[a:b], confirm.y[a:b], span) for a, b in ends])
    blur = WITHIN_NOISE * np.sqrt(2.0) * confirm.sigma / span
    further = np.zeros(len(names), dtype=bool)
    for k, begin, end in record.left_out:
        trace = record.traces[k]
        rows = (trace.t >= begin) & (trace.t <= end)
        further |= _outside(np.column_stack([trace.y, trace.u])[rows], seen, slack)
        rows = (trace.t >= begin - span) & (trace.t <= begin + span)
        further[: len(record.measured)] |= _outside(_rates(trace.t[rows], trace.y[rows], span), moved, blur)
    return tuple(name for name, is_further in zip(names, further, strict=True) if is_further)


def _rates(t: Floats, y: Floats, span: float) -> Floats:
    """Mean rates over about `span` s: times (n,), readings (n, k) -> (n - m, k)."""
    if len(t) < 3:
        return np.zeros((0, y.shape[1]))
    m = max(2, round(span / float(np.median(np.diff(t)))))
    return np.asarray((y[m:] - y[:-m]) / (t[m:] - t[:-m])[:, None])


def _outside(own: Floats, seen: Floats, slack: Floats) -> Bools:
    """Which columns of own (n, k) leave the range of seen (m, k) by more than slack (k,)."""
    if not len(seen):
        return np.zeros(own.shape[1], dtype=bool)
    low, high = np.nanmin(seen, axis=0) - slack, np.nanmax(seen, axis=0) + slack
    return np.asarray(np.any((own < low) | (own > high), axis=0))
