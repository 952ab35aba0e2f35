"""Effects that a record gives no reason to try."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.search.scoring import Key
from simgap.diagnosis.simulation.supermodel import SuperModel
from simgap.units import full_turn


def barred(model: SuperModel, record: Record, named: Collection[str]) -> dict[Key, str]:
    """Candidates that are not tried, with the reason.

    What pulls a joint back to one place pulls it to that place on every turn: on an angle that winds it would be a
    force that grows with the turns counted, which a joint has only where something winds up. It is tried if `named`.
    """
    return {
        c.key: "the joint makes full turns: name the effect under measured.effects if something winds up on it"
        for c in model.candidates
        if c.effect.pulls_to_a_place and c.effect.name not in named and _winds(model, record, c.on)
    }


def _winds(model: SuperModel, record: Record, coordinate: str) -> bool:
    """Whether the coordinate is an angle that travels more than a full turn in a trace."""
    position = model.model.coordinate(coordinate).position
    turn = full_turn(next(v.unit for v in model.model.states if v.name == position))
    if turn is None or position not in record.measured:
        return False
    k = record.measured.index(position)
    return any(float(np.ptp(trace.y[:, k])) > abs(turn) for trace in record.traces)
