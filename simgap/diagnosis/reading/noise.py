"""A model-free noise floor for each channel: what is left of the data where no smooth motion can be."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.reading.record import Record

ORDER = 6
_BLOCK = 50_000  # rows at a time: memory stays small for long records


def difference_weights(t: Floats, order: int = ORDER) -> Floats:
    """Weights of the divided differences over true times, scaled to unit length: (n,) -> (n - order, order + 1).

    A row is orthogonal to every polynomial below `order` at its stamps. For even spacing it is the binomial difference
    over sqrt(C(2 order, order)), sqrt(924) for the sixth.
    """
    stamps = np.lib.stride_tricks.sliding_window_view(t, order + 1)
    scale = (stamps[:, -1] - stamps[:, 0])[:, None] / order
    gaps = (stamps[:, :, None] - stamps[:, None, :]) / scale[:, :, None] + np.eye(order + 1)
    weights = 1.0 / np.prod(gaps, axis=2)
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


def noise_floor(record: Record) -> Floats:
    """Standard deviation of white noise on each measured channel, (k,), in the channel's unit.

    sigma^2 is the mean square of the sixth difference of unit weight (for even spacing mean((6th difference)^2) / 924):
    a motion that is smooth over seven samples drops out. Coloured or quantised noise is not seen in full.
    Readings that are no measurement are not used.
    """
    total, count = np.zeros(len(record.measured)), np.zeros(len(record.measured))
    for trace in record.traces:
        if len(trace.t) <= ORDER:
            continue
        for a in range(0, len(trace.t) - ORDER, _BLOCK):
            part = slice(a, min(a + _BLOCK + ORDER, len(trace.t)))
            weights = difference_weights(trace.t[part])
            views = np.lib.stride_tricks.sliding_window_view(trace.y[part], ORDER + 1, axis=0)  # (rows, k, 7)
            used = np.lib.stride_tricks.sliding_window_view(trace.compared[part], ORDER + 1, axis=0).all(axis=2)
            total += (used * np.square(np.einsum("rkj,rj->rk", views, weights))).sum(axis=0)
            count += used.sum(axis=0)
    spread = np.sqrt(np.mean([np.var(trace.y, axis=0) for trace in record.traces], axis=0))
    floor = 1e-7 * np.maximum(spread, 1e-12)  # data without noise: below the accuracy of the simulation
    return np.maximum(np.sqrt(total / np.maximum(count, 1.0)), floor)
