"""How much of the recordings lies where the case bounds no gap: outside its X and U."""

from __future__ import annotations

import numpy as np

from simgap.diagnosis.reading.record import Record
from simgap.notation import number
from simgap.stages.context import Context

ROUNDED = 1e-6
"""A number that was logged in single precision is as far off, over its size."""


def outside(context: Context, record: Record) -> str | None:
    """A sentence about readings and commands outside X and between no ends of U; None if there are none, or no bound.

    States that wrap around are never outside.
    """
    case = context.case
    if case.domain is None or case.gap is None or not record.rows:
        return None
    values = {name: [trace.y[:, k] for trace in record.traces] for k, name in enumerate(record.measured)}
    values |= {name: [trace.u[:, record.inputs.index(name)] for trace in record.traces] for name in context.inputs}
    ends = {name: case.domain.X[name] for name in context.states if name not in case.domain.periodic}
    ends |= {name: (float(u.min()), float(u.max())) for name in context.inputs for u in [case.domain.U[name].list()]}
    beyond, any_of = [], np.zeros(record.rows, dtype=bool)
    for name, (lo, hi) in ends.items():
        if name not in values:
            continue
        own = np.concatenate(values[name])
        slack = ROUNDED * max(hi - lo, abs(lo), abs(hi))
        out = (own < lo - slack) | (own > hi + slack)
        any_of |= out
        if out.any():
            where, unit = ("X" if name in context.states else "U"), context.units[name]
            far = float(own[np.argmax(np.maximum(lo - own, own - hi))])
            beyond.append(f"{name} reaches {number(far, 3)} {unit}, {where} [{number(lo, 3)}, {number(hi, 3)}]")
    if not beyond:
        return None
    share = 100.0 * float(any_of.mean())
    return (
        f"{number(share, 2)} % of the samples lie outside the case's X and U, where its bound of the gap says nothing: "
        f"{'; '.join(beyond)}."
    )
