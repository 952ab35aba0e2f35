"""The corrected case: a valid case file with the effects that were found, ready to run from where it is written.

The nominal model gets all of the effects. Whether the simulator lacks them too is another question: simgap's own twin
of the nominal model does, a person's own program may know them already. So the simulator follows the recordings that
were fitted with and without them, and what strays less is taken (`measured_out`); those that confirm choose nothing.
"""

from __future__ import annotations

import copy
import itertools
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from simgap import plugins, reading
from simgap.config.case import Case
from simgap.config.load import case_content, parse_case
from simgap.config.measured import MeasuredSection
from simgap.config.named_files import move_files, plugin_copies, with_plugin_copies
from simgap.config.plant import AddedEffect, InputSet
from simgap.correction.remainder import RemainderUse
from simgap.correction.transitions import Followed, followed, stray
from simgap.diagnosis.result import Diagnosis
from simgap.diagnosis.thresholds import MATTERS, NEAR
from simgap.effects import AppliedEffect, delays_and_lags, effect
from simgap.errors import UserError
from simgap.geometry import Box, Grid
from simgap.notation import joined, number, one_line
from simgap.plants.context import Context
from simgap.plants.plant_model import PlantModel
from simgap.simulators.base import Engine
from simgap.simulators.commands import CommandPath
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import follow
from simgap.specifications.base import specification_of
from simgap.synthesis.games.nodes import bytes_of_nodes
from simgap.synthesis.input_sets import LARGEST_TABLES, packed_width

log = logging.getLogger("simgap")
Effects = tuple[AppliedEffect, ...]
_MOST_FOLLOWED = 24  # windows over which a simulator is compared with the recordings
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
        tried: sets of effects, and how far the simulator strays from the recordings with each, in
            standard deviations of the noise; empty where that was not measured.
        rest: what the engine cannot act out, as a sentence; empty where it can act out everything.
        able: effects that it can act out, where recordings may decide between them.
    """

    effects: Effects
    reason: str
    tried: tuple[tuple[Effects, float], ...] = ()
    rest: str = ""
    able: Effects = ()

    def document(self) -> dict[str, Any]:
        """As `diagnosis.json` holds it."""

        def places(effects: Effects) -> list[dict[str, str]]:
            return [{"name": e.name, "on": e.on} for e in effects]

        tried = [{"effects": places(own), "error": error} for own, error in self.tried]
        return {"effects": places(self.effects), "reason": self.reason, "tried": tried}


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
        own, words, left = (able, "acts them out", rest) if section.into_simulator else ((), "stays as it is", "")
        return ActedOut(own, f"The simulator {words}, as measured.into_simulator says.{left}")
    if kind is None or kind.of_its_own(case):
        reason = "The simulator is a separate model and stays as it is: whether it lacks the effects was not measured"
        return ActedOut((), f"{reason} (measured.into_simulator: true adds them).{rest}", rest=rest, able=able)
    made = "The simulator is derived from the nominal model and lacks the same effects."
    return ActedOut(able, f"{made}{rest}", rest=rest, able=able)


def measured_out(
    context: Context, section: MeasuredSection, found: Diagnosis, names: tuple[Sequence[str], Sequence[str]]
) -> ActedOut | None:
    """`acted_out`, decided by the recordings that were fitted where they can: see the module.

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
        errors = _errors(context, found, names[0], sets)
    except UserError as error:  # a process that died is no answer
        log.warning("the simulator cannot follow the recordings: %s", error)
        return stated
    return _judged(stated, sets, errors) if errors else stated


def _sets(able: Effects, stated: Effects) -> list[Effects]:
    """Sets of effects to try: what the engine suggests first, then none, all, each alone, all but each."""
    sizes = sorted({0, 1, len(able) - 1, len(able)})
    every = [tuple(s) for n in sizes for s in itertools.combinations(able, n)]
    return [stated, *(s for s in every if s != stated)]


def _errors(context: Context, found: Diagnosis, measured: Sequence[str], sets: Sequence[Effects]) -> list[float]:
    """How far the simulator strays from the windows that were fitted with each set of effects; none without windows."""
    fitted = [w for w in found.windows if not w.held_out]
    fitted = fitted[:: max(1, -(-len(fitted) // _MOST_FOLLOWED))]
    tau = context.domain.tau
    since = max((delay + _FORGOTTEN * lag for s in sets for delay, lag in delays_and_lags(s).values()), default=0.0)
    runs = [_runs(context, found, fitted, measured, s, since) for s in sets]
    if not all(runs):
        return []
    jobs = [
        (_with(context.case, s), [r.start for r in own], [r.inputs for r in own])
        for s, own in zip(sets, runs, strict=True)
    ]
    (paths,) = run_in_processes(follow, [(jobs, context.folder)])
    columns = [context.states.index(n) for n in measured]
    sigma = np.array([found.sigma[n] for n in measured])
    return [stray(own, path, columns, sigma, tau) for own, path in zip(runs, paths, strict=True)]


def _runs(
    context: Context, found: Diagnosis, windows: Sequence[Any], measured: Sequence[str], effects: Effects, since: float
) -> list[Followed]:
    """Stretches to follow. An effect that remembers commands is a mixture of delays: a lag of exponential ones."""
    late = {on: delay + lag * _SHARES for on, (delay, lag) in delays_and_lags(effects).items()}
    columns = context.plant.corrected.state_names[: found.windows[0].states.shape[1]]
    if not set(context.states) <= set(columns):
        return []
    return followed(windows, context.states, context.inputs, columns, measured, late, context.domain.tau, since)


def _with(case: Case, effects: Effects) -> Case:
    """The case whose simulator acts out more."""
    section = case.simulator
    assert section is not None
    more = [_added(e) for e in effects if not effect(e.name).remembers]
    return case.model_copy(update={"simulator": section.model_copy(update={"effects": (*section.effects, *more)})})


def _judged(stated: ActedOut, sets: Sequence[Effects], errors: Sequence[float]) -> ActedOut:
    """The set that strays clearly less than what the engine suggests, else that."""
    errors = np.nan_to_num(np.array(errors), nan=np.inf).tolist()
    best = int(np.argmin(errors))
    best = best if errors[best] < (1.0 - MATTERS) * errors[0] and errors[best] <= NEAR else 0
    taken, other = sets[best], max(sets, key=len) if not sets[best] else ()
    words = joined([effect(e.name).phrase(e.on) for e in taken])
    what = f"includes {words}" if taken else "stays as it is"
    beside = "without them" if taken else "with the effects on top"
    far = (
        " It follows them with none of these sets; something else differs, such as its time step (substeps), its "
        "own damping, or commands that change within tau, and remains part of the gap."
    )
    reason = (
        f"The simulator {what}: it then misses the fitted recordings by {number(errors[best], 3)} times "
        f"their noise; {beside}, by {number(errors[sets.index(other)], 3)} times.{far if min(errors) > NEAR else ''}"
        f"{stated.rest}"
    )
    return ActedOut(taken, reason, tuple(zip(sets, errors, strict=True)))


LARGEST_ROLLOUTS = 2_000_000
"""Most roll-outs (cells of `grid.eps` times inputs) with a lag as a state."""
LARGEST_PAIRS = 100_000_000
"""Most pairs of a cell of `synthesis.cells` and an input with a lag as a state."""
LAG_CELLS, LAG_SAMPLES, LAG_BLOCKS = 24, 4, 2
"""Along a lagged input: cells of the abstraction, of a grid of half-widths, and of a bound in blocks."""


def remember_commands(content: dict[str, Any], case: Case, applied: Sequence[AppliedEffect]) -> tuple[str, ...]:
    """Give the plain content of a case the memory that delays and lags of its inputs ask for, as far as it stays small.

    Args:
        content, case: the same case, which checks; applied: all effects that its plant will have.

    Returns:
        a sentence for each decision, for the head of the case.
    """
    remembered, words = delays_and_lags(applied), list[str]()
    if case.domain is None:
        return ()
    lagged = {on: _felt(case.domain.U[on], applied, on) for on, (_, lag) in sorted(remembered.items()) if lag > 0.0}
    delays = {on: delay for on, (delay, _) in remembered.items() if delay > 0.0}
    fits = bool(lagged) and _rollouts(case, lagged) and _pairs(case, len(lagged))
    if fits:
        names = ", ".join(f"{on}_lagged" for on in lagged)
        words.append(f"The lag is a state of the model: {names}, which the controller computes from its own commands.")
        for on, ends in lagged.items():
            _add_state(content, case, on, ends)
    elif lagged:
        words.append(
            "The lag is not in the sampled model: as a state it would exceed "
            f"{LARGEST_ROLLOUTS:,} roll-outs or {LARGEST_PAIRS:,} pairs. Gamma covers it."
        )
    if delays and _one_sample(case, delays) and not fits:
        content["sensing"] = {**(content.get("sensing") or {}), "latency": 1, "latency_of": "input_delay"}
        words.append(
            "The first sample of the delay is the controller's latency: it knows which input is pending, and commands "
            "that would act earlier are held back. Gamma covers the rest."
        )
    elif delays:
        words.append(
            "The delay is not in the sampled model: it is not near one sample of every input, or too large with "
            "these cells and inputs, or not for this specification. Gamma covers it."
            if case.synthesis is not None
            else "The delay acts in the model; without `synthesis` there is no controller whose latency it would be."
        )
    return tuple(words)


def _add_state(content: dict[str, Any], case: Case, on: str, ends: tuple[float, float]) -> None:
    """The lag of an input as a state, with the range of what the plant feels."""
    name = f"{on}_lagged"
    if name in content["plant"]["states"]:
        return
    content["plant"]["states"][name] = {"unit": case.plant.inputs[on].unit, "lag_of": on}
    content["domain"]["X"][name] = list(ends)
    if case.grid is not None and case.grid.half_widths:
        content["grid"]["half_widths"][name] = (ends[1] - ends[0]) / (2 * LAG_SAMPLES)
    if case.synthesis is not None:
        content["synthesis"]["cells"] = [*content["synthesis"]["cells"], LAG_CELLS]
    basis = content["gap"]["basis"] if case.gap is not None else None
    if isinstance(basis, list):
        content["gap"]["basis"] = [*basis, name]
    elif isinstance(basis, dict) and basis.get("blocks"):
        basis["blocks"] = [*basis["blocks"], LAG_BLOCKS]


def _felt(values: InputSet, applied: Sequence[AppliedEffect], on: str) -> tuple[float, float]:
    return CommandPath.of([_added(a) for a in applied], on, values.list().tolist(), 0.0).felt


def _rollouts(case: Case, ranges: Mapping[str, tuple[float, float]]) -> bool:
    if case.grid is None or case.domain is None:
        return True
    own = {n: v for n, v in case.domain.X.items() if n not in {f"{on}_lagged" for on in ranges}}
    if any(lo == hi for lo, hi in (*own.values(), *ranges.values())):
        return False
    if case.grid.eps is None:
        cells = [math.ceil((own[n][1] - own[n][0]) / (2 * h)) for n, h in case.grid.half_widths.items()]
        count = math.prod(cells) * LAG_SAMPLES ** len(ranges)
    else:
        lows, highs = zip(*own.values(), *ranges.values(), strict=True)
        count = math.prod(Grid.covering(Box(lows, highs), case.grid.eps).cells)
    return count * _inputs(case) <= LARGEST_ROLLOUTS


def _pairs(case: Case, lags: int) -> bool:
    if case.synthesis is None:
        return True
    return math.prod(case.synthesis.cells) * LAG_CELLS**lags * _inputs(case) <= LARGEST_PAIRS


def _one_sample(case: Case, delays: Mapping[str, float]) -> bool:
    """True if every input's delay is nearest to one sample, and the controller can remember the pending input."""
    if case.domain is None or case.synthesis is None or set(delays) != set(case.plant.inputs):
        return False
    near = all(0.5 <= d / case.domain.tau < 1.5 for d in delays.values())
    free = case.sensing is None or case.sensing.latency == case.sensing.known_delay
    inputs = _inputs(case)
    cells = math.prod(case.synthesis.cells)
    whole = specification_of(case).on_true_cells
    size = cells * inputs * packed_width(inputs) if whole else bytes_of_nodes(cells, inputs)
    return near and free and size <= LARGEST_TABLES


def _inputs(case: Case) -> int:
    return int(np.prod([len(u.list()) for u in case.domain.U.values()])) if case.domain else 0


SUFFIX, TITLE = "_corrected", ", with the corrected model"


def corrected_case(
    case_path: Path,
    target: Path,
    applied: Sequence[AppliedEffect],
    data: Sequence[Path],
    rig: str,
    sentence: str,
    remainder: RemainderUse | None = None,
    urdf: str | None = None,
    simulated: ActedOut | None = None,
) -> str:
    """The text of the corrected case file.

    Args:
        case_path: the original case.
        target: where the corrected one will stand; relative paths are rewritten to hold from there. Plug-in files are
            named as `plugin_copies` has them, which the caller writes there.
        applied: effects to add, in the order in which they act.
        data: the recordings that were used.
        rig: 'simulator' if the recordings are of the case's own simulator: the nominal model alone gets the effects.
            Else the simulator gets those of `simulated` too.
        sentence: the verdict in words, for the comment on top.
        urdf: the model file that stands in place of the plant's, beside the target.
        simulated: what the simulator acts out of them; None: all.
        remainder: one-step bounds of what is left, for gamma to take in; the case then has a `gap:` section.

    Raises:
        UserError: if the result does not check, which an original that checks makes impossible but for the name.
    """
    content, words = _moved(case_path, target.parent, data), tuple[str, ...]()
    if urdf is not None:
        content["plant"]["urdf"] = urdf
    if applied or urdf is not None:
        content["name"] = str(content["name"]).removesuffix(SUFFIX) + SUFFIX
        if content.get("title"):
            content["title"] = str(content["title"]).removesuffix(TITLE) + TITLE
    if applied:
        _append(content["plant"], applied)
        if rig != "simulator":
            shared = applied if simulated is None else simulated.effects
            readings = dict.fromkeys(r for a in applied if (r := effect(a.name).reading_remedy))
            words = (*readings, *_on_hardware(content, shared, target, case_path))
    if remainder is not None and remainder.by:
        content["gap"].pop("remainder_within", None)  # of an earlier diagnosis
        content["gap"] |= _remainder(remainder)
    checked = parse_case(yaml.safe_load(_dumped(content)), target, case_path)
    _ = PlantModel.of(checked, target.parent).corrected  # refuses what does not fit
    moved = with_plugin_copies(content, plugin_copies(checked, case_path.parent, target.parent))
    return _header(applied, rig, sentence, content, words, urdf, simulated) + _dumped(moved)


def _moved(case_path: Path, folder: Path, data: Sequence[Path]) -> dict[str, Any]:
    """The plain content of a case, its paths as they hold from another folder, with these recordings."""
    content = copy.deepcopy(case_content(case_path))
    move_files(content, lambda path: reading.relative(case_path.parent / path, folder))
    if isinstance(content.get("measured"), dict):
        content["measured"]["files"] = [reading.relative(path, folder) for path in data]
    return content


def _remainder(use: RemainderUse) -> dict[str, Any]:
    own: dict[str, Any] = {"remainder": {name: float(v) for name, v in use.by.items()}}
    rest = use.near_rest
    if rest is not None:
        where = {rest.velocity: [-float(rest.below), float(rest.below)]}
        own["remainder_within"] = [{"where": where, "by": {name: float(v) for name, v in rest.by.items()}}]
    return own


def _dumped(content: Mapping[str, Any]) -> str:
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)


def _append(section: dict[str, Any], effects: Sequence[AppliedEffect]) -> None:
    """More effects in a section of a case."""
    section["effects"] = [*section.get("effects", []), *(_added(a).model_dump() for a in effects)]


def _on_hardware(
    content: dict[str, Any], added: Sequence[AppliedEffect], target: Path, case_path: Path
) -> tuple[str, ...]:
    """The simulator gets what moves the plant; delay and lag that it has become states while they stay small."""
    moving = [a for a in added if not effect(a.name).reading_remedy]
    if moving and isinstance(content.get("simulator"), dict):
        _append(content["simulator"], moving)
    case = parse_case(content, target, case_path)
    # what a simulator does not remember is no state of a roll-out
    remembering = case.plant if case.simulator is None else case.simulator
    late = {(e.name, e.on) for e in remembering.effects}
    every = [AppliedEffect(e.name, e.on, e.parameters) for e in case.plant.effects]
    shared = [e for e in every if not effect(e.name).remembers or (e.name, e.on) in late]
    return remember_commands(content, case, shared)


def _added(a: AppliedEffect) -> AddedEffect:
    """The effect as a case has it."""
    return AddedEffect(name=a.name, on=a.on, parameters={symbol: float(v) for symbol, v in a.values.items()})


def _header(
    applied: Sequence[AppliedEffect], rig: str, sentence: str, content: dict[str, Any], words: Sequence[str],
    urdf: str | None, simulated: ActedOut | None = None,
) -> str:  # fmt: skip
    lines = [f"Corrected by simgap diagnose. {sentence}"]
    if urdf is not None:
        lines.append(f"plant.urdf is {urdf}, which has the inertial parameters that were found.")
    if not applied and urdf is None:
        lines.append("Nothing was added: this is the original case, with its paths relative to this file.")
    elif applied and rig == "simulator":
        lines.append(
            "The effects below plant.effects were found in recordings of the simulator: the model alone has them."
        )
    elif "simulator" in content and not all(effect(a.name).reading_remedy for a in applied):
        lines.append(
            "Found on hardware: the nominal model and the simulator both have the effects that move the plant."
            if simulated is None
            else f"The effects below plant.effects are in the nominal model. {simulated.reason}"
        )
    elif applied:
        lines.append("The effects found in the recordings are below plant.effects.")
    return "".join(f"# {one_line(line)}\n" for line in (*lines, *words))
