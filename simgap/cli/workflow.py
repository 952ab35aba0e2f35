"""`simgap run` and `simgap sweep`: all stages of a person's cases, by the workflow that the package carries.

A run that ends without a controller, because a job failed, nothing wins or the case asks for a bound alone, ends with
the reasons and a page that has them: `no_controller.html` in the folder of the results.
"""

from __future__ import annotations

import hashlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from simgap import reading
from simgap.cli import start
from simgap.cli.terminal import say
from simgap.config.case import Case
from simgap.errors import SimgapError, UserError
from simgap.io.atomic import host, no_links_below, write_text
from simgap.io.pages import NO_CONTROLLER, render
from simgap.io.results import read_json
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


_ASKS_FOR_NONE = (
    "The case has no section `synthesis`: the run ends with the bound of its gap. `simgap propose {}.yaml` looks for "
    "numbers with which the nominal model alone wins something, or says what is in the way."
)


class WorkflowFailed(SimgapError):
    """A stage failed; Snakemake has shown its log."""


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
        told = start.misspelt(options) if options else ""
        raise UserError("no case is given", remedy=f"{told} Name one or more case files, such as robot.yaml.".strip())
    loaded = [load_case(path) for path in files]
    for path, name in zip(files, (case.name for case in loaded), strict=True):
        if path.name != f"{name}.yaml":
            remedy = f"Rename the file to {name}.yaml, or the case."
            raise UserError(f"the case is named '{name}' but its file is not", file=path, key="name", remedy=remedy)
    (folder, *others) = dict.fromkeys(path.parent for path in files)
    if others:
        raise UserError("is not in the folder of the first case", file=others[0], remedy="Run it by itself.")
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
    """True if a run with these options of Snakemake does not end with what it is asked for."""
    return any(word.startswith(PARTLY) for word in options)


def _refuse_beside(names: set[str]) -> None:
    """Cases that another run of this folder is at work on would be written twice; other cases go side by side."""
    for other in runs_in(Path()):
        common = sorted(names.intersection(other.cases))
        if other.alive and common:
            problem = f"another run is working on {', '.join(common)} in this folder: {other}"
            remedy = "Wait until it has ended, or type the command in another folder: results go to results/ there."
            raise UserError(problem, file=Path(f"results/{common[0]}"), remedy=remedy)


def _tell_verdict(case: Case, trials: str) -> None:
    """Print what the page of a case says first, and where it is.

    Raises:
        WorkflowFailed: a run that has ended well without it.
    """
    folder, bounded = Path("results") / case.name, bool(case.gap or case.hidden_state)
    controlled = bounded and case.synthesis is not None
    page = require_made(folder / trials / "report.html" if controlled else folder / "check/check.json")
    if not bounded:
        return
    if controlled:
        verdict = read_json(page.with_name("summary.json"))["verdict"]
    else:
        verdict = [case.no_controller or _ASKS_FOR_NONE.format(case.name)]
        page = write_page(folder, verdict, bounded=True)
    say("\n".join([f"{case.name}:", *(f"  {line}" for line in verdict), f"  Page: {page}"]))


def require_made(result: Path) -> Path:
    """The result for which a run was made.

    Raises:
        WorkflowFailed: it is not there.
    """
    if not reading.is_file(result):
        raise WorkflowFailed(
            f"the run reported success but did not write {result}. Leave out options and profiles of Snakemake "
            "that keep it from computing"
        )
    return result


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
            else "the run failed, as the line above says. Fix that and repeat the command: what was finished is kept"
        )


def _locked() -> str:
    """Sentence on who holds the folder, as far as it can be told, and what to do."""
    others = runs_in(Path())
    named = f"running here: {'; '.join(map(str, others))}" if others else "no live run on this machine"
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
    if not looks_on(options) and "--logger" not in options:
        command += ["--logger", "simgap"]
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
            problem = "the run was interrupted. What was finished is kept: the same command continues from there"
            raise WorkflowFailed(problem)
        if status == start.USAGE:  # told
            raise typer.Exit(2)
        return status


def sweep(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(help="Sweep file (YAML).", show_default=False)],
    cores: Annotated[int, typer.Option(min=1, help="Processes at a time.")] = 2,
) -> None:
    """Run every point of a sweep; table and page go to results/sweeps/<name> in this folder.

    Other options, such as --dry-run, --unlock or --keep-going, are passed to Snakemake.
    """
    from simgap.stages.sweep import checked_points

    files, words = split([str(file), *context.args])
    if len(files) != 1:
        raise UserError(f"{len(files) or 'no'} sweep files are given", remedy="Name one, such as sweeps/radii.yaml.")
    path = files[0]
    base, points = checked_points(path)
    target = f"results/sweeps/{path.stem}/report.html"
    snakemake(base.parent, [base.stem], cores, [*words, "--", target], path.parent)
    if not looks_on(words):
        require_made(Path(target))
        say(f"{path.stem}: {len(points)} points. Page: {target}, table: {Path(target).parent}/table.parquet")


TEMPLATE = "no_controller.html.j2"
INDEX = "index.html"
EMPTY = "empty.json"
"""Beside the summary of a synthesis that won nothing: why."""
_CONTROLLED = ("validation", "audit", "report")
"""Rules that begin when the controllers are there."""
_BOUNDED = ("synthesis", *_CONTROLLED)
"""Rules that begin when the bound is there: what lies in the folder is that of this run."""
_BESIDE = ("check", "trace")
"""Rules whose failure has no page: `check` refuses the case in a line, on the other no page depends."""
_FAILED = re.compile(r"^Error in rule ([^:]+):$", re.MULTILINE)
_LOG = re.compile(r"^    log: ([^,\n]+?)(?: \(check log file|,|$)", re.MULTILINE)
_ERROR = re.compile(r"^\S+ \S+ ERROR (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Failure:
    """A job that failed: its rule, its log if it has one, and its own reason, as its log has it last."""

    rule: str
    log: str | None
    told: str | None

    def __str__(self) -> str:
        """The reason in a line that names the log."""
        if self.log is None:
            return f"the rule {self.rule} failed"
        if self.told is None:
            return f"the rule {self.rule} ended without a reason: {self.log}"
        return f"{self.told} [{self.rule}, {self.log}]"


def failures(run_logs: Sequence[Path], folder: Path = Path()) -> list[Failure]:
    """Jobs that failed, each once.

    What `check` refuses stands last, where it is read: other jobs of the case may have met the same mistake, later.

    Args:
        run_logs: what Snakemake wrote of the run.
        folder: where paths of the run start from.
    """
    text = "".join(_text(path) for path in run_logs)
    starts = [match.start() for match in _FAILED.finditer(text)]
    blocks = [text[a:b] for a, b in zip(starts, [*starts[1:], len(text)], strict=True)] if starts else []
    return sorted(dict.fromkeys(_failure(block, folder) for block in blocks), key=lambda f: f.rule == "check")


def _failure(block: str, folder: Path) -> Failure:
    failed, log = _FAILED.search(block), _LOG.search(block)
    rule = failed.group(1) if failed is not None else ""
    if log is None:
        return Failure(rule, None, None)
    told = _ERROR.findall(_text(folder / log.group(1)))
    return Failure(rule, log.group(1), told[-1] if told else None)


def _text(path: Path) -> str:
    try:
        return reading.read_text(path, errors="replace")
    except OSError:
        return ""


def write_failed(failed: Sequence[Failure], words: Mapping[str, str], folder: Path = Path()) -> list[Path]:
    """A page in each folder of results of which a job failed, after `check` had nothing against the case.

    What nothing depends on, such as the recording for Rerun, takes no controller away.

    `words` are what cases themselves say of why they ask for no controller, by folder.
    """
    found: dict[Path, list[Failure]] = {}
    for failure in failed:
        if failure.log is not None and failure.rule not in _BESIDE and "logs" in Path(failure.log).parts:
            found.setdefault(Path(failure.log).parent.parent, []).append(failure)
    checked = {Path(f.log).parent.parent for f in failed if f.rule == "check" and f.log is not None}
    own = {results: why for results, why in found.items() if results not in checked}
    for results, why in own.items():
        bounded = all(f.rule in _BOUNDED for f in why)
        said = [words[str(results)]] if words.get(str(results)) else []
        controlled = all(f.rule in _CONTROLLED for f in why)
        write_page(folder / results, [f.told or str(f) for f in why] + said, bounded, controlled)
    from simgap.stages.index import run as write_index

    for root in {folder / results.parent for results in own}:
        if reading.is_file(root / INDEX):  # it would say of these cases what an earlier run was worth
            write_index([], root / INDEX, sorted(root.glob("*/summary.json")))
    return [results / NO_CONTROLLER for results in own]


def write_page(results: Path, reasons: Sequence[str], bounded: bool, controlled: bool = False) -> Path:
    """The page of a case that has no controller: why, the bound if there is one, and why nothing wins.

    It takes the place of the pages of an earlier run, which the next one that ends well makes again.

    Args:
        results: folder of the case's results. reasons: a sentence each. bounded: whether its bound is of this run;
            controlled: whether its controllers are, too, so that the run is only not complete.
    """
    gaps = sorted(results.glob("gap/*/gap.json"), key=lambda path: path.stat().st_mtime) if bounded else []
    empty = [_read(path) for path in sorted(results.glob(f"synthesis/*/{EMPTY}")) if bounded and not controlled]
    page, title = results / NO_CONTROLLER, str(results).rpartition("results/")[2]
    bound = _read(gaps[-1]).get("dimensions", []) if gaps else []
    title += ": run not complete" if controlled else ": no controller"
    write_text(page, render(TEMPLATE, title=title, reasons=reasons, bound=bound, empty=[e for e in empty if e]))
    for earlier in ("report.html", "summary.json", *(() if controlled else ("first/report.html",))):
        (results / earlier).unlink(missing_ok=True)
    return page


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_json(path)
    except UserError:  # of another version, or half written: the page does without
        return {}
