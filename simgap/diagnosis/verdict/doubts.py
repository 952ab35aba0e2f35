"""Why an answer that explains the data down to their noise may yet be another one: said, and never `attributed`."""

from __future__ import annotations

from collections.abc import Sequence

from simgap.diagnosis.search.equivalence import Rival
from simgap.diagnosis.search.explanations import Explanation
from simgap.diagnosis.search.scoring import places
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import AS_GOOD, BIC_GAIN
from simgap.diagnosis.verdict import answer
from simgap.notation import joined


def doubts(others: Sequence[Rival], found: Explanation, problem: Problem, kept: Explanation) -> tuple[str, ...]:
    """What is to be said, the strongest reason alone; empty if there is none.

    Args:
        others, found: what explains the data as well, and the answer, as the search compared them.
        problem, kept: everything that was fitted in the end, and the answer fitted to it.
    """
    return better(others, found) or contested(others, found) or doubted(problem, kept)


def better(others: Sequence[Rival], found: Explanation) -> tuple[str, ...]:
    """What is to be said of a listed set that fits clearly better than the answer."""
    best = min((r.explanation for r in others), key=lambda e: e.bic, default=found)
    if found.bic - best.bic < BIC_GAIN:
        return ()
    named = joined([c.effect.phrase(c.on) for c in best.members])
    return (
        f"Among the alternatives {named} fits better (BIC lower by {found.bic - best.bic:.0f}), but did not carry over "
        "to the data that choose as well, or was found after they chose.",
    )


def contested(others: Sequence[Rival], found: Explanation) -> tuple[str, ...]:
    """What is to be said of a listed set that fits as well and is not the same thing: neither is sure.

    A fault of the readings in the place of an effect is told beside it and does not contest it.
    """
    close = [
        r.explanation for r in others
        if not r.exact and r.explanation.bic <= found.bic + AS_GOOD
        and not any(c.of_recording for c in r.explanation.members if c.key not in found.keys)
    ]  # fmt: skip
    if not close:
        return ()
    best = min(close, key=lambda e: e.bic)
    named = joined([c.effect.phrase(c.on) for c in best.members])
    return (
        f"Among the alternatives {named} fits as well (BIC {best.bic - found.bic:+.1f}): these data do not decide.",
    )


def doubted(problem: Problem, kept: Explanation) -> tuple[str, ...]:
    """What is to be said of effects that may be something else wherever the record was."""
    doubts = [
        (c, c.effect.doubt(answer.parameter_values(c, kept.fit), places(problem, c.on)))
        for c in kept.members if c.effect.kind == "coordinate"
    ]  # fmt: skip
    return tuple(f"Of {c.effect.phrase(c.on)}: {why}." for c, why in doubts if why)
