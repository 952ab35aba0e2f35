"""Stage `report`: the page of a case, and the figures that a script wants."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from simgap.config.load import read_yaml
from simgap.errors import UserError
from simgap.gap.bounds.function import GapFunction
from simgap.io.atomic import write_bytes, write_text
from simgap.io.controller_file import load_controller_of
from simgap.io.gap_file import SavedGap, load_gap
from simgap.io.pages import NO_CONTROLLER, need_template, render
from simgap.io.results import read_json, read_parquet, write_json
from simgap.io.traces import GAP_AWARE, NOMINAL, split
from simgap.plants.context import Context
from simgap.report.case_figures import draw
from simgap.report.content import content, summary
from simgap.report.explorer import explored_runs
from simgap.report.measured_share import share_inside
from simgap.report.tables import Corrected, Material
from simgap.stages import CasePath, GapAwareController, NominalController, Option, Out, Traces, log
from simgap.stages.gap_inputs import read_result, read_table

TEMPLATE = "report.html.j2"


@dataclass(frozen=True)
class ReportFiles:
    """Files that the page is made from, every one of them; those of a corrected case together, or none of them."""

    gaps: Annotated[list[Path], Option("gap.json of each eps.", "--gap")]
    samples: Annotated[Path, Option("Thinned samples of the gap (Parquet).")]
    nominal: NominalController
    nominal_summary: Annotated[Path, Option("Its synthesis.json.")]
    gap_aware: GapAwareController
    gap_aware_summary: Annotated[Path, Option("Its synthesis.json.")]
    validation: Annotated[Path, Option("validation.json")]
    traces: Traces
    diagnosis: Annotated[Path | None, Option("diagnosis.json, if there is one.")] = None
    transitions: Annotated[Path | None, Option("Transitions that the diagnosis held out.")] = None
    corrected: Annotated[Path | None, Option("The corrected case, if it has results.")] = None
    corrected_gap: Annotated[Path | None, Option("Its gap.json.")] = None
    corrected_summary: Annotated[Path | None, Option("Its summary.json.")] = None
    corrected_nominal: Annotated[Path | None, Option("Its controller for the nominal model.")] = None
    corrected_gap_aware: Annotated[Path | None, Option("Its controller for the model with its gap.")] = None
    twin: Annotated[Path | None, Option("twin.json, if the simulator stands for another engine.")] = None
    printed: Annotated[Path | None, Option("Values that the paper prints (YAML).")] = None
    audit: Annotated[Path | None, Option("audit.json")] = None
    margins: Annotated[Path | None, Option("Margins of every cell (Parquet).")] = None


def run(
    case_path: CasePath,
    inputs: ReportFiles,
    out: Out,
    figures_out: Annotated[Path, Option("File for the figures that a script wants (JSON).", "--summary")],
    picture: Annotated[Path | None, Option("File for a small PNG that stands for the case.")] = None,
    folder: Annotated[Path | None, Option("Folder for the figures as files.", "--figures", "folder")] = None,
    later: Annotated[str | None, Option("Path from this page to the complete one.")] = None,
) -> str:
    """Read the results of a case, write its page and its summary: -> where the page is, in words.

    Args:
        picture: file for a small PNG that stands for the case; folder: place for the figures of the page as files;
            later: the page, seen from this one, that will have what this one did not wait for.

    Raises:
        UserError: a result that is missing or damaged.
    """
    need_template(TEMPLATE)
    material = read(case_path, inputs)
    record = material.context.record("report")
    said = content(material)
    write_json(figures_out, summary(material, said) | {"provenance": record})
    drawn = draw(material)
    figures = {**drawn.markup, "explored": explored_runs(material)}
    page = render(TEMPLATE, figures=figures, later=later, provenance=record, **said)
    if folder is not None:
        for name, data in drawn.files.items():
            write_bytes(folder / name, data)
    if picture is not None:
        write_bytes(picture, drawn.picture)
    write_text(out, page)
    out.with_name(NO_CONTROLLER).unlink(missing_ok=True)
    log.info("page of %d kB", len(page) // 1024)
    if later is None:
        return f"Ready to open: {out}"
    return f"Ready to open: {out}, audit pending. Next: {os.path.normpath(out.parent / later)}"


def read(case_path: Path, inputs: ReportFiles) -> Material:
    """Everything that the page needs, in memory."""
    context = Context.load(case_path)
    bounds = sorted((load_gap(path, context) for path in inputs.gaps), key=lambda g: -_eps(g))
    grid = context.case.grid
    gap = min(bounds, key=lambda g: abs(_eps(g) - (grid.eps or 0.0))) if grid is not None else bounds[-1]
    given, found = inputs.printed, inputs.diagnosis
    controllers = {NOMINAL: inputs.nominal, GAP_AWARE: inputs.gap_aware}
    syntheses = {NOMINAL: inputs.nominal_summary, GAP_AWARE: inputs.gap_aware_summary}
    printed = suprema_and_constants(read_yaml(given), context.case.name) if given is not None else {}
    return Material(
        context=context,
        sweep=[g.content for g in bounds],
        gap=gap.content,
        bound=gap.function,
        samples=read_table(context, inputs.samples, "gap"),
        syntheses={kind: read_result(context, path, "synthesis") for kind, path in syntheses.items()},
        controllers={kind: load_controller_of(path, context, whole=False) for kind, path in controllers.items()},
        validation=read_result(context, inputs.validation, "validation"),
        traces=split(read_table(context, inputs.traces, "validation"), context.states, context.inputs),
        diagnosis=read_result(context, found, "diagnosis") if found is not None else None,
        corrected=_corrected(context, inputs, gap.function),
        printed=printed,
        audit=read_result(context, inputs.audit, "audit") if inputs.audit is not None else None,
        margins=read_table(context, inputs.margins, "audit") if inputs.margins is not None else None,
        twin=read_result(context, inputs.twin, "twin") if inputs.twin is not None else None,
    )


def _eps(bound: SavedGap) -> float:
    """Radius eps of the point of a bound; 0 for one that has none, such as a grid of half-widths."""
    return float(bound.content.get("eps") or 0.0)


def suprema_and_constants(printed: Mapping[str, Any], case: str) -> dict[str, Any]:
    """Printed numbers that the page of a case puts beside its own; empty for a case of which nothing is printed.

    Args:
        printed: content of configs/paper/printed.yaml.
        case: its name.

    Returns:
        sup_gamma: eps as text -> state -> supremum; lipschitz: state -> constant.
    """
    own = printed.get(case, {})
    if "suprema" not in own:
        return {}
    rows = {f"{row['eps']:g}": {s: v for s, v in row.items() if s != "eps"} for row in own["suprema"]}
    return {"sup_gamma": rows, "lipschitz": dict(own["L1"])}


def _corrected(context: Context, inputs: ReportFiles, gap: GapFunction) -> Corrected | None:
    """Results of the corrected case, and measured transitions against both bounds where the diagnosis kept them.

    Raises:
        UserError: only some of its files are given.
    """
    if inputs.corrected is None:
        return None
    bound, summary = inputs.corrected_gap, inputs.corrected_summary
    nominal, gap_aware = inputs.corrected_nominal, inputs.corrected_gap_aware
    if bound is None or summary is None or nominal is None or gap_aware is None:
        problem = "the corrected case needs its bound, its summary and both controllers"
        remedy = "Give --corrected-gap, --corrected-summary, --corrected-nominal and --corrected-gap-aware."
        raise UserError(problem, file=inputs.corrected, remedy=remedy)
    later = Context.load(inputs.corrected)
    paths = {NOMINAL: nominal, GAP_AWARE: gap_aware}
    controllers = {kind: load_controller_of(path, later, whole=False) for kind, path in paths.items()}
    inside: dict[str, Mapping[str, float] | None] = {}
    if inputs.diagnosis is not None and inputs.transitions is not None and later.states == context.states:
        document, rows = read_json(inputs.diagnosis), read_parquet(inputs.transitions)
        noise = document["noise"] | ((document.get("remainder") or {}).get("estimated") or {})
        sides = {"before": (context, gap, False), "after": (later, load_gap(bound, later).function, True)}
        inside = {
            side: share_inside(own, rows, own.plant.sampled, own_bound, noise, late)
            for side, (own, own_bound, late) in sides.items()
        }
    return Corrected(read_result(later, summary, "report"), controllers, inside)
