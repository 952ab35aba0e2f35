"""Whether what was left out of the fit lies where the data that confirm were.

A stop at the end of a range, a collision, a drive that saturates: what the model lacks at places that *confirm* never
visits looks like a push. Held-out data that were there and need nothing more are what tells it from one.
"""

from __future__ import annotations

import numpy as np

from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import WITHIN_NOISE


def beyond(record: Record, confirm: Problem) -> tuple[str, ...]:
    """Readings and inputs that go further in the times left out than anywhere in *confirm*, by name."""
    inside = confirm.samples
    names = (*record.measured, *record.inputs)
    seen = np.column_stack([confirm.y, confirm.u])[inside]
    slack = np.concatenate([WITHIN_NOISE * confirm.sigma, np.zeros(len(record.inputs))])
    low, high = np.nanmin(seen, axis=0) - slack, np.nanmax(seen, axis=0) + slack
    further = np.zeros(len(names), dtype=bool)
    for k, begin, end in record.left_out:
        trace = record.traces[k]
        rows = (trace.t >= begin) & (trace.t <= end)
        own = np.column_stack([trace.y, trace.u])[rows]
        further |= np.any((own < low) | (own > high), axis=0)
    return tuple(name for name, is_further in zip(names, further, strict=True) if is_further)
