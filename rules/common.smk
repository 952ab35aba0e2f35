# Names and hashes that the rules share. A data rule has two hashes among its parameters: of the sections of the case that
# its stage reads, and of the code that its stage runs. Snakemake reruns a rule when either changes.

import os
import sys
from pathlib import Path

from simgap.cache import machine_code
from simgap.config.load import load_case
from simgap.config.measured import named_recordings
from simgap.config.run import (
    MARK,
    base_of,
    case_of_rig,
    points_of_sweep,
    workflow_config,
)
from simgap.errors import SimgapError, UserError
from simgap.gap.sampling.points import (
    EVERY_HISTORY,
    own_point,
    points_of,
    remembers,
    shard_count,
)
from simgap.io.atomic import host, no_links_below
from simgap.io.runs import LINKED, RUN, announce, follow_the_run
from simgap.provenance import (
    READS,
    code_digest,
    digest,
    file_digest,
    sections_digest,
    sections_of,
    versions,
)

COMMAND = "simgap run" if RUN in os.environ else "snakemake"

# Stages run the `simgap` of this very environment, whether it was activated or not, and end with this run, which ends
# with `simgap run` if that has begun it.
follow_the_run()
os.environ.update(
    PATH=os.pathsep.join([str(Path(sys.executable).parent), *os.get_exec_path()]),
    **{RUN: f"{host()}:{os.getpid()}"},
)


def told(error):
    """A person's mistake as one line and status 2; Snakemake would wrap it in places of these files."""
    sys.stderr.write(f"simgap: {error}\n")
    sys.exit(error.exit_status)


try:
    SETTINGS = workflow_config(config)
except SimgapError as error:
    told(error)

CASE_FOLDER = Path(SETTINGS.case_folder)
CASES = SETTINGS.cases

# Logs, benchmarks and Snakemake's own records are opened where they stand: nothing there may lead elsewhere.
if workflow.is_main_process:
    try:
        no_links_below(Path(".snakemake"), LINKED)
        for name in (*CASES, "sweeps"):
            no_links_below(Path("results") / name)
    except SimgapError as error:
        told(error)

# The kernels of a version are compiled where a job first needs them, and kept: that is said before it is waited for.
kernels = machine_code()
if workflow.is_main_process and kernels is not None and not kernels.is_dir():
    sys.stderr.write(
        "simgap: the first run of this version compiles its kernels, once, and takes some 20 s longer\n"
    )

# Runs of other cases may be at work here. What they and this one would both write, the page of all cases, is then written
# when this run has ended well (rules/report.smk), and Snakemake has no reason to refuse it. A run that was killed leaves
# Snakemake's locks: they go where no run is alive that could hold them.
RUNNING = []
if workflow.is_main_process:
    RUNNING, tidied = announce(Path(), CASES, COMMAND)
    if tidied:
        sys.stderr.write("simgap: removed the locks of a run that was killed\n")
for other in RUNNING:
    sys.stderr.write(f"simgap: also at work in this folder: {other}\n")


wildcard_constraints:
    case="[a-z][a-z0-9_-]*(/corrected)?",
    point=r"eps~[0-9]+(\.[0-9]+)?(e-?[0-9]+)?|cells~[0-9]+(-[0-9]+)*|hidden-state|full-table",
    shard="[0-9]+",
    kind="nominal|baseline|gap",
    tier="|first/|full/|deep/",


def reads(stage):
    """What the stage reads of the case, as a hash for `params`."""

    def hashed(wildcards):
        case, folder = read_of(wildcards.case)
        try:
            return sections_digest(case, sections_of(stage, case), folder)
        except SimgapError as error:
            told(error)

    return hashed


def code(stage, case=None):
    """The code that the stage runs, plug-ins of the case included, and the distributions under it, as a hash."""

    def made_by(wildcards):
        name = case or wildcards.get("case")
        of = read_of(name) if name else ()
        return digest([code_digest(stage, *of), versions(stage, *of)])

    return made_by


def of_stage(stage):
    """Parameters of every stage of a case: its case file, and hashes of what it reads of it and of the code that it runs."""
    return {
        "case": lambda w: case_path(w.case),
        "reads": reads(stage),
        "code": code(stage),
    }


def gap_folder(wildcards):
    """Where the bound stands that the controller is made for."""
    return f"results/{wildcards.case}/gap/{own_point(case_of(wildcards))}"


def long_first(wildcards):
    """Priority: a case that remembers earlier inputs has long jobs one after the other; those of other cases fill the gaps."""
    return 10 if remembers(case_of(wildcards)) else 0


def page_first(wildcards):
    """Priority of what a first page needs: the first case of a run has one before another begins."""
    return 20 if wildcards.case == CASES[0] else long_first(wildcards)


# Threads of a job that can use two. Beside other cases it takes one: no job waits until two cores are free, and what a job
# does on one core of two leaves none idle.
ONE_OR_TWO = 2 if len(CASES) == 1 else 1


# Priority of what nothing depends on: it fills the cores that are left at the end.
LAST = -10


def flagged(flag, paths):
    """Command-line words that give each path its flag; `{params.x:q}` quotes them one by one."""
    return [
        word
        for path in ([paths] if isinstance(paths, str) else paths)
        for word in (flag, path)
    ]


def options(*others):
    """Every input but these with its flag, which is its name, as words of the command; files that a case lacks have none."""

    def words(wildcards, input):
        return [
            word
            for name, files in input.items()
            if name not in ("case", *others)
            for word in flagged(f"--{name.replace('_', '-')}", files)
        ]

    return words


def sweep_points(case):
    """The case's own point and those of the sweep over eps."""
    return points_of(
        case_of(case),
        list(SETTINGS.sweeps[case].eps) if case in SETTINGS.sweeps else [],
    )
