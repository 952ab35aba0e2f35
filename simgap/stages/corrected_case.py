"""The case with the effects that were found: a valid case file, ready to run from where it is written."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from simgap import reading
from simgap.config.copied_plugins import copied_plugins, renamed
from simgap.config.load import case_content, parse_case
from simgap.config.model_files import move_files
from simgap.diagnosis.verdict.remainder_use import RemainderUse
from simgap.effects import AppliedEffect, effect
from simgap.notation import one_line
from simgap.plants.plant_model import PlantModel
from simgap.stages.acted_out import ActedOut
from simgap.stages.augmentation import augment, plan

SUFFIX = "_corrected"


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
            named as `copied_plugins` has them, which the caller writes there.
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
    move_files(content, lambda path: _moved(source / path, folder))
    if urdf is not None:
        content["plant"]["urdf"] = urdf
    if isinstance(content.get("measured"), dict):
        content["measured"]["files"] = [_moved(path, folder) for path in data]
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
    moved = renamed(content, copied_plugins(checked, source, folder))
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


def _moved(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(reading.real(path), reading.real(folder))).as_posix()


def _header(
    applied: Sequence[AppliedEffect], rig: str, sentence: str, content: dict[str, Any], words: Sequence[str],
    urdf: str | None, simulated: ActedOut | None = None,
) -> str:  # fmt: skip
    lines = [f"Corrected by simgap diagnose. {sentence}"]
    if urdf is not None:
        lines.append(f"plant.urdf is {urdf}, which has the inertial parameters that were found.")
    if not applied and urdf is None:
        lines.append("Nothing was added: this is the case as it was, with its paths written from here.")
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
