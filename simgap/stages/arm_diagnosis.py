"""Stage `diagnosis` of an arm of three joints or more: measured torques in, what joints and links lack out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.measured import MeasuredSection
from simgap.diagnosis.arms.diagnose import ArmSettings, diagnose_arm
from simgap.diagnosis.arms.problem import TERMS, Payload
from simgap.diagnosis.record.clock import same_file
from simgap.diagnosis.record.survey import Survey
from simgap.diagnosis.record.traces import Reading
from simgap.diagnosis.search.watch import answered
from simgap.effects import effect
from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.io.model_export import with_inertial
from simgap.io.pages import need_template
from simgap.io.rerun.diagnosis import write_recording
from simgap.model.tree import Tree
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.report.arm_document import document
from simgap.report.diagnosis_page import ARM_TEMPLATE, draw_arm, page
from simgap.stages import log
from simgap.stages.acted_out import acted_out
from simgap.stages.corrected_case import CASE, corrected_case, write_answer

PAGE, MODEL, RECORDING = "report.html", "corrected.urdf", "residual.rrd"


def run(
    context: Context, tree: Tree, section: MeasuredSection, reading: Reading, look: Survey, paths: Sequence[Path],
    out_dir: Path, tell: Callable[[str], None],
) -> dict[str, Any]:  # fmt: skip
    """Diagnose recordings of an arm, as they were read, and write `diagnosis.json`, `report.html`,
    `corrected_case.yaml`, `residual.rrd`, pictures, `transitions.parquet` (no rows: no bound could be held against
    them), and `corrected.urdf` where inertial parameters were found.

    Raises:
        UserError: whatever is wrong with the case or the data, naming file, row or key and the remedy.
    """
    need_template(ARM_TEMPLATE)
    record, model, case = reading.record, context.plant.declared, context.case
    with context.blame():
        inputs = [_drive(context, joint) for joint in tree.joints]
        ends = [model.coordinate(joint) for joint in tree.joints]
        settings = ArmSettings(
            reading.held_out, section.held_out.fraction, section.max_effects or ArmSettings.most,
            _payloads(section, reading), _known(context, tree, inputs),
        )  # fmt: skip
        search = partial(diagnose_arm, tree, record, ends, inputs, settings)
        found = answered(section.budget_s, search, tell)
    for warning in (*reading.warnings, *look.warnings, *found.warnings):
        log.warning("%s", warning)
    made_of = provenance("diagnosis", context.case, context.folder)
    content = document(found, reading, look, tree, inputs, context.units, made_of)
    out_dir.mkdir(parents=True, exist_ok=True)
    urdf = MODEL if found.verdict in ("attributed", "partial") and found.inertial and case.plant.urdf else None
    if urdf is not None and case.plant.urdf is not None:
        write_text(out_dir / MODEL, with_inertial(context.folder / case.plant.urdf, out_dir, found.inertial))
    simulated = acted_out(context, section, found.applied)
    text = corrected_case(
        context.path, out_dir / CASE, found.applied, paths, section.rig, content["sentence"], urdf=urdf,
        simulated=simulated,
    )  # fmt: skip
    nothing = [*context.states, *(f"{k}{n}" for k in ("", "late_") for n in context.inputs)]
    none = {n: np.zeros(0) for n in (*nothing, *(f"next_{n}" for n in record.measured))}  # is held against gamma
    write_answer(context, content, text, none, out_dir)
    tell(f"{content['verdict']}: {content['sentence']}")
    figures = draw_arm(content, found.predictions, inputs, out_dir)
    write_text(out_dir / PAGE, page(content, case.title or case.name, figures, ARM_TEMPLATE))
    write_recording(out_dir / RECORDING, found.predictions, inputs, (), context.units, case.name)
    return content


def _drive(context: Context, joint: str) -> str:
    """The input that is the torque of a joint.

    Raises:
        UserError: a joint without one, or with several.
    """
    found = [name for name, i in context.case.plant.inputs.items() if i.joint == joint]
    if len(found) != 1:
        raise UserError(
            f"joint '{joint}' has {len(found)} inputs", key="plant.inputs",
            remedy="An arm of three joints or more is diagnosed from the measured torque of each joint: name one each.",
        )  # fmt: skip
    return found[0]


def _payloads(section: MeasuredSection, reading: Reading) -> tuple[Payload, ...]:
    found = []
    for k, p in enumerate(section.payloads):
        traces = tuple(n for n, (file, _) in reading.origins.items() if same_file(p.file, file))
        if not traces:
            raise UserError(
                f"'{p.file}' is not among the data", key=f"measured.payloads.{k}.file", remedy="Name one of the files."
            )
        if set(traces) <= set(reading.held_out):
            raise UserError(
                f"'{p.file}' is held out, so that nothing says what its payload is", key=f"measured.payloads.{k}.file",
                remedy="Hold out a different file.",
            )  # fmt: skip
        found.append(Payload(traces, p.link, p.mass))
    return tuple(found)


def _known(context: Context, tree: Tree, inputs: Sequence[str]) -> dict[str, Floats]:
    """Values that the case declares of each joint, effect -> (n,).

    Raises:
        UserError: an effect that an arm's diagnosis does not know.
    """
    known: dict[str, Floats] = {}
    for k, e in enumerate(context.plant.effects):
        places = inputs if effect(e.name).kind == "input" else tree.joints
        if e.name not in (*TERMS, "input_gain") or e.on not in places:
            raise UserError(
                f"the effect '{e.name}' on '{e.on}' cannot be in the model of an arm of {tree.size} joints",
                key=f"plant.effects.{k}", remedy=f"Known on its joints and inputs: {', '.join(TERMS)}, input_gain.",
            )  # fmt: skip
        (p,) = effect(e.name).parameters
        values, at = known.setdefault(e.name, np.full(tree.size, p.null)), list(places).index(e.on)
        values[at] = values[at] * e.values[p.symbol] if p.null else values[at] + e.values[p.symbol]
    return known
