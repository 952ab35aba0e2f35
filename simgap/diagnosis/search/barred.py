"""Effects that a record gives no reason to try."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from simgap.diagnosis.reading.record import Record
from simgap.diagnosis.search.scoring import Key
from simgap.effects import EFFECTS
from simgap.effects.parameter_error import ParameterError
from simgap.model.symbolic import SymbolicModel
from simgap.units import full_turn


def barred(model: SymbolicModel, record: Record, named: Collection[str], known: Collection[str] = ()) -> dict[Key, str]:
    """Effects and targets that are not tried, with the reason: errors of parameters that are `known`, and springs.

    What pulls a joint back to one place pulls it to that place on every turn: on an angle that winds it would be a
    force that grows with the turns counted, which a joint has only where something winds up. It is tried if `named`.
    """
    winding = [c.name for c in model.coordinates if _winds(model, record, c.name)]
    springs = {
        (e.name, on): "the joint makes full turns: name the effect under measured.effects if something winds up on it"
        for e in EFFECTS.values()
        if e.pulls_to_a_place and e.name not in named
        for on in e.targets(model)
        if on in winding
    }
    return springs | {(ParameterError.name, on): "it is known (measured.known)" for on in known}


def _winds(model: SymbolicModel, record: Record, coordinate: str) -> bool:
    """Whether the coordinate is an angle that travels more than a full turn in a trace."""
    position = model.coordinate(coordinate).position
    turn = full_turn(next(v.unit for v in model.states if v.name == position))
    if turn is None or position not in record.measured:
        return False
    k = record.measured.index(position)
    return any(float(np.ptp(trace.y[:, k])) > abs(turn) for trace in record.traces)
