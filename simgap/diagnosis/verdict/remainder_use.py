"""Whether what no effect explains goes into the bound of the gap, and why not where it does not."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from simgap.diagnosis.verdict.near_rest import NearRest
from simgap.diagnosis.verdict.remainder import Remainder


@dataclass(frozen=True)
class RemainderUse:
    """What is done with the remainder.

    Attributes:
        bounded: whether the corrected case adds it to its gamma; reason: why, or why not.
        by: state -> how far gamma moves outward; empty if it does not.
        near_rest: where it moves further; None: nowhere.
    """

    bounded: bool
    reason: str
    by: Mapping[str, float]
    near_rest: NearRest | None = None


def use_of(remainder: Remainder | None, verdict: str, rig: str, has_gap: bool, has_hidden_state: bool) -> RemainderUse:
    """Decide what the corrected case does with the remainder.

    Args:
        remainder: one-step bounds; None if nothing was held out.
        verdict: of the diagnosis.
        rig: 'hardware' or 'simulator', what the recordings are of.
        has_gap, has_hidden_state: whether the case has these sections; the bound of a robot with memory adds nothing.
    """
    finite = {s: v for s, v in remainder.after.items() if math.isfinite(v)} if remainder is not None else {}
    obstacles = (
        (verdict != "partial", "a remainder is added for the verdict 'partial' alone"),
        (rig == "simulator", "the recordings are of the case's own simulator, whose gap is measured there"),
        (has_hidden_state, "the bound of a simulator with hidden state does not take measured remainders in"),
        (not has_gap, "the case has no `gap:` section"),
        (not finite, "too few transitions were held out"),
    )
    for stands, reason in obstacles:
        if stands:
            return RemainderUse(False, reason, {})
    near_rest = remainder.rest_after if remainder is not None else None
    return RemainderUse(True, "the corrected case adds it to gamma (gap.remainder)", finite, near_rest)
