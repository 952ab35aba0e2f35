"""What is of no practical size: real, as the data are many, and of no use to anybody."""

from __future__ import annotations

from simgap.diagnosis.result import Key
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.thresholds import NEGLIGIBLE, SLIGHT_SHARE


def negligible(search: Search, found: Explanation) -> list[Candidate]:
    """Members without which, the others fitted again, the predictions miss by next to nothing of the noise more.

    Nothing more is fitted where a search was stopped.
    """
    if search.watch.stopped:
        return []
    bar = NEGLIGIBLE**2 * search.problem.size
    return [c for c in found.members if search.without(found, c).fit.chi2 - found.fit.chi2 < bar]


def slight(search: Search, found: Explanation, base: Fit) -> frozenset[Key]:
    """Faults of the recording that account for next to nothing of what the declared model misses.

    They stay fitted, as the noise is smaller still.
    """
    least = SLIGHT_SHARE * (base.chi2 - found.fit.chi2)
    faults = [c for c in found.members if c.of_recording]
    return frozenset(c.key for c in faults if search.without(found, c).fit.chi2 - found.fit.chi2 < least)
