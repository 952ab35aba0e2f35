"""A push in the data that are fitted: where one may be, and whether what was found without it bears that out.

Where it may be is left out of the windows before the search. What the search then finds is put to all of the fitted
data once more: a time that no longer stands out, or that an effect of the library explains, is put back.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.parts_of import parts_of
from simgap.diagnosis.record.faults.noise import Push
from simgap.diagnosis.record.folds import Span, Windows
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import DiagnosisSettings, Key, RecordingFault
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit, fit
from simgap.diagnosis.search.outlying import Pieces, pieces
from simgap.diagnosis.search.scoring import list_starts
from simgap.diagnosis.search.watch import Stopped, Watch
from simgap.diagnosis.seek import looked_again
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import Parts
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.refit import refit_from_all, window_chi2
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.diagnosis.thresholds import BIC_GAIN, FIT_QUALITY, MATTERS, NARROW, WIDTH
from simgap.diagnosis.verdict.judge import chi2_dof
from simgap.model.symbolic import SymbolicModel
from simgap.notation import joined


def _pieces(known: Problem, theta: Floats) -> Pieces:
    """Pieces of the fitted windows at theta (q,), every one of them looked at.

    Where commands from before a trace or from after it would act, nothing can be said.
    """
    seen = known.past_the_unknown(known.reach(theta)).before_the_end(known.ahead(theta))
    return pieces(coarse(seen, rows=seen.windows.samples), theta)


def stands_out(known: Problem, theta: Floats) -> tuple[Span, ...]:
    """Times of the fitted windows that stand out at theta (q,)."""
    found = _pieces(known, theta).outlying()
    return () if found is None else found.spans


def one_is_enough(begun: Search, base: Fit) -> bool:
    """Whether a single effect explains the record down to its noise: then nobody pushed."""

    def look() -> bool | None:
        return any(begun.reached(e) for e in begun.joined(begun.empty(base))) or None

    return bool(looked_again(begun.watch, look))


def suspected(parts: Parts, begun: Search, base: Fit, not_tried: Collection[Key], most: int) -> tuple[Span, ...]:
    """Times that stand out under what explains the rest best.

    What a model misses all the time hides where a push begins and ends, and a push hides what the model misses: one
    effect after the other, at most `most`, is fitted, the next ones without the times that stand out under those
    before, or that miss most. Effects of several numbers are not asked: they bend to a push. As far as the budget goes.

    Args:
        parts: the folds; begun, base: the search on them as it begins, and the model as declared.
        not_tried: what is not to be fitted; most: effects.
    """
    several = {c.key for c in begun.problem.model.candidates if len(c.slots) > 1}
    found = begun.empty(base)
    spans: tuple[Span, ...] = ()
    try:
        for _ in range(most + 1):
            seen = _pieces(parts.known, found.fit.theta)
            out = seen.outlying()
            spans = () if out is None else out.spans
            if begun.watch.stopped:
                break
            aside = spans or (seen.worst() if found.members else ())
            search, at = begun, base  # which takes the first step anyhow, and keeps what it fits
            if aside:
                kept = coarse(parts.leaving_out(aside).known)
                search = Search(kept, list_starts(kept, not_tried), watch=Watch(begun.watch.left))
                at = fit(kept, kept.model.null, initial_states(kept), [], {})
            found = search.explain(found.members, found.fit.theta, at) if found.members else search.empty(at)
            better = min(search.joined(found, {*found.keys, *several}, NARROW), key=lambda e: e.bic, default=found)
            if better.bic >= found.bic - BIC_GAIN:
                break
            found = better
    except Stopped:
        pass
    except KeyboardInterrupt:
        begun.watch.interrupted()
    return spans


def left_out_by(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, known: Problem, search: Search,
    found: Explanation, sought: bool,
) -> tuple[Span, ...]:  # fmt: skip
    """What is to be left out by what was found: of the times that were, those that bear it out; else what stands out.

    Args:
        model, record, settings: of the diagnosis; known: the windows that are fitted.
        search, found: on them; sought: whether times that stand out only now count.
    """
    if record.left_out:
        return _borne_out(model, record, settings, search, found)
    if not sought or search.watch.stopped or chi2_dof(search.problem, found.fit) <= FIT_QUALITY:
        return ()
    return stands_out(known, found.fit.theta)


def _borne_out(
    model: SymbolicModel, record: Record, settings: DiagnosisSettings, search: Search, found: Explanation
) -> tuple[Span, ...]:
    """Which of the times left out still stand out under what was found; none where an effect explains them."""
    parts, _ = parts_of(model, replace(record, left_out=()), settings, second=not settings.effects)
    members = tuple(parts.known.model.find(*c.key) for c in found.members)
    values = {
        new: float(found.fit.theta[old])
        for c, m in zip(found.members, members, strict=True) for old, new in zip(c.slots, m.slots, strict=True)
    }  # fmt: skip
    theta = with_values(parts.known.model.null, values)
    again = stands_out(parts.known, theta)
    still = tuple(s for s in record.left_out if any(_meet(s, other) for other in again))
    if not still:
        return ()
    whole = parts.known.past_the_unknown(parts.known.reach(theta))
    some = whole.on(_around(whole.windows, whole.t, still))
    level = max(1.0, chi2_dof(search.problem, found.fit))
    return still if excess_left(coarse(some), theta, level, found.keys) > MATTERS else ()


def excess_left(some: Problem, theta: Floats, level: float, known: Collection[Key]) -> float:
    """The least share of the excess chi^2 that one more effect of the library leaves, beside what was found.

    Args:
        some: windows with nothing left out; theta: what was found without some times, all parameters.
        level: chi^2/dof that it has without them: what lies above is the excess.
        known: what was found.
    """
    at = fit(some, theta, initial_states(some), [], {})
    search = Search(some, list_starts(some))
    found = Explanation((), at, search.bic(at.chi2, 0), True)
    second = {c.key for c in some.model.candidates if c.effect.second}
    first = {c.key for c in some.model.candidates} - second
    options = [*search.joined(found, {*known, *second}), *(search.joined(found, {*known, *first}) if second else ())]
    # what another initial state does is no merit of the effect beside which it was found
    alone = [window_chi2(some, at.theta, at.x0)] + [refit_from_all(some, theta, e.fit.x0).chi2 for e in options]
    excess = float(np.sum(np.min(alone, axis=0))) - level * some.size
    return min((max(e.fit.chi2 - level * some.size, 0.0) / excess for e in options), default=1.0)


def _around(windows: Windows, t: Floats, spans: tuple[Span, ...]) -> Windows:
    """The windows that hold some of the times, and a spread of the others: an effect has to act there as it does."""
    rows = zip(windows.trace.tolist(), t[windows.start], t[windows.stop - 1], strict=True)
    held = np.array([any(_meet((k, a, b), s) for s in spans) for k, a, b in rows])
    others = np.flatnonzero(~held)
    count = min(len(others), 2 * WIDTH)
    held[others[np.linspace(0, len(others) - 1, count).round().astype(int)]] = True
    return windows.pick(held)


def _meet(a: Span, b: Span) -> bool:
    return a[0] == b[0] and a[1] < b[2] and b[1] < a[2]


def push_fault(record: Record, kept: Problem) -> RecordingFault:
    """What was left out, in words: `record` has times left out, `kept` the windows that are fitted without them."""
    names = [trace.name for trace in record.traces]
    spans = [f"{a:.2f} to {b:.2f} s of {names[k]}" for k, a, b in record.left_out]
    lasts, w = sum(b - a for _, a, b in record.left_out), kept.windows
    rest = float(np.sum(kept.t[w.stop - 1] - kept.t[w.start]))
    where = joined(spans if len(spans) <= 3 else [*spans[:3], f"{len(spans) - 3} more"])
    sentence = (
        f"{where[0].upper()}{where[1:]} (a push?): {100 * lasts / (lasts + rest):.2g} % of the time that is fitted was "
        "left out, as it stands out and no effect that was tried explains it."
    )
    return Push().told("", lasts, sentence)
