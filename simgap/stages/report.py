"""Stage `report`: the page of a case, and the figures that a script wants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from simgap.config.load_yaml import read_yaml
from simgap.errors import UserError
from simgap.gap.bounds.function import GapFunction
from simgap.io.atomic import write_bytes, write_text
from simgap.io.controller_file import load_domain_of
from simgap.io.documents import read_json, write_json
from simgap.io.gap_file import SavedGap, load_gap
from simgap.io.pages import need_template, render
from simgap.io.parquet import read_parquet
from simgap.io.traces import NOMINAL, ROBUST, split
from simgap.paper import suprema_and_constants
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.report.case_figures import draw
from simgap.report.content import content, summary
from simgap.report.material import Corrected, Material
from simgap.report.measured_share import share_inside
from simgap.stages import log
from simgap.stages.gap_inputs import result_of, table_of

TEMPLATE = "report.html.j2"


@dataclass(frozen=True)
class Measured:
    """Files of a diagnosis: diagnosis.json, the transitions that it held out (if they are there)."""

    document: Path
    transitions: Path | None = None


@dataclass(frozen=True)
class CorrectedFiles:
    """Files of the corrected case: itself, its bound, its summary, its controllers by kind."""

    case: Path
    gap: Path
    summary: Path
    controllers: Mapping[str, Path]


@dataclass(frozen=True)
class Inputs:
    """Files that the page is made from, every one of them.

    Attributes:
        gaps: gap.json of each eps, the case's own among them; samples: thinned samples of the gap.
        controllers, syntheses: controller.npz and synthesis.json by kind, "nominal" and "gap".
        validation, traces: validation.json and traces.parquet.
        diagnosis, corrected: what measured data said, and the case that it corrected, if there are any.
        printed: the values that the paper prints, if they are to stand beside.
        audit, margins: audit.json and margins.parquet, if the adversary has been there.
        twin: twin.json, if the simulator stands for another engine.
    """

    gaps: Sequence[Path]
    samples: Path
    controllers: Mapping[str, Path]
    syntheses: Mapping[str, Path]
    validation: Path
    traces: Path
    diagnosis: Measured | None = None
    corrected: CorrectedFiles | None = None
    printed: Path | None = None
    audit: Path | None = None
    margins: Path | None = None
    twin: Path | None = None


def by_kind(nominal: Path, robust: Path) -> dict[str, Path]:
    """Files of the two kinds of controller."""
    return {NOMINAL: nominal, ROBUST: robust}


def corrected_files(
    case: Path | None, gap: Path | None, summary: Path | None, nominal: Path | None, robust: Path | None
) -> CorrectedFiles | None:
    """The files of a corrected case: all of them, or none.

    Raises:
        UserError: only some are given.
    """
    if case is None:
        return None
    if gap is None or summary is None or nominal is None or robust is None:
        raise UserError(
            "the corrected case needs its bound, its summary and both controllers",
            file=case,
            remedy="Give --corrected-gap, --corrected-summary, --corrected-nominal and --corrected-robust.",
        )
    return CorrectedFiles(case, gap, summary, by_kind(nominal, robust))


def run(
    case_path: Path,
    inputs: Inputs,
    out: Path,
    figures_out: Path,
    picture: Path | None = None,
    folder: Path | None = None,
    later: str | None = None,
) -> None:
    """Read the results of a case, write its page and its summary.

    Args:
        picture: file for a small PNG that stands for the case; folder: place for the figures of the page as files;
            later: the page, seen from this one, that will have what this one did not wait for.

    Raises:
        UserError: a result that is missing or damaged.
    """
    need_template(TEMPLATE)
    material = read(case_path, inputs)
    record = provenance("report", material.context.case, material.context.folder)
    said = content(material)
    write_json(figures_out, summary(material, said) | {"provenance": record})
    drawn = draw(material)
    page = render(TEMPLATE, figures=drawn.markup, notes=drawn.notes, later=later, provenance=record, **said)
    if folder is not None:
        for name, data in drawn.files.items():
            write_bytes(folder / name, data)
    if picture is not None:
        write_bytes(picture, drawn.picture)
    write_text(out, page)
    log.info("page of %d kB", len(page) // 1024)


def read(case_path: Path, inputs: Inputs) -> Material:
    """Everything that the page needs, in memory."""
    context = Context.load(case_path)
    bounds = sorted((load_gap(path, context) for path in inputs.gaps), key=lambda g: -_eps(g))
    grid = context.case.grid
    gap = min(bounds, key=lambda g: abs(_eps(g) - (grid.eps or 0.0))) if grid is not None else bounds[-1]
    given, found, later = inputs.printed, inputs.diagnosis, inputs.corrected
    printed = suprema_and_constants(read_yaml(given), context.case.name) if given is not None else {}
    return Material(
        context=context,
        sweep=[g.content for g in bounds],
        gap=gap.content,
        bound=gap.function,
        samples=table_of(context, inputs.samples, "gap"),
        syntheses={kind: result_of(context, path, "synthesis") for kind, path in inputs.syntheses.items()},
        controllers={kind: load_domain_of(path, context) for kind, path in inputs.controllers.items()},
        validation=result_of(context, inputs.validation, "validation"),
        traces=split(table_of(context, inputs.traces, "validation"), context.states, context.inputs),
        diagnosis=result_of(context, found.document, "diagnosis") if found is not None else None,
        corrected=_corrected(context, later, found, gap.function) if later is not None else None,
        printed=printed,
        audit=result_of(context, inputs.audit, "audit") if inputs.audit is not None else None,
        margins=table_of(context, inputs.margins, "audit") if inputs.margins is not None else None,
        twin=result_of(context, inputs.twin, "twin") if inputs.twin is not None else None,
    )


def _eps(bound: SavedGap) -> float:
    """Of the point of a bound; 0 for one that has none, such as a grid of half-widths."""
    return float(bound.content.get("eps") or 0.0)


def _corrected(context: Context, files: CorrectedFiles, found: Measured | None, gap: GapFunction) -> Corrected:
    later = Context.load(files.case)
    controllers = {kind: load_domain_of(path, later) for kind, path in files.controllers.items()}
    return Corrected(result_of(later, files.summary, "report"), controllers, _inside(context, later, files, found, gap))


def _inside(
    context: Context, later: Context, files: CorrectedFiles, found: Measured | None, gap: GapFunction
) -> dict[str, Mapping[str, float] | None]:
    """Measured transitions against both bounds, where the diagnosis kept them."""
    if found is None or found.transitions is None:
        return {}
    document, rows = read_json(found.document), read_parquet(found.transitions)
    noise = document["noise"] | ((document.get("remainder") or {}).get("one_step") or {}).get("unresolved", {})
    carried = later.states != context.states  # a lag is a state of the corrected case, whose commands come at once
    sides = {"before": (context, gap, False), "after": (later, load_gap(files.gap, later).function, not carried)}
    return {
        side: share_inside(own, rows, own.plant.sampled, bound, noise, late)
        for side, (own, bound, late) in sides.items()
    }
