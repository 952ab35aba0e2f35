"""What a search says of faults of the recording: pushes, velocities to be left out, noise that remembers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simgap.diagnosis.record.faults.measurement import FilteredVelocity
from simgap.diagnosis.record.faults.noise import ColouredNoise, Push
from simgap.diagnosis.record.folds import Span
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.noise_law import are_gross
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.thresholds import MOST, SEVERAL
from simgap.notation import from_to, joined


def gross_spans(known: Problem, at: Fit) -> tuple[Span, ...]:
    """Times of fitted windows in which gross errors follow one another: a push, a contact, a lost signal."""
    if known.usual is None:
        return ()
    gross = are_gross(known.residuals(at.theta, at.x0), known.spread).any(axis=1)
    t, trace = known.t[known.samples][gross], np.repeat(known.windows.trace, np.diff(known.rows))[gross]
    order = np.lexsort((t, trace))
    t, trace = t[order], trace[order]
    breaks = np.flatnonzero((np.diff(trace) != 0) | (np.diff(t) > 0.5 * known.brief)) + 1
    groups = zip(np.split(trace, breaks), np.split(t, breaks), strict=True)
    return tuple((int(own[0]), float(at[0]), float(at[-1])) for own, at in groups if len(at) >= SEVERAL)


def push_faults(spans: Sequence[Span], known: Problem, names: Sequence[str]) -> tuple[RecordingFault, ...]:
    """What weighed nothing in a fit to the known windows, in words."""
    if not spans:
        return ()
    first, last = known.t[known.firsts], known.t[np.append(known.firsts[1:], len(known.t)) - 1]
    spans = [(k, max(a, float(first[k])), min(b, float(last[k]))) for k, a, b in spans]
    places, lasts = [f"{from_to(a, b)} of {names[k]}" for k, a, b in spans], sum(b - a for _, a, b in spans)
    kept = float(np.sum(known.t[known.windows.stop - 1] - known.t[known.windows.start]))
    where = joined(places if len(places) <= 3 else [*places[:3], f"{len(places) - 3} more"])
    sentence = (
        f"{where[0].upper()}{where[1:]} (a push?): {100 * lasts / (lasts + kept):.2g} % of the fitted time has no "
        "weight: it stands out, and no effect that was tried explains it."
    )
    return (Push().told("", lasts, sentence),)


def filtered_channels(search: Search, found: Explanation) -> tuple[RecordingFault, ...]:
    """Velocities that were found to be filtered while their position is measured: they are left out from here on."""
    model = search.problem.model
    position = {c.velocity: c.position for c in model.model.coordinates}
    return tuple(
        c.effect.left_out(c.on, float(found.fit.theta[c.slots[0]]))
        for c in found.members
        if isinstance(c.effect, FilteredVelocity) and position[c.on] in model.measured
    )


def faint_memory(problem: Problem) -> tuple[str, ...]:
    """Channels of which a part of the noise alone remembers."""
    shares = () if problem.colour is None else zip(problem.model.measured, problem.colour.shared, strict=True)
    return tuple(name for name, share in shares if 0.0 < share < MOST)


def noise_faults(problem: Problem) -> list[RecordingFault]:
    """What is to be said of a noise that remembers."""
    if problem.colour is None:
        return []
    lasts = float(problem.t[problem.windows.stop[0] - 1] - problem.t[problem.windows.start[0]])
    shared, tau = (map(float, each) for each in (problem.colour.shared, problem.colour.tau))
    return ColouredNoise().of(zip(problem.model.measured, shared, tau, strict=True), lasts)
