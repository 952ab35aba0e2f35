"""What is left after the correction, bounded from held-out transitions: a one-step bound.

Two bounds hold each with its own confidence, and the smaller one of each state is taken, with what both together leave.
The first is split conformal and has the noise of the readings inside; `process_noise` has the second, without it.

The residual of a transition is `y_i(t + tau) - F_i(x(t), u)`, with F the model integrated in fine steps, as the
simulator of a corrected case is (what the steps of the nominal map miss of that is in the gap already). Under known
conditions it is divided by what a force does there over what it does under the declared ones: what is left is a force,
which moves a light arm further than a heavy one. `conformal_bound` says how far the residuals reach, `use_of` whether
the bound of the gap takes them in.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.correction.conformal_bound import NearRest, Sizes, bound, pieces, slow_and_fast
from simgap.correction.process_noise import bound_forces
from simgap.correction.transitions import Transitions, force_ratio, held, seen, transitions, within
from simgap.diagnosis.result import WindowPrediction
from simgap.model.symbolic import SymbolicModel
from simgap.statistics import attained, fewest


@dataclass(frozen=True)
class Remainder:
    """One-step bounds of |measured - predicted|, by state.

    Attributes:
        tau: the step, s.
        level: coverage asked for; count: held-out transitions that set the bound.
        confidence: what is left of the level; pieces: independent blocks, or runs, of the held-out transitions that it
            rests on; by_run: whether runs differ, so that they are the pieces; runs: how many were held out.
        before, after: state -> bound under the declared and the corrected model; inf if there are too few transitions.
        with_noise: state -> the conformal bound under the corrected model, which has the noise of readings inside.
        rest_before, rest_after: where the velocity is small a wider bound stands beside these; None: nowhere.
        one_step: "before", "after", "noise_floor" -> state -> RMS of the one-step residual on held-out data; the floor
            is the noise of both ends.
        inside: share of the held-out transitions inside the bound, for the corrected model.
        estimated: velocity that was derived from its position -> noise of the estimate.
        unbounded: states that were neither measured nor derived.
        statement: the coverage in words.
    """

    tau: float
    level: float
    count: int
    confidence: float
    pieces: int
    by_run: bool
    runs: int
    before: Mapping[str, float]
    after: Mapping[str, float]
    with_noise: Mapping[str, float]
    rest_before: NearRest | None
    rest_after: NearRest | None
    inside: float
    estimated: Mapping[str, float]
    unbounded: tuple[str, ...]
    statement: str
    one_step: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class _Bound:
    """Of one model: state -> bound, state -> RMS on held-out data, bound near rest, share inside;
    how many held-out transitions, independent pieces and runs it rests on, and whether runs are the pieces."""

    by: Mapping[str, float]
    rms: Mapping[str, float]
    rest: NearRest | None
    inside: float
    count: int
    pieces: int
    runs: int
    by_run: bool


def bound_remainder(
    windows: Sequence[WindowPrediction],
    sigma: Mapping[str, float],
    models: tuple[SymbolicModel, SymbolicModel],
    shifts: Mapping[str, float],
    tau: float,
    level: float,
    X: Mapping[str, tuple[float, float]] | None = None,
    declared: Mapping[str, float] | None = None,
    remembering: SymbolicModel | None = None,
) -> Remainder | None:
    """Bound the one-step residual from the windows that were held out.

    Args:
        windows: with measured channels, inputs, and the states that the corrected model gives where none was measured.
        sigma: noise of each measured state, in the order of the columns.
        models: declared and corrected, over the same states.
        shifts: seconds by which inputs act later in the corrected model.
        tau: sampling time, s; at least the interval of the data is used.
        level: coverage, such as 0.95.
        X: state -> where the bound is asked for; transitions that begin elsewhere, or that the corrected model takes
            elsewhere, do not count.
        declared: known condition -> its value in the case, for which the bound is.
        remembering: the corrected model with its lags as states and its delays; None: as `models` has it.

    Returns:
        None if nothing was held out, or no held-out window is longer than a step and begins in X.
    """
    whole, noise = seen(windows, sigma, models[1])
    kept, fitted = ([w for w in whole if w.held_out is out] for out in (True, False))
    if not kept:
        return None
    step = max(tau, float(np.median(np.concatenate([np.diff(w.t) for w in kept]))))
    names, bounds, estimated = list(noise), [], {n: s for n, s in noise.items() if n not in sigma}
    for model, late in zip(models, ({}, shifts), strict=True):
        parts = [within(transitions(ws, names, models[1], late, step), models[1], X or {}) for ws in (fitted, kept)]
        if not len(parts[1].start):
            return None
        bounds.append(_bound(model, (parts[0], parts[1]), names, level, X or {}, declared or {}))
    first, last = bounds
    forces = [
        {} if declared else bound_forces([w for w in windows if w.held_out], sigma, model, step, level)
        for model in (models[0], remembering or models[1])
    ]
    missing = tuple(n for n in models[0].state_names if n not in names)
    confidence, statement = _promised(level, last, forces[1], step, missing)
    one_step = {
        "before": first.rms, "after": last.rms, "noise_floor": {n: math.sqrt(2.0) * s for n, s in noise.items()}
    }  # fmt: skip
    return Remainder(
        step, level, last.count, confidence, last.pieces, last.by_run, last.runs,
        _least(first.by, forces[0]), _least(last.by, forces[1]), last.by,
        _rest_beside(first, forces[0]), rest := _rest_beside(last, forces[1]),
        last.inside, estimated, missing, statement + _derived(list(estimated)) + _near_rest(rest, confidence), one_step,
    )  # fmt: skip


def _bound(
    model: SymbolicModel, parts: tuple[Transitions, Transitions], names: Sequence[str], level: float,
    X: Mapping[str, tuple[float, float]], declared: Mapping[str, float],
) -> _Bound:  # fmt: skip
    places = [model.state_names.index(n) for n in names]
    plain = [part.then - held(model, part)[:, places] for part in parts]  # measured minus predicted, (n, k)
    forces = [r / force_ratio(model, part, names, declared) for r, part in zip(plain, parts, strict=True)]
    piece, by_run = _pieces(parts, forces)
    fitted = Sizes(np.abs(forces[0]), _speeds(parts[0], model))
    fresh = Sizes(np.abs(forces[1]), _speeds(parts[1], model), piece)
    split = slow_and_fast(fitted, fresh, level, {n: 0.5 * (hi - lo) for n, (lo, hi) in X.items()})
    limit = bound(fitted, fresh, level) if split is None else split.fast
    by, rest = dict(zip(names, limit.tolist(), strict=True)), None
    inside = np.all(fresh.residual <= limit, axis=1)
    if split is not None:
        rest = NearRest(split.velocity, split.below, dict(zip(names, split.slow.tolist(), strict=True)), split.own)
        slow = fresh.speed[split.velocity] <= split.below
        inside = np.where(slow, np.all(fresh.residual <= split.slow, axis=1), inside)
    rms = dict(zip(names, np.sqrt(np.mean(plain[1] ** 2, axis=0)).tolist(), strict=True))
    count, runs = fresh.count if split is None else split.pieces, len(set(parts[1].trace))
    return _Bound(by, rms, rest, float(np.mean(inside)), len(plain[1]), count, runs, by_run)


def _promised(
    level: float, last: _Bound, forces: Mapping[str, float], step: float, missing: Sequence[str]
) -> tuple[float, str]:
    """With what confidence the bounds hold, and the sentence that says so; 0 where too few were held out."""
    if not all(math.isfinite(v) for v in last.by.values()):
        few = f"{last.count} held-out transitions are too few for {100 * level:g} %"
        return 0.0, f"{few}: hold out at least {fewest(level)}."
    widest = last.by if last.rest is None else last.rest.by
    below = [n for n in widest if forces.get(n, math.inf) < widest[n]]
    confidence = max(attained(last.pieces, level) - (1.0 - level if below else 0.0), 0.0)
    return confidence, _statement(level, confidence, last, step, missing, below)


def _least(by: Mapping[str, float], forces: Mapping[str, float]) -> dict[str, float]:
    """The smaller bound of each state; infinite where the first is: too few transitions bound nothing."""
    return {n: min(v, forces.get(n, math.inf)) if math.isfinite(v) else v for n, v in by.items()}


def _rest_beside(own: _Bound, forces: Mapping[str, float]) -> NearRest | None:
    """The bound near rest, where it is still wider than everywhere else."""
    if own.rest is None:
        return None
    by = _least(own.rest.by, forces)
    everywhere = _least(own.by, forces)
    return replace(own.rest, by=by) if any(by[n] > everywhere[n] for n in by) else None


def _pieces(parts: tuple[Transitions, Transitions], residuals: Sequence[Floats]) -> tuple[Ints, bool]:
    """To which independent piece each held-out transition belongs; what was fitted helps to see how long one is."""
    whole, held_out = np.concatenate(residuals), np.repeat([False, True], [len(r) for r in residuals])
    size = np.sqrt(np.mean(whole**2, axis=0))
    traces, at = (np.concatenate([getattr(p, n) for p in parts]) for n in ("trace", "at"))
    _, run = np.unique(traces, return_inverse=True)
    begin = np.full(run.max() + 1, np.inf)
    np.minimum.at(begin, run, at)
    step = np.rint((at - begin[run]) / parts[1].seconds).astype(np.int64)
    piece, by_run = pieces(whole / np.where(size > 0.0, size, 1.0), run, step, held_out)
    return piece[held_out], by_run


def _speeds(part: Transitions, model: SymbolicModel) -> dict[str, Floats]:
    """Velocity of a coordinate -> its size at the start of each transition."""
    return {c.velocity: np.abs(part.start[:, model.state_names.index(c.velocity)]) for c in model.coordinates}


def _near_rest(rest: NearRest | None, confidence: float) -> str:
    if rest is None:
        return ""
    words = (
        f" Transitions that begin with |{rest.velocity}| of {rest.below:.3g} at most have a wider bound of their own"
    )
    few = "; too few of them were held out: their bound is that of all, and both together hold with at least "
    few += _percent(2.0 * confidence - 1.0)
    return f"{words}{'' if rest.own else few}."


def _derived(names: Sequence[str]) -> str:
    if not names:
        return ""
    was = "was" if len(names) == 1 else "were"
    return f" {', '.join(names)} {was} derived from positions by local cubics, an estimate of what was not measured."


def _percent(probability: float) -> str:
    return f"{math.floor(1000.0 * max(probability, 0.0) + 1e-6) / 10.0:g} %"


def _statement(
    level: float, confidence: float, own: _Bound, step: float, missing: Sequence[str], below: Sequence[str]
) -> str:
    rest = f" {', '.join(missing)} was not measured and is not bounded." if missing else ""
    asked = confidence + (1.0 - level if below else 0.0)
    few = f" (of {100 * level:g} % asked for, which takes {fewest(level)} pieces)" if asked < level - 1e-9 else ""
    noise = "Measurement noise is inside the bound."
    if below:
        noise = (
            f"Measurement noise is not inside the bound of {', '.join(below)}, which is of the forces that smoothed "
            "readings allow under white noise: an estimate (likelihood, Chebyshev's inequality) of the same level, and "
            f"both bounds hold together with {_percent(1.0 - level)} less confidence."
        )
    several = "independent pieces" if own.pieces > 1 else "independent piece"
    pieces = (
        "runs, one piece each because they differ" if own.by_run else f"{several}, each as long as errors correlate"
    )
    of = f"one of a further {'run' if own.by_run else 'piece'} that is"
    one = " They are of one run: how another differs is not known." if own.runs == 1 else ""
    return (
        f"Split conformal: a further transition over {step:.4g} s, {of} exchangeable with these, lies within the bound "
        "of the model in all measured states at once with probability at least "
        f"{_percent(confidence)}{few}. It rests on {own.count:,} held-out transitions, which "
        f"are {own.pieces:,} {pieces}; no smaller share of the fitted ones is inside.{one} {noise} "
        f"This is not a bound for every state.{rest}"
    )


@dataclass(frozen=True)
class RemainderUse:
    """What is done with the remainder.

    Attributes:
        bounded: whether the corrected case adds it to its gamma; reason: why, or why not.
        by: state -> how far gamma moves outward; empty if it does not.
        asked: whether the case has a gamma that it could be added to.
        near_rest: where it moves further; None: nowhere.
    """

    bounded: bool
    reason: str
    by: Mapping[str, float]
    asked: bool
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
        (verdict != "partial", "a remainder is added only where the verdict is 'partial'"),
        (rig == "simulator", "the recordings are of the case's own simulator, whose gap is measured there"),
        (has_hidden_state, "the bound of a simulator with hidden state does not take measured remainders in"),
        (not has_gap, "the case has no `gap:` section"),
        (not finite, "too few transitions were held out"),
    )
    for stands, reason in obstacles:
        if stands:
            return RemainderUse(False, reason, {}, has_gap)
    near_rest = remainder.rest_after if remainder is not None else None
    return RemainderUse(True, "the corrected case adds it to gamma (gap.remainder)", finite, has_gap, near_rest)
