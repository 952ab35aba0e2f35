"""The case with the effects that were found: a valid case file, ready to run from where it is written."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from simgap import reading
from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.domain import InputSet
from simgap.config.function_file import plugin_copies, with_plugin_copies
from simgap.config.load import case_content, parse_case
from simgap.config.model_files import move_files
from simgap.config.plant import AddedEffect
from simgap.diagnosis.verdict.remainder import RemainderUse
from simgap.effects import AppliedEffect, delays_and_lags, effect
from simgap.geometry import Box, Grid
from simgap.io.atomic import atomic, write_text
from simgap.io.documents import write_json
from simgap.io.parquet import table, write_parquet
from simgap.notation import one_line
from simgap.plants.context import Context
from simgap.plants.plant_model import PlantModel
from simgap.simulators.commands import CommandPath
from simgap.specifications.base import specification_of
from simgap.stages.acted_out import ActedOut
from simgap.synthesis.games.nodes import bytes_of_nodes
from simgap.synthesis.input_sets import LARGEST_TABLES, packed_width

LARGEST_ROLLOUTS = 2_000_000
"""Most roll-outs (cells of `grid.eps` times inputs) with a lag as a state."""
LARGEST_PAIRS = 100_000_000
"""Most pairs of a cell of `synthesis.cells` and an input with a lag as a state."""
LAG_CELLS, LAG_SAMPLES, LAG_BLOCKS = 24, 4, 2
"""Along a lagged input: cells of the abstraction, of a grid of half-widths, and of a bound in blocks."""


@dataclass(frozen=True)
class Augmentation:
    """Memory of the inputs that the corrected case carries.

    Attributes:
        lags: input -> range of what the plant feels, for each lag that becomes a state.
        pending: whether one sample of delay becomes the controller's latency.
        words: a sentence for each decision, for the head of the case.
    """

    lags: Mapping[str, tuple[float, float]]
    pending: bool
    words: tuple[str, ...]


def plan(case: Case, applied: Sequence[AppliedEffect]) -> Augmentation:
    """Decide for a case that checks, with all effects that its plant will have."""
    remembered = delays_and_lags(applied)
    lagged = sorted(on for on, (_, lag) in remembered.items() if lag > 0.0)
    delays = {on: delay for on, (delay, _) in remembered.items() if delay > 0.0}
    if case.domain is None or not (lagged or delays):
        return Augmentation({}, False, ())
    ranges = {on: _felt(case.domain.U[on], applied, on) for on in lagged}
    words = []
    fits = bool(lagged) and _rollouts(case, ranges) and _pairs(case, len(lagged))
    if lagged:
        names = ", ".join(f"{on}_lagged" for on in lagged)
        words.append(
            f"The lag is a state of the model: {names}, which the controller computes from its own commands."
            if fits
            else "The lag is not in the sampled model: as a state it would exceed "
            f"{LARGEST_ROLLOUTS:,} roll-outs or {LARGEST_PAIRS:,} pairs. Gamma covers it."
        )
    pending = bool(delays) and _one_sample(case, delays) and not fits
    if delays:
        words.append(
            "The first sample of the delay is the controller's latency: it knows which input is pending, and commands "
            "that would act earlier are held back. Gamma covers the rest."
            if pending
            else "The delay is not in the sampled model: it is not near one sample of every input, or too large with "
            "these cells and inputs, or not for this specification. Gamma covers it."
        )
    return Augmentation(ranges if fits else {}, pending, tuple(words))


def augment(content: dict[str, Any], case: Case, chosen: Augmentation) -> None:
    """Write the decision into the plain content of the case."""
    for on, ends in chosen.lags.items():
        name = f"{on}_lagged"
        if name in content["plant"]["states"]:
            continue
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
    if chosen.pending:
        content["sensing"] = {**(content.get("sensing") or {}), "latency": 1, "latency_of": "input_delay"}


def _felt(values: InputSet, applied: Sequence[AppliedEffect], on: str) -> tuple[float, float]:
    effects = [AddedEffect(name=a.name, on=a.on, parameters=dict(a.values)) for a in applied]
    return CommandPath.of(effects, on, values.list().tolist(), 0.0).felt


def _rollouts(case: Case, ranges: Mapping[str, tuple[float, float]]) -> bool:
    if case.grid is None or case.domain is None:
        return True
    own = {n: v for n, v in case.domain.X.items() if n not in {f"{on}_lagged" for on in ranges}}
    if any(lo == hi for lo, hi in (*own.values(), *ranges.values())):
        return False
    if case.grid.eps is None:
        cells = [math.ceil((own[n][1] - own[n][0]) / (2 * h)) for n, h in case.grid.half_widths.items()]
        return math.prod(cells) * LAG_SAMPLES ** len(ranges) * _inputs(case) <= LARGEST_ROLLOUTS
    ends = [*own.values(), *ranges.values()]
    grid = Grid.covering(Box([lo for lo, _ in ends], [hi for _, hi in ends]), case.grid.eps)
    return math.prod(grid.cells) * _inputs(case) <= LARGEST_ROLLOUTS


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
    if specification_of(case).on_true_cells:
        return near and free and cells * inputs * packed_width(inputs) <= LARGEST_TABLES
    return near and free and bytes_of_nodes(cells, inputs) <= LARGEST_TABLES


def _inputs(case: Case) -> int:
    return int(np.prod([len(u.list()) for u in case.domain.U.values()])) if case.domain else 0


SUFFIX = "_corrected"
JSON, CASE, TRANSITIONS = "diagnosis.json", "corrected_case.yaml", "transitions.parquet"


def write_answer(
    context: Context, content: Mapping[str, Any], case: str, columns: Mapping[str, Floats], out_dir: Path
) -> None:
    """Write the files that hold the answer, its document the last of them.

    Args:
        content: of the document; case: text of the corrected case; columns: of the transitions.
    """
    units = {c: context.units[c.removeprefix("late_").removeprefix("next_")] for c in columns}
    write_parquet(out_dir / TRANSITIONS, table(columns, units, {"case": context.case.name}, content["provenance"]))
    for plugin in plugin_copies(context.case, context.folder, out_dir):
        with atomic(out_dir / plugin.file) as temporary:
            temporary.write_bytes(plugin.content)
    write_text(out_dir / CASE, case)
    write_json(out_dir / JSON, content)


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
    content = copy.deepcopy(case_content(case_path))
    source, folder = case_path.parent, target.parent
    move_files(content, lambda path: reading.relative(source / path, folder))
    if urdf is not None:
        content["plant"]["urdf"] = urdf
    if isinstance(content.get("measured"), dict):
        content["measured"]["files"] = [reading.relative(path, folder) for path in data]
    words: tuple[str, ...] = ()
    if applied or urdf is not None:
        content["name"] = str(content["name"]).removesuffix(SUFFIX) + SUFFIX
    if applied:
        added = [_plain(a) for a in applied]
        content["plant"]["effects"] = [*content["plant"].get("effects", []), *added]
        if rig != "simulator":
            shared = applied if simulated is None else simulated.effects
            readings = dict.fromkeys(r for a in applied if (r := effect(a.name).reading_remedy))
            words = (*readings, *_on_hardware(content, [_plain(a) for a in shared], target, case_path))
    if remainder is not None and remainder.by:
        content["gap"].pop("remainder_within", None)  # of an earlier diagnosis
        content["gap"] |= _remainder(remainder)
    checked = parse_case(yaml.safe_load(_dumped(content)), target, case_path)
    _ = PlantModel.of(checked, folder).corrected  # refuses what does not fit
    moved = with_plugin_copies(content, plugin_copies(checked, source, folder))
    return _header(applied, rig, sentence, content, words, urdf, simulated) + _dumped(moved)


def _remainder(use: RemainderUse) -> dict[str, Any]:
    own: dict[str, Any] = {"remainder": {name: float(v) for name, v in use.by.items()}}
    rest = use.near_rest
    if rest is not None:
        where = {rest.velocity: [-float(rest.below), float(rest.below)]}
        own["remainder_within"] = [{"where": where, "by": {name: float(v) for name, v in rest.by.items()}}]
    return own


def _dumped(content: Mapping[str, Any]) -> str:
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)


def _on_hardware(
    content: dict[str, Any], added: Sequence[dict[str, Any]], target: Path, case_path: Path
) -> tuple[str, ...]:
    """The simulator gets what moves the plant; delay and lag that it has become states while they stay small."""
    moving = [e for e in added if not effect(e["name"]).reading_remedy]
    if moving and isinstance(content.get("simulator"), dict):
        content["simulator"]["effects"] = [*content["simulator"].get("effects", []), *moving]
    case = parse_case(content, target, case_path)
    if isinstance(content.get("simulator"), dict):  # what it does not remember is no state of a roll-out
        late = [(e["name"], e["on"]) for e in content["simulator"].get("effects", [])]
    else:
        late = [(e.name, e.on) for e in case.plant.effects]
    every = [AppliedEffect(e.name, e.on, e.parameters) for e in case.plant.effects]
    chosen = plan(case, [e for e in every if not effect(e.name).remembers or (e.name, e.on) in late])
    augment(content, case, chosen)
    return tuple(chosen.words)


def _plain(a: AppliedEffect) -> dict[str, Any]:
    return {"name": a.name, "on": a.on, "parameters": {symbol: float(v) for symbol, v in a.values.items()}}


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
    elif applied and "simulator" in content:
        lines.append(
            "The effects were found on hardware: the nominal model and the simulator both have them."
            if simulated is None
            else f"The effects below plant.effects are in the nominal model. {simulated.reason}"
        )
    elif applied:
        lines.append("The effects found in the recordings are below plant.effects.")
    return "".join(f"# {one_line(line)}\n" for line in (*lines, *words))
