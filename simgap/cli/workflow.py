"""`simgap run`: all stages of a person's own cases, by the workflow that the package carries; no checkout needed."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
import yaml

from simgap import reading
from simgap.cli import start
from simgap.cli.options import CasePath, app, new_folder, values_of
from simgap.cli.terminal import say
from simgap.config.case import Case
from simgap.errors import SimgapError, UserError, excerpt
from simgap.io.atomic import host, no_links_below, write_text
from simgap.io.documents import read_json
from simgap.io.runs import LINKED, RUN, runs_in

PACKAGE = reading.real(Path(__file__)).parents[1]


PARTLY = (
    "--dry-run",
    "-n",
    "--until",
    "--unlock",
    "--touch",
    "--summary",
    "--list",
    "--rulegraph",
    "--dag",
    "--report",
)
"""Options of Snakemake with which a run does not end with the page of a case."""


class WorkflowFailed(SimgapError):
    """A stage failed; Snakemake has shown its log."""


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def run(
    context: typer.Context,
    cases: Annotated[list[Path], typer.Argument(help="Case files, all of one folder.", show_default=False)],
    cores: Annotated[int, typer.Option(min=1, help="Processes at a time.")] = 2,
    full: Annotated[
        bool, typer.Option("--full", help="Also run the larger number of simulated trials and attacks.")
    ] = False,
) -> None:
    """Run every stage of one or more cases; results go to results/ in this folder.

    Other options, such as --dry-run, --unlock, --until=gap or --report=report.zip, are passed to Snakemake.
    """
    from simgap.config.load import load_case

    files, options = split([*map(str, cases), *context.args])
    if not files:
        raise UserError("no case is given", remedy="Name one or more case files, such as robot.yaml.")
    loaded = [load_case(path) for path in files]
    for path, name in zip(files, (case.name for case in loaded), strict=True):
        if path.name != f"{name}.yaml":
            raise UserError(
                f"the case is called '{name}', its file is not", file=path, key="name",
                remedy=f"Rename the file to {name}.yaml, or the case.",
            )  # fmt: skip
    (folder, *others) = dict.fromkeys(path.parent for path in files)
    if others:
        raise UserError("stands in another folder than the first case", file=others[0], remedy="Run it by itself.")
    whole = not looks_on(options)
    if whole:
        _refuse_beside({path.stem for path in files})
    snakemake(folder, [path.stem for path in files], cores, [*options, "--", "full"] if full else options)
    if whole:
        for case in loaded:
            _tell_verdict(case, "full" if full else "")


def split(words: Sequence[str]) -> tuple[list[Path], list[str]]:
    """Files of a person, and options of Snakemake with their values: words behind an option that name no YAML file."""
    files, options, behind = list[Path](), list[str](), False
    for word in words:
        behind = word.startswith("-") or (behind and not word.endswith((".yaml", ".yml")))
        if behind:
            options.append(word)
        else:
            files.append(Path(word))
    return files, options


def looks_on(options: Sequence[str]) -> bool:
    """Whether a run with these options of Snakemake does not end with what it is asked for."""
    return any(word.startswith(PARTLY) for word in options)


def _refuse_beside(names: set[str]) -> None:
    """Cases that another run of this folder is at work on would be written twice; other cases go side by side."""
    for other in runs_in(Path()):
        common = sorted(names.intersection(other.cases))
        if other.alive and common:
            raise UserError(
                f"another run is at work on {', '.join(common)} in this folder: {other}",
                file=Path(f"results/{common[0]}"),
                remedy="Wait until it has ended, or type the command in another folder: results go to results/ there.",
            )


def _tell_verdict(case: Case, trials: str) -> None:
    """What the page of a case says first, and where it is.

    Raises:
        WorkflowFailed: a run that has ended well without it.
    """
    folder, controlled = Path("results") / case.name, case.synthesis is not None and bool(case.gap or case.hidden_state)
    page = require_made(folder / trials / "report.html" if controlled else folder / "check/check.json")
    if controlled:
        verdict = read_json(page.with_name("summary.json"))["verdict"]
        say("\n".join([f"{case.name}:", *(f"  {line}" for line in verdict), f"  Page: {page}"]))


def require_made(result: Path) -> Path:
    """The result for which a run was made.

    Raises:
        WorkflowFailed: it is not there.
    """
    if not reading.is_file(result):
        raise WorkflowFailed(
            f"the run says that it ended well and has not made {result}. Leave out options and profiles of Snakemake "
            "that keep it from computing"
        )
    return result


@app.command()
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
    seconds: Annotated[float, typer.Option(min=1.0, help="CPU time for finding tau, X, U and cells.")] = 120.0,
) -> None:
    """Write a commented case for your robot, NAME.yaml, which runs as it stands."""
    from simgap.cli.progress import progress
    from simgap.stages import new as stage
    from simgap.stages.new_model import BASES

    if [urdf is not None, mjcf is not None, equations].count(True) != 1:
        raise UserError(
            "either a URDF, or MJCF, or equations", key="--urdf",
            remedy="Give --urdf FILE, --mjcf FILE, or --equations.",
        )  # fmt: skip
    of_files = {"--inputs": inputs, "--at": at, "--joints": joints, "--base": base}
    if equations and any(of_files.values()):
        key = next(key for key, given in of_files.items() if given)
        raise UserError("belongs to a model file", key=key, remedy="Write it into the equations.")
    if base not in ("", *BASES):
        raise UserError(f"'{excerpt(base, 40)}' is no base", key="--base", remedy=f"Known: {', '.join(BASES)}.")
    named, kept = ([n.strip() for n in said.split(",") if n.strip()] or None for said in (inputs, joints))
    notes, posture = list[str](), values_of(at, "--at")
    with progress("reading the model") as tell:
        path = stage.run(name, urdf, out, named, posture, tell, notes.append, seconds, mjcf, kept, base or None)
    for line in [*notes, f"Wrote {path}. Next: simgap check {path}, then simgap run {path}"]:
        say(line)


@app.command()
def propose(
    case: CasePath,
    at: Annotated[str, typer.Option(help="Posture around which to work, such as q2=3.1416; 0 for other states.")] = "",
    seconds: Annotated[float, typer.Option(min=1.0, help="CPU time for the search.")] = 120.0,
) -> None:
    """Find tau, X, U and cells for which a controller exists, by the nominal model, and print them as sections."""
    from simgap.cli.progress import progress
    from simgap.stages import propose as stage

    with progress("building the nominal model") as tell:
        found = stage.run(case, values_of(at, "--at"), tell, seconds)
    say(found.block())
    for doubt in filter(None, (found.small, found.doubtful)):
        say(doubt, err=True)


@app.command()
def refine(
    case: CasePath,
    samples: Annotated[
        int | None, typer.Option(min=1, help="At most so many, all inputs counted; by default as many as now.")
    ] = None,
) -> None:
    """Find along which states the grid of samples has to be fine, from lines through X, and print its section."""
    from simgap.cli.progress import progress
    from simgap.stages import refine as stage

    with progress("building the nominal model") as tell:
        found = stage.run(case, samples, tell)
    say(found.block())
    for name, then in found.then.items():
        say(f"# {name}: within a cell the bound loses {then:.2g} on average, now {found.now[name]:.2g}")


@app.command()
def tutorial(
    out: Annotated[Path, typer.Option(help="Folder for the files.", callback=new_folder)] = Path(),
) -> None:
    """Copy the files of the tutorial here: the URDF of a rod, and a recording."""
    from simgap.io.atomic import atomic

    source = workflow_file("tutorial") if (PACKAGE / "workflow").is_dir() else PACKAGE.parent / "docs/tutorial"
    for name in ("rod.urdf", "swings.csv"):
        if (out / name).exists():
            raise UserError("is there already, and stays as it is", file=out / name, remedy="Take an empty folder.")
    for name in ("rod.urdf", "swings.csv"):
        with atomic(out / name) as temporary:
            temporary.write_bytes(reading.read_bytes(source / name))
    say("Wrote rod.urdf and swings.csv. Next: simgap new rod --urdf rod.urdf")


def workflow_file(name: str) -> Path:
    """A file of the workflow: in the package where it is a wheel, else in the checkout around it."""
    packaged = PACKAGE / "workflow" / name
    return packaged if packaged.exists() else PACKAGE.parent / name


def snakemake(
    folder: Path, cases: Sequence[str], cores: int, options: Sequence[str], sweeps: Path | None = None
) -> None:
    """Run the workflow in this folder.

    Raises:
        WorkflowFailed: what failed has been shown.
    """
    status = _status(folder, cases, cores, options, sweeps or folder)
    if status:
        locks = Path(".snakemake/locks")
        locked = locks.is_dir() and any(locks.iterdir())
        raise WorkflowFailed(
            _locked()
            if locked
            else "the run has failed for what the line above says. Mend it and type the same command again: what was "
            "finished is kept"
        )


def _locked() -> str:
    """Who holds the folder, as far as it can be told, and what to do."""
    others = runs_in(Path())
    named = f"at work here: {'; '.join(map(str, others))}" if others else "no run that is alive here says so"
    alive = any(run.alive for run in others)
    return f"another run writes files of this one, or has left locks: {named}. " + (
        "Wait until it has ended, or type the command in another folder"
        if alive
        else "If it was killed on another machine, give the same command with --unlock, then again without"
    )


def _status(folder: Path, cases: Sequence[str], cores: int, options: Sequence[str], sweeps: Path) -> int:
    place, points = Path(os.path.relpath(folder)), os.path.relpath(sweeps)
    about = {"case_folder": str(place), "rig_folder": str(place / "rigs"), "sweep_folder": points}
    text = yaml.safe_dump(about | {"cases": list(cases)})
    # Beside what Snakemake keeps, under a name that says what is in it: a run that is killed leaves no other file.
    config = Path(".snakemake/simgap") / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.yaml"
    no_links_below(config.parents[1], LINKED)
    write_text(config, text)
    # Nothing of this folder is run or obeyed: no module beside the case is imported, no profile beside it is read.
    command = [sys.executable, "-P", start.__file__, "--snakefile", str(workflow_file("Snakefile"))]
    command += ["--configfile", str(config), "--cores", str(cores), "--directory", "."]
    if not any(word.startswith("--workflow-profile") for word in options):
        command += ["--workflow-profile", str(workflow_file("profiles/default"))]
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # it begins so, and frees itself where it is ready
    process = subprocess.Popen([*command, *options], env=os.environ | {RUN: f"{host()}:{os.getpid()}"})
    interrupted = False
    while True:
        try:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
            status = process.wait()
        except KeyboardInterrupt:  # Snakemake has it too, and ends its jobs
            interrupted = True
            continue
        if status and interrupted:
            raise WorkflowFailed(
                "the run was interrupted. What was finished is kept: the same command goes on from there"
            )
        if status == start.USAGE:  # told
            raise typer.Exit(2)
        return status
