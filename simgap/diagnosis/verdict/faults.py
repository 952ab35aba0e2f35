"""Faults of a recording, in words: what was found, by how much, and what to do."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from simgap.diagnosis.reading.windows import Span
from simgap.diagnosis.result import FoundEffect, RecordingFault
from simgap.diagnosis.search.explanations import Explanation, Search
from simgap.diagnosis.search.fit import Fit
from simgap.diagnosis.simulation.gross_errors import are_gross
from simgap.diagnosis.simulation.problem import Problem
from simgap.diagnosis.simulation.recording import RECORDING, is_fault
from simgap.diagnosis.thresholds import BRIEF_S, MOST
from simgap.effects.quoted import Quoted
from simgap.notation import joined

UNITS: Mapping[str, float] = {
    "logged in units a thousand times too large": 1000.0,
    "logged in thousandths": 1e-3,
    "degrees for radians": math.pi / 180,
    "radians for degrees": 180 / math.pi,
    "turns a minute for radians a second": math.pi / 30,
    "radians a second for turns a minute": 30 / math.pi,
}
"""True over logged, of units that are often mistaken for each other."""
UNIT_WITHIN = 0.02
_SEVERAL = 3  # gross errors in a row are no stray readings

_SAME = {"late_reading": "late_log"}  # one fault to a person, of an input or of a reading

_REMEDY: Mapping[str, str] = {
    "late_reading": "Log {} with the stamp of the instant at which it was read, or shift its column by that much.",
    "late_log": "Log {} with the stamp of the instant at which it acts, or shift its column by that much.",
    "drift": "Zero the sensor of {} before each run, or subtract the ramp.",
    "filtered_velocity": "Log {} before its filter, or leave its column out.",
    "filtered_reading": "Log {} before its filter; of a slow sensor allow for the lag wherever it is fed back.",
}


def fitted_faults(found: Iterable[FoundEffect]) -> list[RecordingFault]:
    """Those that were fitted in the place of effects."""
    out = []
    for e in found:
        if is_fault(e.name):
            (size,) = e.parameters.values()
            quoted = {s: {"value": p.value, "ci95": list(p.ci95), "unit": p.unit} for s, p in e.parameters.items()}
            words = RECORDING[e.name].describe(e.on, Quoted(quoted))
            remedy = _REMEDY[e.name].format(e.on)
            sentence = f"The recording has {words}."
            out.append(RecordingFault(_SAME.get(e.name, e.name), e.on, size.value, size.unit, sentence, remedy))
    return out


def gain_faults(found: Iterable[FoundEffect]) -> list[RecordingFault]:
    """Gains that a wrong sign or unit of the input's column would make as well: a record cannot tell."""
    out = []
    for e in found:
        if e.name != "input_gain":
            continue
        ratio = e.parameters["ratio"]
        if ratio.ci95[1] < 0.0:
            sentence = f"{e.on} is reversed: its column, its wire or its motor has the other sign."
            remedy = f"If the column is wrong, give measured.columns.{e.on}.scale: -1; else turn the wire or the case."
            out.append(RecordingFault("wrong_sign", e.on, -1.0, "1", sentence, remedy))
        for words, factor in UNITS.items():
            lo, hi = sorted((abs(ratio.ci95[0]), abs(ratio.ci95[1])))
            if lo <= factor * (1 + UNIT_WITHIN) and hi >= factor * (1 - UNIT_WITHIN) and hi < 1.2 * lo:
                sentence = f"{e.on} acts {ratio.value:.4g} times as strongly as its column says: {words}?"
                remedy = f"If so, give its column's unit under measured.columns.{e.on}."
                out.append(RecordingFault("wrong_unit", e.on, ratio.value, "1", sentence, remedy))
    return out


def gross_spans(known: Problem, at: Fit) -> tuple[Span, ...]:
    """Times of fitted windows in which gross errors follow one another: a push, a contact, a lost signal."""
    if known.usual is None:
        return ()
    gross = are_gross(known.residuals(at.theta, at.x0), known.spread).any(axis=1)
    t, trace = known.t[known.samples], np.repeat(known.windows.trace, np.diff(known.rows))
    found: list[list[float]] = []
    for k, s in sorted(zip(trace[gross].tolist(), t[gross].tolist(), strict=True)):
        if found and found[-1][0] == k and s - found[-1][2] <= 0.5 * BRIEF_S:
            found[-1][2:] = [s, found[-1][3] + 1]
        else:
            found.append([k, s, s, 1])
    return tuple((int(k), a, b) for k, a, b, count in found if count >= _SEVERAL)


def push_faults(spans: Sequence[Span], known: Problem, names: Sequence[str]) -> tuple[RecordingFault, ...]:
    """What weighed nothing in a fit to the known windows, in words."""
    if not spans:
        return ()
    places, lasts = [f"{a:.2f} to {b:.2f} s of {names[k]}" for k, a, b in spans], sum(b - a for _, a, b in spans)
    kept = float(np.sum(known.t[known.windows.stop - 1] - known.t[known.windows.start]))
    where = joined(places if len(places) <= 3 else [*places[:3], f"{len(places) - 3} more"])
    sentence = (
        f"{where[0].upper()}{where[1:]} (a push?): {100 * lasts / (lasts + kept):.2g} % of the fitted time weighs "
        "nothing, as it stands out and no effect that was tried explains it."
    )
    remedy = "Drop what was disturbed (measured.masks), or repeat the run with nothing touching the plant."
    return (RecordingFault("push", "", lasts, "s", sentence, remedy),)


def filtered_channels(search: Search, found: Explanation) -> tuple[RecordingFault, ...]:
    """Velocities that were found to be filtered while their position is measured: they are left out from here on.

    Which filter it was is not known; its lag is told, and the motion is in the position.
    """
    measured, coordinates = search.problem.model.measured, search.problem.model.model.coordinates
    position = {c.velocity: c.position for c in coordinates}
    out = []
    for c in found.members:
        if c.effect.name == "filtered_velocity" and position[c.on] in measured:
            lag = float(found.fit.theta[c.slots[0]])
            sentence = f"{c.on} went through a filter that delays it by about {1e3 * lag:.3g} ms; it was left out."
            out.append(RecordingFault(c.effect.name, c.on, lag, "s", sentence, _REMEDY[c.effect.name].format(c.on)))
    return tuple(out)


def faint_memory(problem: Problem) -> tuple[str, ...]:
    """Channels of which a part of the noise alone remembers: what a mechanism leaves, unseen in noise, looks so too."""
    if problem.colour is None:
        return ()
    shares = zip(problem.model.measured, problem.colour.shared, strict=True)
    return tuple(name for name, share in shares if 0.0 < share < MOST)


def noise_faults(problem: Problem) -> list[RecordingFault]:
    """What is to be said of a noise that remembers."""
    if problem.colour is None:
        return []
    found = []
    lasts = float(problem.t[problem.windows.stop[0] - 1] - problem.t[problem.windows.start[0]])
    for name, share, tau in zip(problem.model.measured, problem.colour.shared, problem.colour.tau, strict=True):
        if share == 0.0:
            continue
        what = f"{100 * share:.0f} % of the noise of {name} (its variance)"
        if tau > lasts:
            sentence = f"{what} wanders: a reading that drifts, slower than a window of {lasts:.2g} s."
            remedy = "Warm the sensor up, or zero it at a stop between runs."
            found.append(RecordingFault("drift", name, float(tau), "s", sentence, remedy))
            continue
        sentence = f"{what} is correlated over {1e3 * tau:.3g} ms; intervals and criteria count what is independent."
        remedy = f"Look for a filter, a slow sensor or an interpolation in the path of {name}; log its raw readings."
        found.append(RecordingFault("coloured_noise", name, float(tau), "s", sentence, remedy))
    return found
