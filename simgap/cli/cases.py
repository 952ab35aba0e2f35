"""Commands about a case: from a model file to a checked one, its recordings, what may be exported of its results."""

from __future__ import annotations

import logging
import time
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simgap import reading
from simgap.cli.terminal import (
    AsJson,
    CasePath,
    Log,
    console,
    new_file,
    new_folder,
    progress,
    say,
    say_json,
    start_log,
    values_of,
)
from simgap.cli.workflow import PACKAGE, workflow_file
from simgap.errors import UserError, excerpt
from simgap.io.atomic import no_links_below, write_bytes

if TYPE_CHECKING:
    from simgap.stages.check import Checked

Seconds = Annotated[
    float, typer.Option(min=1.0, help="CPU time in all, of which the search for tau, X, U and cells has what is left.")
]
TUTORIAL = ("rod.yaml", "rod.urdf", "machine.urdf", "swings.csv")


def tutorial(out: Annotated[Path, typer.Option(help="Folder for the files.", callback=new_folder)] = Path()) -> None:
    """Copy the files of the tutorial here: a case, two URDFs of a rod, and a recording."""
    source = workflow_file("tutorial") if (PACKAGE / "workflow").is_dir() else PACKAGE.parent / "docs/tutorial"
    for name in TUTORIAL:
        if (out / name).exists():
            raise UserError("already exists and is left unchanged", file=out / name, remedy="Use an empty folder.")
    for name in TUTORIAL:
        write_bytes(out / name, reading.read_bytes(source / name))
    say(f"Wrote {', '.join(TUTORIAL)}. Next: simgap check rod.yaml, then simgap run rod.yaml")


def new(
    name: Annotated[str, typer.Argument(help="Name of the case: lower-case letters, digits, - and _.")],
    urdf: Annotated[Path | None, typer.Option(help="Model file of the robot.")] = None,
    mjcf: Annotated[Path | None, typer.Option(help="Model file of MuJoCo's own format.")] = None,
    equations: Annotated[bool, typer.Option("--equations", help="Equations, to be replaced by your own.")] = False,
    inputs: Annotated[str, typer.Option(help="Joints that have a drive, such as arm or shoulder,elbow.")] = "",
    joints: Annotated[str, typer.Option(help="Joints of the case, such as elbow; the others are locked.")] = "",
    base: Annotated[str, typer.Option(help="What its base is: fixed (bolted to the world) or wheels.")] = "",
    at: Annotated[
        str, typer.Option(help="Posture around which to work, such as pole=3.1416; 0 for other joints.")
    ] = "",
    out: Annotated[Path, typer.Option(help="Folder for the case.", callback=new_folder)] = Path(),
    seconds: Seconds = 120.0,
) -> None:
    """Write a commented case for your robot, NAME.yaml, which runs as it stands."""
    from simgap.extras.wizard import new_case as stage
    from simgap.extras.wizard.model_file import BASES

    if [urdf is not None, mjcf is not None, equations].count(True) != 1:
        remedy = "Give --urdf FILE, --mjcf FILE, or --equations."
        raise UserError("either a URDF, or MJCF, or equations", key="--urdf", remedy=remedy)
    of_files = {"--inputs": inputs, "--at": at, "--joints": joints, "--base": base}
    if equations and any(of_files.values()):
        key = next(key for key, given in of_files.items() if given)
        raise UserError("belongs to a model file", key=key, remedy="Write it into the equations.")
    if base not in ("", *BASES):
        raise UserError(f"'{excerpt(base, 40)}' is not a base", key="--base", remedy=f"Known: {', '.join(BASES)}.")
    named, kept = ([n.strip() for n in said.split(",") if n.strip()] or None for said in (inputs, joints))
    notes, posture = list[str](), values_of(at, "--at")
    left = seconds - time.process_time()  # what Python and imports took counts
    with progress("reading the model") as tell:
        path = stage.run(name, urdf, out, named, posture, tell, notes.append, left, mjcf, kept, base or None)
    for line in [*notes, f"Wrote {path}. Next: simgap check {path}, then simgap run {path}"]:
        say(line)


def check(
    case: CasePath,
    out: Annotated[Path | None, typer.Option(help="File for the findings (JSON).", callback=new_file)] = None,
    as_json: AsJson = False,
    log: Log = None,
) -> None:
    """Check a case before a run: model file, engine, cells, and the cost of every stage."""
    from simgap.stages import check as stage

    start_log(log)
    if log is None:  # the findings are shown below
        logging.getLogger("simgap").setLevel(logging.ERROR)
    with progress("reading the case") as tell:
        checked = stage.run(case, out, log, tell)
    if as_json:
        say_json(asdict(checked))
    else:
        _show_checked(checked, case)


def _show_checked(checked: Checked, case: Path) -> None:
    """A table of what the stages cost, the cells an axis, what the engine makes of the model file, and what follows."""
    from rich.table import Table

    from simgap.lint.costs import duration, size
    from simgap.stages.check import conclusion

    out = console()
    line = partial(out.print, soft_wrap=True, highlight=False)
    if checked.costs:
        table = Table("stage", "what", "CPU time, about", "memory, about", box=None)
        for cost in checked.costs:
            table.add_row(cost.stage, f"{cost.count:,} {cost.of}", duration(cost.seconds), size(cost.bytes))
        out.print(table)
    for what, cells in checked.cells.items():
        out.print(f"cells of the {what}: {', '.join(f'{name} {count}' for name, count in cells.items())}")
    for recording in checked.recordings:
        line(f"recording {recording}")
    for finding in checked.findings:
        line(f"{finding.key}: {finding.problem}. {finding.remedy}")
    if checked.compared and not checked.findings:
        out.print("The engine takes the model file as it is: nothing is dropped or changed.")
    if not checked.costs:
        line("Only a diagnosis: a bound takes both `domain:` and `simulator:`, a controller `synthesis:` as well.")
    line(conclusion(checked, case))


def propose(
    case: CasePath,
    at: Annotated[str, typer.Option(help="Posture around which to work, such as q2=3.1416; 0 for other states.")] = "",
    seconds: Seconds = 120.0,
) -> None:
    """Find tau, X, U and cells for which the nominal model has a controller, and print the sections for the case."""
    from simgap.extras.wizard import propose as stage

    with progress("building the nominal model") as tell:
        found = stage.run(case, values_of(at, "--at"), tell, seconds - time.process_time())
    say(found.block())
    for doubt in filter(None, (found.small, found.doubtful)):
        say(doubt, err=True)


def refine(
    case: CasePath,
    samples: Annotated[
        int | None, typer.Option(min=1, help="At most so many, all inputs counted; by default as many as now.")
    ] = None,
) -> None:
    """Find the states along which the sample grid must be fine, and print the section for the case."""
    from simgap.extras.refine import refine as refined

    with progress("building the nominal model") as tell:
        found = refined(case, samples, tell)
    say(found.block())
    for name, then in found.then.items():
        say(f"# {name}: within a cell the bound loses {then:.2g} on average, now {found.now[name]:.2g}")


def diagnose(
    case: CasePath,
    data: Annotated[list[Path] | None, typer.Argument(help="Recordings; those of the case if none is given.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.", callback=new_folder)] = Path("diagnosis"),
    as_json: AsJson = False,
    log: Log = None,
) -> None:
    """Find the physical effects that the nominal model lacks, from recordings."""
    from simgap.stages import diagnosis as stage

    if out != Path():  # before the search, and not when its results are written; beside the case there may be links
        no_links_below(out)
    journal = log or out / "diagnosis.log"
    start_log(journal)
    out.mkdir(parents=True, exist_ok=True)  # paths of the corrected case begin there
    try:
        with progress("starting") as tell:
            result = stage.run(case, data or [], out, tell)
    except (UserError, OSError, MemoryError):  # nothing half-written is left, the log of a default place included
        if log is None:
            journal.unlink(missing_ok=True)
        with suppress(OSError):
            out.rmdir()
        raise
    if as_json:
        say_json(result)
        return
    first, *rest = result.get("sentences", [result["sentence"]])
    said = (*result["columns"], *result["warnings"])
    for line in (f"{result['verdict']}: {first}", *rest, *said, f"Report: {out / 'report.html'}"):
        say(line)


def next_experiment(
    case: CasePath,
    found: Annotated[Path, typer.Argument(help="Folder of a diagnosis of it.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for the results.", callback=new_folder)] = Path("next"),
    seconds: Annotated[float | None, typer.Option(min=0.0, help="How long the recording is, s.")] = None,
    start: Annotated[str, typer.Option(help="State at its first sample, such as q=0.5,v=0.")] = "",
    log: Log = None,
) -> None:
    """Propose a recording that separates the explanations a diagnosis left open."""
    from simgap.extras import next as stage

    start_log(log or out / "next.log")
    with progress("starting") as tell:
        result = stage.run(case, found, out, seconds, values_of(start, "--start"), tell)
    for line in (result["paragraph"], f"Picture: {out / 'next.png'}" if result["input"] else ""):
        say(line)


def effects(
    case: Annotated[Path | None, typer.Argument(help="Case file; lists what it can act on.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the effects with formula, parameters and units; with a case, what each can act on."""
    from simgap.stages.effects import listed, printed

    start_log(None)
    if as_json:
        say_json(listed(case))
    else:
        say(printed(listed(case)))


def certify(
    what: Annotated[Path, typer.Argument(help="Case file, or its folder in results/.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for the certificate.", callback=new_folder)] = Path("certificate"),
    bound: Annotated[Path | None, typer.Option("--gap", help="gap.json, if it is elsewhere.")] = None,
    controller: Annotated[Path | None, typer.Option(help="controller.npz, if it is elsewhere.")] = None,
    log: Log = None,
) -> None:
    """Export a controller as a certificate that checker/check.py verifies without simgap."""
    from simgap.extras import certify as stage

    start_log(log)
    if bound is not None and controller is not None:
        stage.run(what, bound, controller, out)
    else:
        case, own_bound, own_controller = stage.results_of(what) if what.is_dir() else stage.of_case(what)
        stage.run(case, bound or own_bound, controller or own_controller, out)
    say(f"Wrote {out}. Verify it without simgap: python {workflow_file('checker/check.py')} {out}")


def export(
    what: Annotated[Path, typer.Argument(help="controller.npz, or a case file with effects.", show_default=False)],
    out: Annotated[
        Path, typer.Option(help="law.h, law.py, model.urdf or model.xml (MJCF).", show_default=False, callback=new_file)
    ],
) -> None:
    """Write a controller as a C header or a Python file, or the model of a case with its effects as a URDF or MJCF."""
    from simgap.extras.model_export import export_model
    from simgap.io.controller_file import export_controller, load_controller

    if what.suffix in (".yaml", ".yml"):
        export_model(what, out)
    else:
        controller = load_controller(what)
        export_controller(controller, out)
        cells, size = len(controller.choice), out.stat().st_size
        held = f"; compiled, its table takes {2 * cells:,}, 2 for each of {cells:,} cells" if out.suffix == ".h" else ""
        say(f"Wrote {out}, {size:,} bytes{held}.")
