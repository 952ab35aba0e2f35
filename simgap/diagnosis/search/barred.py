"""Effects that a record gives no reason to try."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from simgap.diagnosis.record.record import Record
from simgap.diagnosis.search.scoring import Key
from simgap.effects import EFFECTS
from simgap.effects.parameter_error import ParameterError
from simgap.effects.reflected_inertia import ReflectedInertia
from simgap.model.symbolic import SymbolicModel
from simgap.units import full_turn


def barred(model: SymbolicModel, record: Record, named: Collection[str], known: Collection[str] = ()) -> dict[Key, str]:
    """Effects and targets that are not tried, with the reason: parameters that are `known`, springs, rotors.

    What pulls a joint back to one place pulls it to that place on every turn: on an angle that winds it would be a
    force that grows with the turns counted, which a joint has only where something winds up. Where nothing was
    commanded an inertia is the plant's own, and no rotor's. Both are tried if `named`.
    """
    winding = [c.name for c in model.coordinates if _winds(model, record, c.name)]
    springs = {
        (e.name, on): "the joint makes full turns: name the effect under measured.effects if something winds up on it"
        for e in EFFECTS.values()
        if e.pulls_to_a_place and e.name not in named
        for on in e.targets(model)
        if on in winding
    }
    driven = ReflectedInertia.name in named or any(trace.u.any() for trace in record.traces)
    behind = () if driven else ReflectedInertia().targets(model)
    rotors = {(ReflectedInertia.name, on): "nothing drives the plant" for on in behind}
    return springs | rotors | {(ParameterError.name, on): "it is known (measured.known)" for on in known}


def _winds(model: SymbolicModel, record: Record, coordinate: str) -> bool:
    """Whether the coordinate is an angle that travels more than a full turn in a trace."""
    position = model.coordinate(coordinate).position
    turn = full_turn(next(v.unit for v in model.states if v.name == position))
    if turn is None or position not in record.measured:
        return False
    k = record.measured.index(position)
    return any(float(np.ptp(trace.y[:, k])) > abs(turn) for trace in record.traces)
