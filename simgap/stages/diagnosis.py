"""Stage `diagnosis`: recordings in, the missing effect and the corrected case out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.measured import MeasuredSection, matching_files, named_recordings
from simgap.config.named_files import plugin_copies
from simgap.correction.corrected_case import acted_out, corrected_case, measured_out
from simgap.correction.remainder import bound_remainder, use_of
from simgap.diagnosis.arms.diagnose import diagnose_arm
from simgap.diagnosis.arms.problem import TERMS, Payload
from simgap.diagnosis.diagnose import diagnose_mended
from simgap.diagnosis.record.conditions import conditioned, under_conditions
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.record.survey import Survey, survey
from simgap.diagnosis.record.traces import Reading, same_file
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings
from simgap.diagnosis.search.watch import answered
from simgap.diagnosis.thresholds import MOST
from simgap.effects import apply_effects, effect
from simgap.errors import UserError
from simgap.io.atomic import write_bytes, write_text
from simgap.io.pages import need_template
from simgap.io.recordings.measured import load_reading
from simgap.io.recordings.tables import rig_record
from simgap.io.rerun.diagnosis import write_recording
from simgap.io.results import table, write_json, write_parquet
from simgap.io.urdf_file import with_inertial
from simgap.lint.measured import check_measured, refuse_links, refuse_unknown
from simgap.model.tree import Tree
from simgap.notation import number, pretty_unit
from simgap.plants.context import Context
from simgap.report.diagnosis_document import arm_document, document
from simgap.report.diagnosis_page import ARM_TEMPLATE, TEMPLATE, draw, draw_arm, page
from simgap.report.measured_share import transition_columns
from simgap.report.missing import Missing, missing_terms
from simgap.stages import log

ROUNDED = 1e-6
"""A number that was logged in single precision is as far off, over its size."""


def outside(context: Context, record: Record) -> str | None:
    """A sentence about readings and commands outside X and between no ends of U; None if there are none.

    States that wrap around are never outside. Where most of the record is outside, its columns may be others; without
    a bound of the gap that alone is told.
    """
    case = context.case
    if case.domain is None or not record.rows:
        return None
    y, u = (np.concatenate([getattr(trace, n) for trace in record.traces]) for n in ("y", "u"))
    values = dict(zip((*record.measured, *record.inputs), (*y.T, *u.T), strict=True))
    states = [n for n in context.states if n in values and n not in case.domain.periodic]
    ends = [(n, "X", *case.domain.X[n]) for n in states]
    ends += [(n, "U", float(own.min()), float(own.max())) for n in context.inputs for own in [case.domain.U[n].list()]]
    outside_parts, any_of = [], np.zeros(record.rows, dtype=bool)
    for name, where, lo, hi in ends:
        beyond = np.maximum(lo - values[name], values[name] - hi)
        out = beyond > ROUNDED * max(hi - lo, abs(lo), abs(hi))
        any_of |= out
        if out.any():
            far, unit = float(values[name][np.argmax(beyond)]), pretty_unit(context.units[name])
            outside_parts.append(f"{name} reaches {number(far, 3)} {unit}, {where} [{number(lo, 3)}, {number(hi, 3)}]")
    share = float(any_of.mean())
    if not outside_parts or (case.gap is None and share <= MOST):
        return None
    bound = "" if case.gap is None else ", where its bound of the gap says nothing"
    check = " If that is not meant, compare units, signs and order of the columns." if share > MOST else ""
    return (
        f"{number(100.0 * share, 2)} % of the samples lie outside the case's X and U{bound}: "
        f"{'; '.join(outside_parts)}.{check}"
    )


JSON, CASE, TRANSITIONS = "diagnosis.json", "corrected_case.yaml", "transitions.parquet"
PAGE, RECORDING, MODEL = "report.html", "residual.rrd", "corrected.urdf"


def run(
    case_path: Path, data: Sequence[Path], out_dir: Path, progress: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Diagnose recordings and write `diagnosis.json`, `report.html`, `corrected_case.yaml`, `residual.rrd`, pictures,
    `transitions.parquet`.

    Args:
        case_path: the case; it needs a nominal model alone.
        data: CSV, Parquet, JSON or MCAP files; if empty, those that the case names under `measured.files`.
        out_dir: where the results go; it is made, and everything in it appears whole or not at all.
        progress: told in words what is being done.

    Returns:
        the content of `diagnosis.json`.

    Raises:
        UserError: whatever is wrong with the case or the data, naming file, row or key and the remedy.
    """

    def tell(words: str) -> None:
        log.info("%s", words)
        if progress is not None:
            progress(words)

    need_template(TEMPLATE)
    context = Context.load(case_path)
    section = context.case.measured or MeasuredSection()
    paths = _paths(context, section, data)
    for path in paths if section.rig == "simulator" else ():  # of the case's own simulator, as it says
        if (record := rig_record(path)) is not None:
            context.own(path, record, "rig")
    with context.blame():
        tree = None if context.plant.declared.derived else context.plant.tree
        model = context.plant.corrected if tree is None else context.plant.declared
        if tree is None:
            refuse_unknown(section, model)
        else:
            refuse_links(context, section)
        tell(f"reading {len(paths)} file{'s' if len(paths) != 1 else ''}")
        reading = load_reading(model, section, paths, context.folder, str(case_path), strict=not data)
        record = reading.record
        tell(f"{record.rows} samples in {len(record.traces)} traces; measured: {', '.join(record.measured)}")
        look = survey(record, model, section.noise)
    if tree is not None:
        return diagnose_arm_recordings(context, tree, section, reading, look, paths, out_dir, tell)
    with context.blame():
        for warning in (*reading.warnings, *look.warnings):
            log.warning("%s", warning)
        record, names = under_conditions(reading, model, section.conditions)
        tell("searching for what the model lacks")
        settings = settings_of(context.case, section, reading)
        found, mended = diagnose_mended(conditioned(model, names), record, settings, tell)
        reading = replace(reading, record=mended)
        if (beyond_domain := outside(context, mended)) is not None:
            log.warning("%s", beyond_domain)
            reading = replace(reading, warnings=(*reading.warnings, beyond_domain))
    tell("bounding what is left")
    return conclude(context, section, found, reading, look, paths, out_dir, tell)


def conclude(
    context: Context,
    section: MeasuredSection,
    found: Diagnosis,
    reading: Reading,
    look: Survey,
    paths: Sequence[Path],
    out_dir: Path,
    tell: Callable[[str], None] = lambda words: None,
) -> dict[str, Any]:
    """Bound what is left, write the answer, say it, then draw it: the content of `diagnosis.json`."""
    case, plant, domain, record = context.case, context.plant, context.case.domain, reading.record
    differing = record.inputs[len(context.inputs) :]  # parameters that differ among the recordings
    usual = {n: plant.corrected.parameters[n].value for n in differing}
    model, shifts = plant.corrected_by(found.applied)
    declared, corrected, remembering = (
        conditioned(m, differing) for m in (plant.corrected, model, apply_effects(plant.corrected, found.applied))
    )
    noise = {name: found.sigma[name] for name in record.measured}
    tau, X = (0.0, {}) if domain is None else (domain.tau, domain.X)
    limits = {s: ends for s, ends in X.items() if s in corrected.state_names}
    remainder = bound_remainder(
        found.windows, noise, (declared, corrected), shifts, tau, section.confidence, limits, usual, remembering
    )
    use = use_of(remainder, found.verdict, section.rig, case.gap is not None, case.hidden_state is not None)
    with context.blame():
        simulated = measured_out(context, section, found, (record.measured, record.inputs))
    content = document(found, reading, look, remainder, use, context.units, context.record("diagnosis"))
    content["simulator"] = simulated.document() if simulated is not None else None
    out_dir.mkdir(parents=True, exist_ok=True)  # first: `out/../rod.urdf` is no file before
    text = corrected_case(
        context.path, out_dir / CASE, found.applied, paths, section.rig, content["sentence"], use, simulated=simulated
    )
    columns = transition_columns(context, found.windows, noise, corrected, shifts, usual)
    write_answer(context, content, text, columns, out_dir)
    tell(f"{content['verdict']}: {content['sentence']}")
    lacking = missing_terms(record, declared, corrected, shifts, np.array(list(noise.values())))
    _show(context, found, record, content, lacking, out_dir)
    return content


def _paths(context: Context, section: MeasuredSection, data: Sequence[Path]) -> list[Path]:
    if data:
        return [found for path in data for _, found in matching_files(Path(), [str(path)], typed=True)]
    if not section.files:
        remedy = "Name CSV, Parquet, JSON or MCAP files on the command line or here."
        raise UserError("no data are given", file=context.path, key="measured.files", remedy=remedy)
    check_measured(context)
    return named_recordings(context.path, section.files)


def settings_of(case: Case, section: MeasuredSection, reading: Reading) -> DiagnosisSettings:
    """Settings that the case asks of a diagnosis of these recordings."""
    return DiagnosisSettings(
        window_s=section.window_s,
        horizon_s=section.horizon_s,
        noise=dict(section.noise),
        effects=section.effects,
        known=section.known,
        within=case.domain.X if case.domain is not None else {},
        max_effects=section.max_effects or DiagnosisSettings.max_effects,
        most_off_floor=section.max_effects or DiagnosisSettings.most_off_floor,
        held_out_traces=reading.held_out,
        held_out_share=section.held_out.fraction,
        budget_s=section.budget_s,
    )


def _show(
    context: Context, found: Diagnosis, record: Record, content: Mapping[str, Any], lacking: Sequence[Missing],
    out_dir: Path,
) -> None:  # fmt: skip
    """Write the files that show the answer: page, pictures, recording."""
    inputs = record.inputs[: len(context.inputs)]
    windows = [replace(w, inputs=w.inputs[:, : len(inputs)]) for w in found.windows]
    figures = draw(content, windows, (record.measured, inputs), lacking, out_dir)
    write_text(out_dir / PAGE, page(content, context.case.title or context.case.name, figures))
    names = (record.measured, inputs, context.units, context.case.name)
    write_recording(out_dir / RECORDING, windows, *names, content["sentence"])


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
        write_bytes(out_dir / plugin.file, plugin.content)
    write_text(out_dir / CASE, case)
    write_json(out_dir / JSON, content)


def diagnose_arm_recordings(
    context: Context, tree: Tree, section: MeasuredSection, reading: Reading, look: Survey, paths: Sequence[Path],
    out_dir: Path, tell: Callable[[str], None],
) -> dict[str, Any]:  # fmt: skip
    """Diagnose recordings of an arm, as they were read, and write `diagnosis.json`, `report.html`,
    `corrected_case.yaml`, `residual.rrd`, pictures, `transitions.parquet` (no rows: no bound could be compared with
    them), and `corrected.urdf` where inertial parameters were found.

    Raises:
        UserError: whatever is wrong with the case or the data, naming file, row or key and the remedy.
    """
    need_template(ARM_TEMPLATE)
    record, model, case = reading.record, context.plant.declared, context.case
    with context.blame():
        inputs = [_drive(context, joint) for joint in tree.joints]
        ends = [model.coordinate(joint) for joint in tree.joints]
        settings, known = settings_of(context.case, section, reading), _known(context, tree, inputs)
        search = partial(diagnose_arm, tree, record, ends, inputs, settings, _payloads(section, reading), known)
        found = answered(section.budget_s, search, tell)
    for warning in (*reading.warnings, *look.warnings, *found.warnings):
        log.warning("%s", warning)
    made_of = context.record("diagnosis")
    content = arm_document(found, reading, look, tree, inputs, context.units, made_of)
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
    none = {n: np.zeros(0) for n in (*nothing, *(f"next_{n}" for n in record.measured))}  # is compared with gamma
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
        remedy = "An arm of three joints or more is diagnosed from the measured torque of each joint: name one each."
        raise UserError(f"joint '{joint}' has {len(found)} inputs", key="plant.inputs", remedy=remedy)
    return found[0]


def _payloads(section: MeasuredSection, reading: Reading) -> tuple[Payload, ...]:
    found = []
    for k, p in enumerate(section.payloads):
        traces = tuple(n for n, (file, _) in reading.origins.items() if same_file(p.file, file))
        if not traces:
            remedy = "Name one of the files."
            raise UserError(f"'{p.file}' is not among the data", key=f"measured.payloads.{k}.file", remedy=remedy)
        if set(traces) <= set(reading.held_out):
            problem = f"'{p.file}' is held out, so that nothing says what its payload is"
            raise UserError(problem, key=f"measured.payloads.{k}.file", remedy="Hold out a different file.")
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
            problem = f"the effect '{e.name}' on '{e.on}' cannot be in the model of an arm of {tree.size} joints"
            remedy = f"Known on its joints and inputs: {', '.join(TERMS)}, input_gain."
            raise UserError(problem, key=f"plant.effects.{k}", remedy=remedy)
        (p,) = effect(e.name).parameters
        values, at = known.setdefault(e.name, np.full(tree.size, p.null)), list(places).index(e.on)
        values[at] = values[at] * e.values[p.symbol] if p.null else values[at] + e.values[p.symbol]
    return known
