"""The same motion under the name of another effect: sets that no data can tell from what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from simgap.diagnosis.result import Alternative, FoundEffect
from simgap.effects import EFFECTS, AppliedEffect
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
        new = other.effects[-1]
        for k in places:
            changed[k] = replace(changed[k], alternatives=(*changed[k].alternatives, ((new.name, new.on),)))
    return tuple(changed), tuple(listed)
