"""The way from the model as declared to the answer, one effect at a time, beside what else was fitted at each step."""

from __future__ import annotations

from collections.abc import Sequence

from simgap.diagnosis.result import Key, Option, Step
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.diagnosis.simulation.supermodel import Candidate
from simgap.diagnosis.verdict.judge import chi2_dof


def steps(search: Search, empty: Explanation, answer: Explanation) -> tuple[Step, ...]:
    """The effects of the answer in the order in which each takes away most, and a last step that takes none.

    The search itself adds, drops and swaps, so its own order need not lead to its answer; the sets in between that it
    never fitted are fitted here, unless it was stopped. The other options of a step are those that it fitted there.
    """
    here, left, out = empty, list(answer.members), []
    while True:
        own = {c.key: e for c in left if (e := _with(search, here, c, answer)) is not None}
        best = min(own, key=lambda key: own[key].fit.chi2, default=None)
        tried = _tried(search, here) | own
        if tried and (best is not None or not left):
            out.append(Step(chi2_dof(search.problem, here.fit), _options(search, here, tried, best)))
        if best is None:
            return tuple(out)
        here, left = own[best], [c for c in left if c.key != best]


def _with(search: Search, here: Explanation, member: Candidate, answer: Explanation) -> Explanation | None:
    """A step with this member of the answer, from the answer's numbers; None if the search was stopped before it."""
    members = (*here.members, member)
    keys = here.keys | {member.key}
    fitted = [e for e in search.tried.values() if e.keys == keys]
    if fitted:
        return min(fitted, key=lambda e: e.fit.chi2)
    if search.watch.stopped:
        return None
    outside = [k for c in answer.members if c.key not in keys for k in c.slots]
    theta = with_values(answer.fit.theta, {k: float(search.problem.model.null[k]) for k in outside})
    return search.explain(members, theta, answer.fit)


def _tried(search: Search, here: Explanation) -> dict[Key, Explanation]:
    """What was fitted with one effect more, physical fits alone, the best fit of each."""
    found: dict[Key, Explanation] = {}
    for e in search.tried.values():
        if e.physical and len(e.members) == len(here.members) + 1 and here.keys < e.keys:
            (key,) = e.keys - here.keys
            if key not in found or e.fit.chi2 < found[key].fit.chi2:
                found[key] = e
    return found


def _options(
    search: Search, here: Explanation, tried: dict[Key, Explanation], best: Key | None
) -> tuple[Option, ...]:  # fmt: skip
    ordered: Sequence[Key] = sorted(tried, key=lambda key: (key != best, tried[key].fit.chi2))
    return tuple(
        Option(*key, chi2_dof(search.problem, tried[key].fit), here.bic - tried[key].bic, key == best)
        for key in ordered
    )
