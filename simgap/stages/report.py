"""Stage `report`: the page of a case, and the figures that a script wants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simgap.gap.load import from_json
from simgap.io.atomic import write_text
from simgap.io.controller_file import load_controller
from simgap.io.documents import read_json, write_json
from simgap.io.pages import REPORTS, render
from simgap.io.parquet import read_parquet
from simgap.io.traces import NOMINAL, ROBUST, split
from simgap.provenance import provenance
from simgap.report.content import content, summary
from simgap.report.figures import draw
from simgap.report.material import Corrected, Material
from simgap.stages.context import Context, log
from simgap.stages.measured_share import FILE, share_inside


@dataclass(frozen=True)
class Inputs:
    """Files that the page is made from.

    Attributes:
        gaps: gap.json of each eps, the case's own among them; samples: thinned samples of the gap.
        nominal, robust: folders with controller.npz and synthesis.json; validation: with validation.json and traces.
        diagnosis: folder with diagnosis.json and report.html, if there is one.
        corrected: folder of the corrected case's results, with summary.json and synthesis/, if there is one.
    """

    gaps: Sequence[Path]
    samples: Path
    nominal: Path
    robust: Path
    validation: Path
    diagnosis: Path | None = None
    corrected: Path | None = None


def run(case_path: Path, inputs: Inputs, out: Path, figures_out: Path) -> None:
    """Read the results of a case, write its page and its summary.

    Raises:
        UserError: a result that is missing or damaged.
    """
    material = read(case_path, inputs)
    record = provenance("report", material.context.case, material.context.folder)
    said = content(material)
    figures, notes = draw(material)
    page = render("report.html.j2", figures=figures, notes=notes, provenance=record, **said)
    write_text(out, page)
    write_json(figures_out, summary(material, said) | {"provenance": record})
    log.info("page of %d kB", len(page) // 1024)


def read(case_path: Path, inputs: Inputs) -> Material:
    """Everything that the page needs, in memory."""
    context = Context.load(case_path)
    sweep = sorted((read_json(path) for path in inputs.gaps), key=lambda g: -float(g.get("eps", 0.0)))
    grid = context.case.grid
    gap = min(sweep, key=lambda g: abs(float(g["eps"]) - grid.eps)) if grid is not None else sweep[-1]
    folders = {NOMINAL: inputs.nominal, ROBUST: inputs.robust}
    table = read_parquet(inputs.validation / "traces.parquet")
    return Material(
        context=context,
        sweep=sweep,
        gap=gap,
        bound=from_json(gap),
        samples=read_parquet(inputs.samples),
        syntheses={kind: read_json(folder / "synthesis.json") for kind, folder in folders.items()},
        controllers={kind: load_controller(folder / "controller.npz") for kind, folder in folders.items()},
        validation=read_json(inputs.validation / "validation.json"),
        traces=split(table, context.states, context.inputs),
        diagnosis=read_json(inputs.diagnosis / "diagnosis.json") if inputs.diagnosis else None,
        corrected=_corrected(context, inputs, gap) if inputs.corrected else None,
        printed=printed_values(context.case.name),
    )


def _corrected(context: Context, inputs: Inputs, gap: Mapping[str, Any]) -> Corrected:
    folder = inputs.corrected or Path()
    controllers = {kind: load_controller(folder / "synthesis" / kind / "controller.npz") for kind in (NOMINAL, ROBUST)}
    return Corrected(read_json(folder / "summary.json"), controllers, _inside(context, inputs, gap))


def _inside(context: Context, inputs: Inputs, gap: Mapping[str, Any]) -> dict[str, Mapping[str, float] | None]:
    """Measured transitions against both bounds, where the diagnosis and the corrected bound are there."""
    found, bounds = inputs.diagnosis, sorted((inputs.corrected or Path()).glob("gap/*/gap.json"))
    if found is None or not (found / FILE).is_file() or not bounds:
        return {}
    noise = read_json(found / "diagnosis.json")["noise"]
    later = Context.load(found / "corrected_case.yaml")
    if later.states != context.states:
        return {}
    sides = {"before": (context, from_json(gap), False), "after": (later, from_json(read_json(bounds[-1])), True)}
    return {
        side: share_inside(own, found / FILE, own.plant.sampled, bound, noise, late)
        for side, (own, bound, late) in sides.items()
    }


def printed_values(case: str) -> Mapping[str, Any]:
    """What the paper prints for this case; nothing for most."""
    import yaml

    content: Mapping[str, Any] = yaml.safe_load((REPORTS / "paper.yaml").read_text())
    return content.get(case, {})
