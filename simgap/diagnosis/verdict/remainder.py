"""What is left after the correction, bounded from held-out transitions: a split-conformal one-step bound.

The size of a transition's remainder is what the smoothed readings say that the model misses in it, and as much more as
they cannot tell from noise; the model is integrated in fine steps, as the simulator of a corrected case is (what the
steps of the nominal map miss of that is in the gap already). Under known conditions it is divided by what a force does
there over what it does under the declared ones: what is left is a force, which moves a light arm further than a heavy
one. `near_rest` says how far the sizes reach.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.result import WindowPrediction
from simgap.diagnosis.verdict.near_rest import NearRest, Sizes, bound, slow_and_fast
from simgap.diagnosis.verdict.pieces import Left, pieces
from simgap.diagnosis.verdict.transitions import Transitions, force_ratio, known_states, transitions, within
from simgap.model.symbolic import SymbolicModel
from simgap.split_conformal import attained, fewest


@dataclass(frozen=True)
class Remainder:
    """One-step bounds of |true - predicted|, by state.

    Attributes:
        tau: the step, s.
        level: coverage asked for; count: held-out transitions that set the bound.
        confidence: what is left of the level; pieces: independent blocks, or runs, of the held-out transitions that it
            rests on; by_run: whether runs differ, so that they are the pieces; runs: how many were held out.
        before, after: state -> bound under the declared and the corrected model; inf if there are too few transitions.
        rest_before, rest_after: where the velocity is small a wider bound stands beside these; None: nowhere.
        one_step: "before", "after" -> state -> RMS of what the model misses in a step on held-out data;
            "unresolved" -> state -> what of it noise may be.
        inside: share of the held-out transitions inside the bound, for the corrected model.
        estimated: velocities that were derived from their positions.
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
    rest_before: NearRest | None
    rest_after: NearRest | None
    inside: float
    estimated: tuple[str, ...]
    unbounded: tuple[str, ...]
    statement: str
    one_step: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class _Bound:
    """Of one model: state -> bound, state -> RMS on held-out data and what noise may be of it, bound near rest, share
    inside; how many held-out transitions, independent pieces and runs it rests on, and whether runs are the pieces."""

    by: Mapping[str, float]
    rms: Mapping[str, float]
    unresolved: Mapping[str, float]
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
    tau: float,
    level: float,
    X: Mapping[str, tuple[float, float]] | None = None,
    declared: Mapping[str, float] | None = None,
) -> Remainder | None:
    """Bound what a model misses in one step from the windows that were held out.

    Args:
        windows: with measured channels, inputs, and the states that the corrected model gives where none was measured.
        sigma: noise of each measured state, in the order of the columns.
        models: declared and corrected; this has what remembers earlier commands as further states and delays.
        tau: sampling time, s; at least the interval of the data is used.
        level: coverage, such as 0.95.
        X: state -> where the bound is asked for; transitions that begin elsewhere, or that the corrected model takes
            elsewhere, do not count.
        declared: known condition -> its value in the case, for which the bound is.

    Returns:
        None if nothing was held out, or no held-out window is longer than a step and begins in X.
    """
    kept = [w for w in windows if w.held_out]
    if not kept:
        return None
    step = max(tau, float(np.median(np.concatenate([np.diff(w.t) for w in kept]))))
    names = known_states(models[0], list(sigma))
    bounds = [_bound(model, windows, sigma, names, step, level, X or {}, declared or {}) for model in models]
    first, last = bounds
    if first is None or last is None:
        return None
    missing = tuple(n for n in models[0].state_names if n not in names)
    finite = all(math.isfinite(v) for v in last.by.values())
    confidence = attained(last.pieces, level) if finite else 0.0
    statement = _statement(level, confidence, last, step, missing) if finite else _too_few(last.count, level)
    one_step = {"before": first.rms, "after": last.rms, "unresolved": last.unresolved}
    derived = tuple(n for n in names if n not in sigma)
    return Remainder(
        step, level, last.count, confidence, last.pieces, last.by_run, last.runs,
        first.by, last.by, first.rest, last.rest, last.inside, derived, missing,
        statement + _derived(derived) + _near_rest(last.rest, confidence), one_step,
    )  # fmt: skip


def _bound(
    model: SymbolicModel, windows: Sequence[WindowPrediction], sigma: Mapping[str, float], names: Sequence[str],
    step: float, level: float, X: Mapping[str, tuple[float, float]], declared: Mapping[str, float],
) -> _Bound | None:  # fmt: skip
    """Of one model; None if no transition that was held out begins in X."""
    smoothed = transitions(windows, sigma, model, step, level)
    parts = (within(smoothed, model, X, False), within(smoothed, model, X, True))
    if not len(parts[1].start):
        return None
    place = [model.state_names.index(n) for n in names]
    ratios = [force_ratio(model, part, names, declared) for part in parts]
    forces = [part.missed[:, place] / r for part, r in zip(parts, ratios, strict=True)]
    sizes = [np.abs(f) + part.beyond[:, place] / r for f, part, r in zip(forces, parts, ratios, strict=True)]
    rng = np.random.default_rng(0)  # what is hidden does not last because a smoothed number does
    piece, by_run = _pieces(
        parts,
        [
            p.missed[:, place] + rng.standard_normal((len(p.at), 1)) * p.spread[:, place] / r
            for p, r in zip(parts, ratios, strict=True)
        ],
    )
    fitted, fresh = Sizes(sizes[0], _speeds(parts[0], model)), Sizes(sizes[1], _speeds(parts[1], model), piece)
    split = slow_and_fast(fitted, fresh, level, {n: 0.5 * (hi - lo) for n, (lo, hi) in X.items()})
    limit = bound(fitted, fresh, level) if split is None else split.fast
    rest, inside = None, np.all(fresh.residual <= limit, axis=1)
    if split is not None:
        rest = NearRest(split.velocity, split.below, dict(zip(names, split.slow.tolist(), strict=True)), split.own)
        slow = fresh.speed[split.velocity] <= split.below
        inside = np.where(slow, np.all(fresh.residual <= split.slow, axis=1), inside)
    missed, squares = parts[1].missed[:, place], parts[1].spread[:, place] ** 2
    rms, unresolved = (np.sqrt(np.mean(each, axis=0)).tolist() for each in (missed**2 + squares, squares))
    return _Bound(
        dict(zip(names, limit.tolist(), strict=True)),
        dict(zip(names, rms, strict=True)),
        dict(zip(names, unresolved, strict=True)),
        rest,
        float(np.mean(inside)),
        len(fresh.residual),
        fresh.count if split is None else split.pieces,
        len(set(parts[1].trace)),
        by_run,
    )


def _pieces(parts: tuple[Transitions, Transitions], residuals: Sequence[Floats]) -> tuple[Ints, bool]:
    """To which independent piece each held-out transition belongs; what was fitted helps to see how long one is."""
    whole, held_out = np.concatenate(residuals), np.repeat([False, True], [len(r) for r in residuals])
    size = np.sqrt(np.mean(whole**2, axis=0))
    traces, at = (np.concatenate([getattr(p, n) for p in parts]) for n in ("trace", "at"))
    _, run = np.unique(traces, return_inverse=True)
    begin = np.full(run.max() + 1, np.inf)
    np.minimum.at(begin, run, at)
    step = np.rint((at - begin[run]) / parts[1].seconds).astype(np.int64)
    piece, by_run = pieces(Left(whole / np.where(size > 0.0, size, 1.0), run, step, held_out))
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
    return f" {', '.join(names)} {was} derived from positions by the model, an estimate of what was not measured."


def _percent(probability: float) -> str:
    return f"{math.floor(1000.0 * max(probability, 0.0) + 1e-6) / 10.0:g} %"


def _too_few(count: int, level: float) -> str:
    return f"{count} held-out transitions are too few for {100 * level:g} %: hold out at least {fewest(level)}."


def _statement(level: float, confidence: float, own: _Bound, step: float, missing: Sequence[str]) -> str:
    rest = f" {', '.join(missing)} was not measured and is not bounded." if missing else ""
    few = f" (of {100 * level:g} % asked for, which takes {fewest(level)} pieces)" if confidence < level else ""
    several = "independent pieces" if own.pieces > 1 else "independent piece"
    pieces = (
        "runs, one piece each because they differ" if own.by_run else f"{several} as long as what is left remembers"
    )
    of = f"one of a further {'run' if own.by_run else 'piece'} that is"
    one = " They are of one run: how another differs is not known." if own.runs == 1 else ""
    return (
        f"Split conformal: a further transition over {step:.4g} s, {of} exchangeable with these, lies within the bound "
        "of the model in all measured states at once with probability at least "
        f"{_percent(confidence)}{few}. It rests on {own.count:,} held-out transitions, which "
        f"are {own.pieces:,} {pieces}; no smaller share of the fitted ones is inside.{one} It is what is left beyond "
        "the noise of the readings, which are smoothed for it: assumed are white noise, of the stated size "
        f"at most, and a remainder that does not alternate from step to step. It is no bound for every state.{rest}"
    )
