"""What is left of a set when the effects go on whose numbers halves of the data disagree."""

from __future__ import annotations

from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import FIT_QUALITY
from simgap.diagnosis.verdict.judge import chi2_dof, folds_agree


def steadier(known: Problem, search: Search, found: Explanation) -> Explanation | None:
    """The best smaller set that still reaches the noise and on which halves agree; None if there is none.

    An effect that BIC adds for a small misfit (a drift of a position, where dry friction creeps before it slides) must
    not take a right and steady one with it. One effect goes at a time, the one that BIC misses least.
    """
    while len(found.members) > 1:
        smaller = [search.without(found, c) for c in found.members]
        near = sorted((e for e in smaller if e.physical and chi2_dof(known, e.fit) <= FIT_QUALITY), key=lambda e: e.bic)
        for e in near:
            if folds_agree(known, e, search.steps, 1.0):
                return e
        if not near:
            return None
        found = near[0]
    return None
