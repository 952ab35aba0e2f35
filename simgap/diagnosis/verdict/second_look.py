"""What is left is held against the library once more: effects that would take away a part of it, and how much."""

from __future__ import annotations

from simgap.diagnosis.result import LeftOver, Nearest
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.recording import is_fault
from simgap.diagnosis.thresholds import FIT_QUALITY, MATTERS, NARROW
from simgap.diagnosis.verdict import answer
from simgap.diagnosis.verdict.judge import Evidence, HeldOut, chi2_dof, excess_share, judge, vanished
from simgap.model.symbolic import SymbolicModel


def second_look(
    search: Search, found: Explanation, confirm: Problem, left: HeldOut, horizon_s: float, model: SymbolicModel
) -> tuple[LeftOver, ...] | None:
    """Effects beside the chosen ones that lower what is left by `MATTERS` at least, the largest share first.

    They are fitted to what the search knows; what they would take away is judged on *confirm*, which chooses none of
    them: they are told of and not named, as the limit on the number of effects or the data spoke against them. None if
    the fitted data are down to their noise.
    """
    if chi2_dof(search.problem, found.fit) <= FIT_QUALITY:
        return None
    said = []
    for e in search.joined(found, most=NARROW):
        (added,) = (c.key for c in e.members if c.key not in found.keys)
        if is_fault(added[0]) or added in {c.key for c in vanished(search, e, False)}:
            continue
        share = 1.0 - excess_share(left, judge(confirm, e.fit.theta, horizon_s), confirm.sigma)
        if share >= MATTERS:
            told = answer.found_effects(search, e, (), chi2_dof(search.problem, e.fit), False, model)
            said += [LeftOver(f, share) for f in told if (f.name, f.on) == added]
    return tuple(sorted(said, key=lambda s: -s.share))


def nearest(
    full: Search, found: Explanation, evidence: Evidence, at_floor: bool, model: SymbolicModel
) -> Nearest | None:
    """What was put to *confirm* and is not named, with the reasons; None if it explains next to nothing."""
    share = 1.0 - evidence.share if at_floor else evidence.gain.share[0]
    if not found.members or share < MATTERS:
        return None
    reasons = (
        (not evidence.carries, "it does not surely predict better by a tenth"),
        (not evidence.agree, "halves of the data give different numbers"),
        (not found.physical, "the numbers are not physical"),
        (not found.fit.converged, "the fit had not settled"),
        (all(c.of_recording for c in found.members), "it is a fault of the recording, and more than noise is left"),
    )
    effects = answer.found_effects(full, found, (), evidence.after, at_floor, model)
    return Nearest(effects, share, tuple(reason for holds, reason in reasons if holds))
