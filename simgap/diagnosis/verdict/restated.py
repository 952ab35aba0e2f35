"""The same motion under the name of another effect: sets that no data can tell from what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from simgap.diagnosis.result import Alternative, FoundEffect
from simgap.effects import EFFECTS, AppliedEffect
from simgap.effects.sensor_gain import LINEAR, is_linear
from simgap.model.symbolic import SymbolicModel


def restated(
    model: SymbolicModel, found: Sequence[AppliedEffect], measured: Sequence[str]
) -> list[tuple[Alternative, frozenset[int]]]:
    """Sets in which one effect of the library stands for some of those found, exactly; with the places of these."""
    out = []
    for e in EFFECTS.values():
        for on in e.targets(model):
            same = e.restates(model, on, found, measured)
            if same is not None:
                kept = tuple(a for k, a in enumerate(found) if k not in same[0])
                whole = (*kept, AppliedEffect(e.name, on, same[1]))
                out.append((Alternative(whole, 0.0, True), same[0]))
    return out + _by_the_sensors(model, found, measured)


def _by_the_sensors(
    model: SymbolicModel, found: Sequence[AppliedEffect], measured: Sequence[str]
) -> list[tuple[Alternative, frozenset[int]]]:
    """Readings that are all as late as the only input was found to act; or a sensor that is as slow, of a linear plant.

    Whether a command or a reading is under way for so long, no record of these channels tells; in a closed loop both
    act alike.
    """
    if len(model.inputs) != 1:
        return []
    out = []
    for k, a in enumerate(found):
        kept = tuple(b for b in found if b is not a)
        late: tuple[AppliedEffect, ...] = ()
        if a.name == "input_delay" and not any(b.name == "late_reading" for b in kept):
            late = tuple(AppliedEffect("late_reading", on, {"late": a.values["delay"]}) for on in measured)
        elif a.name == "input_lag" and len(measured) == 1 and {b.name for b in kept} <= LINEAR and is_linear(model):
            late = (AppliedEffect("filtered_reading", measured[0], {"lag": a.values["T"]}),)
        if late:
            out.append((Alternative((*kept, *late), 0.0, True), frozenset({k})))
    return out


def told(
    effects: Sequence[FoundEffect], alternatives: Sequence[Alternative], model: SymbolicModel,
    found: Sequence[AppliedEffect], measured: Sequence[str],
) -> tuple[tuple[FoundEffect, ...], tuple[Alternative, ...]]:  # fmt: skip
    """The effects and the alternatives with what restates them, each set once."""
    known = [frozenset((a.name, a.on) for a in other.effects) for other in alternatives]
    listed, changed = list(alternatives), list(effects)
    for other, places in restated(model, found, measured):
        if frozenset((a.name, a.on) for a in other.effects) in known:
            continue
        listed.append(other)
        new = tuple((a.name, a.on) for a in other.effects if a not in found)
        for k in places:
            changed[k] = replace(changed[k], alternatives=(*changed[k].alternatives, new))
    return tuple(changed), tuple(listed)
