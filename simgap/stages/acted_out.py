"""Effects that were found and that the simulator of a corrected case acts out.

The nominal model gets them all. Whether the simulator lacks them too is another question: simgap's own twin of the
nominal model does, a person's own program may know them already. So the simulator follows the recordings that confirm
with and without them, and what strays less is taken.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simgap import plugins
from simgap.config.case import Case
from simgap.config.measured import MeasuredSection
from simgap.config.plant import AddedEffect
from simgap.diagnosis.result import Diagnosis
from simgap.diagnosis.thresholds import MATTERS, NEAR
from simgap.diagnosis.verdict.transitions import Followed, followed, stray
from simgap.effects import AppliedEffect, delays_and_lags, effect
from simgap.errors import UserError
from simgap.notation import joined, number
from simgap.plants.context import Context
from simgap.simulators.base import Engine
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import follow
from simgap.stages import log

Effects = tuple[AppliedEffect, ...]
_MOST_FOLLOWED = 24  # windows over which a simulator is held against the recordings
_SHARES = -np.log(1.0 - (np.arange(16) + 0.5) / 16)
"""Delays of equal shares of what a lag of 1 s passes on, s."""
_FORGOTTEN = 4.0
"""Lags after which .02 of an earlier command is left."""


@dataclass(frozen=True)
class ActedOut:
    """Effects that the simulator of the corrected case acts out.

    Attributes:
        effects: those that it acts out beside what the case declares.
        reason: why, in a sentence.
        tried: sets of effects, by (name, on), and how far the simulator strays from the recordings with each, in
            standard deviations of the noise; empty where that was not measured.
        rest: what the engine cannot act out, as a sentence; empty where it can act out everything.
        able: effects that it can act out, where recordings may decide between them.
    """

    effects: Effects
    reason: str
    tried: tuple[tuple[tuple[tuple[str, str], ...], float], ...] = ()
    rest: str = ""
    able: Effects = ()

    def document(self) -> dict[str, Any]:
        """As `diagnosis.json` holds it."""
        return {
            "effects": [{"name": e.name, "on": e.on} for e in self.effects],
            "reason": self.reason,
            "tried": [
                {"effects": [{"name": n, "on": on} for n, on in names], "error": error} for names, error in self.tried
            ],
        }


def acted_out(context: Context, section: MeasuredSection, applied: Sequence[AppliedEffect]) -> ActedOut | None:
    """The choice of the case or, where it makes none, of its engine; None without a simulator or effects.

    Raises:
        UserError: an engine that does not exist.
    """
    case = context.case
    moving = tuple(e for e in applied if not effect(e.name).reading_remedy)
    if case.simulator is None or not moving:
        return None
    if section.rig == "simulator":
        return ActedOut((), "The recordings are of the case's own simulator, which has the effects as it is.")
    engine = plugins.find("engines", case.simulator.engine, context.folder)
    kind = engine if issubclass(engine, Engine) else None
    able = tuple(e for e in moving if kind is not None and kind.acts_out(effect(e.name)))
    unable = joined([e.name.replace("_", " ") for e in moving if e not in able] or [""])
    rest = (
        f" It cannot simulate {unable}: unless its own model has that, gamma does not cover the hardware."
        if unable
        else ""
    )
    if section.into_simulator is not None:
        words = "acts them out" if section.into_simulator else "stays as it is"
        return ActedOut(
            able if section.into_simulator else (),
            f"The simulator {words}, as measured.into_simulator says.{rest if section.into_simulator else ''}",
            rest=rest,
        )
    if kind is None or kind.of_its_own(case):
        reason = "The simulator is a separate model and stays as it is: whether it lacks the effects was not measured"
        return ActedOut((), f"{reason} (measured.into_simulator: true adds them).{rest}", rest=rest, able=able)
    made = "The simulator is derived from the nominal model and lacks the same effects."
    return ActedOut(able, f"{made}{rest}", rest=rest, able=able)


def measured_out(
    context: Context, section: MeasuredSection, found: Diagnosis, names: tuple[Sequence[str], Sequence[str]],
    engine_log: Path | None = None,
) -> ActedOut | None:  # fmt: skip
    """`acted_out`, decided by the recordings that confirm where they can: see the module.

    Args:
        found: with the windows; names: of their measured states, and of their inputs (those of the case come first).

    Raises:
        UserError: as `acted_out`.
        EngineCrash: a simulator whose process died.
    """
    stated, case = acted_out(context, section, found.applied), context.case
    if (
        stated is None
        or not stated.able
        or case.domain is None
        or case.hidden_state is not None
        or len(names[1]) > len(context.inputs)
    ):
        return stated
    sets = _sets(stated.able, stated.effects)
    try:
        errors = _errors(context, found, names[0], sets, engine_log)
    except UserError as error:  # a process that died is no answer
        log.warning("the simulator cannot follow the recordings: %s", error)
        return stated
    return _judged(stated, sets, errors) if errors else stated


def _sets(able: Effects, stated: Effects) -> list[Effects]:
    """Sets of effects to try: what the engine suggests first, then none, all, each alone, all but each."""
    sizes = sorted({0, 1, len(able) - 1, len(able)})
    every = [tuple(s) for n in sizes for s in itertools.combinations(able, n)]
    return [stated, *(s for s in every if s != stated)]


def _errors(
    context: Context, found: Diagnosis, measured: Sequence[str], sets: Sequence[Effects], engine_log: Path | None
) -> list[float]:
    """How far the simulator strays from the windows that confirm with each set of effects; none without windows."""
    held = [w for w in found.windows if w.held_out]
    held = held[:: max(1, -(-len(held) // _MOST_FOLLOWED))]
    tau = context.domain.tau
    since = max((delay + _FORGOTTEN * lag for s in sets for delay, lag in delays_and_lags(s).values()), default=0.0)
    runs = [_runs(context, found, held, measured, s, since) for s in sets]
    if not all(runs):
        return []
    jobs = [
        (_with(context.case, s), [r.start for r in own], [r.inputs for r in own])
        for s, own in zip(sets, runs, strict=True)
    ]
    (paths,) = run_in_processes(follow, [(jobs, context.folder)], log=engine_log)
    columns = [context.states.index(n) for n in measured]
    sigma = np.array([found.sigma[n] for n in measured])
    return [stray(own, path, columns, sigma, tau) for own, path in zip(runs, paths, strict=True)]


def _runs(
    context: Context, found: Diagnosis, held: Sequence[Any], measured: Sequence[str], effects: Effects, since: float
) -> list[Followed]:
    """Stretches to follow. An effect that remembers commands is a mixture of delays: a lag of exponential ones."""
    late = {on: delay + lag * _SHARES for on, (delay, lag) in delays_and_lags(effects).items()}
    columns = context.plant.corrected.state_names[: found.windows[0].states.shape[1]]
    if not set(context.states) <= set(columns):
        return []
    return followed(held, context.states, context.inputs, columns, measured, late, context.domain.tau, since)


def _with(case: Case, effects: Effects) -> Case:
    """The case whose simulator acts out more."""
    section = case.simulator
    assert section is not None
    more = [
        AddedEffect(name=e.name, on=e.on, parameters=dict(e.values)) for e in effects if not effect(e.name).remembers
    ]
    return case.model_copy(update={"simulator": section.model_copy(update={"effects": (*section.effects, *more)})})


def _judged(stated: ActedOut, sets: Sequence[Effects], errors: Sequence[float]) -> ActedOut:
    """The set that strays clearly less than what the engine suggests, else that."""
    errors = np.nan_to_num(np.array(errors), nan=np.inf).tolist()
    best = int(np.argmin(errors))
    best = best if errors[best] < (1.0 - MATTERS) * errors[0] and errors[best] <= NEAR else 0
    tried = tuple((tuple((e.name, e.on) for e in s), error) for s, error in zip(sets, errors, strict=True))
    taken, other = sets[best], max(sets, key=len) if not sets[best] else ()
    words = joined([effect(e.name).phrase(e.on) for e in taken])
    what = f"includes {words}" if taken else "stays as it is"
    beside = "without them" if taken else "with the effects on top"
    far = (
        " It follows them with none of these sets; something else differs, such as its time step (substeps) or its "
        "own damping, and remains part of the gap."
    )
    return ActedOut(
        taken,
        f"The simulator {what}: it then misses the held-out recordings by {number(errors[best], 3)} times "
        f"their noise; {beside}, by {number(errors[sets.index(other)], 3)} times.{far if min(errors) > NEAR else ''}"
        f"{stated.rest}",
        tried,
        stated.rest,
    )
