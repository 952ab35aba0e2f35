# Names and hashes that the rules share. A data rule has two hashes among its parameters: of the sections of the case that
# its stage reads, and of the code that its stage runs. Snakemake reruns a rule when either changes.

import os
import sys
from pathlib import Path

from simgap.io.follow import RUN, follow_the_run
from simgap.config.load import load_case
from simgap.config.reads import READS
from simgap.config.rig import case_of_rig
from simgap.config.sweep import MARK, base_of, points_of_sweep
from simgap.config.workflow import workflow_config
from simgap.errors import SimgapError, UserError
from simgap.gap.points import (
    EVERY_HISTORY,
    own_point,
    points_of,
    remembers,
    shard_count,
)
from simgap.io.atomic import host
from simgap.io.run_lock import join
from simgap.provenance import (
    code_digest,
    digest,
    file_digest,
    sections_digest,
    sections_of,
    versions,
)

# Stages run the `simgap` of this very environment, whether it was activated or not, and end with this run, which ends
# with `simgap run` if that has begun it.
follow_the_run()
os.environ.update(
    PATH=os.pathsep.join([str(Path(sys.executable).parent), *os.get_exec_path()]),
    **{RUN: f"{host()}:{os.getpid()}"},
)

# A run that was killed leaves Snakemake's locks: they go where no run is alive that could hold them.
if workflow.is_main_process and join(Path(), workflow.snakemake_tmp_dir):
    sys.stderr.write("simgap: removed the locks of a run that was killed\n")


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


wildcard_constraints:
    case="[a-z][a-z0-9_-]*(/corrected)?",
    point=r"eps~[0-9]+(\.[0-9]+)?(e-?[0-9]+)?|cells~[0-9]+(-[0-9]+)*|hidden-state|full-table",
    state="[^/]+",
    shard="[0-9]+",
    kind="nominal|careful|gap",
    depth="audit|audit-deep",


def base(name):
    """The case that a corrected case came from."""
    return name.split("/")[0]


def simulated(name, *stages):
    """The case whose roll-outs count: effects found on the simulator leave it as it is, those found on hardware do not.

    Points of a sweep that need the same roll-outs (or what else the stages make) share those of the first of them.
    """
    if sweep_of(name) is not None:
        return first_alike(name, stages or ("grid", "rollouts"))
    if base(name) not in LOADED:
        LOADED[base(name)] = load(base(name))
    measured = LOADED[base(name)].measured
    hardware = measured is not None and measured.rig == "hardware"
    return name if hardware else base(name)


def sweep_of(name):
    """The sweep file of which a case is a point, if it is one."""
    path = Path(SETTINGS.sweep_folder) / f"{name.partition(MARK)[0]}.yaml"
    return path if MARK in name and path.is_file() else None


SWEPT = {}


def swept(path):
    """The points of a sweep file, by name."""
    if path not in SWEPT:
        try:
            SWEPT[path] = {point.name: point for point in points_of_sweep(path)}
        except SimgapError as error:
            told(error)
    return SWEPT[path]


def first_alike(name, stages, base_too=True):
    """The first of the sweep's case (if `base_too`) and its points that needs the same of these stages, whatever its name."""
    path = sweep_of(name)
    cases = {point: swept(path)[point].case for point in swept(path)}
    own = base_of(path)
    beside = own.parent.resolve() == CASE_FOLDER.resolve()
    if base_too and beside and own.stem not in cases:
        cases = {own.stem: case_of(own.stem)} | cases

    def needs(case):
        nameless = case.model_copy(update={"name": "any"})
        sections = [sections_of(stage, case) for stage in stages]
        return [sections_digest(nameless, part, own.parent) for part in sections]

    return next(n for n, case in cases.items() if needs(case) == needs(cases[name]))


def folder_of(name):
    """Where the relative paths of a case start from."""
    path = sweep_of(name)
    return CASE_FOLDER if path is None else base_of(path).parent


def case_path(name):
    if sweep_of(name) is not None:
        return f"results/sweeps/{name.partition(MARK)[0]}/cases/{name}.yaml"
    if name != base(name):
        return f"results/{base(name)}/diagnosis/corrected_case.yaml"
    return str(CASE_FOLDER / f"{name}.yaml")


def correction(wildcards):
    """A corrected case's file is made by a rule, so it is an input; a case's own file is hashed section by section."""
    if sweep_of(wildcards.case) is not None:
        return ancient(
            case_path(wildcards.case)
        )  # what the stages read of it is hashed
    return case_path(wildcards.case) if wildcards.case != base(wildcards.case) else []


def load(name):
    path = sweep_of(name)
    if path is not None:
        if name not in swept(path):
            told(
                UserError(
                    "has no such point",
                    file=path,
                    key=name,
                    remedy="Its values have changed.",
                )
            )
        return swept(path)[name].case
    try:
        return load_case(Path(case_path(name)))
    except SimgapError as error:
        told(error)


LOADED = {name: load(name) for name in CASES}


def case_of(wildcards):
    """The case, given by its name or by wildcards, or the one that it came from: they differ in the nominal model."""
    name = base(wildcards if isinstance(wildcards, str) else wildcards.case)
    if name not in LOADED:
        LOADED[name] = load(name)
    return LOADED[name]


def reads(stage):
    """What the stage reads of the case, as a hash for `params`."""
    return lambda wildcards: sections_digest(
        case_of(wildcards),
        sections_of(stage, case_of(wildcards)),
        folder_of(wildcards.case),
    )


def code(stage, case=None):
    """The code that the stage runs, plug-ins of the case included, and the distributions under it, as a hash."""

    def made_by(wildcards):
        name = case or wildcards.get("case")
        of = (case_of(name), folder_of(name)) if name else ()
        return digest([code_digest(stage, *of), versions(stage, *of)])

    return made_by


def gap_folder(wildcards):
    """Where the bound stands that the controller is made for."""
    return f"results/{wildcards.case}/gap/{own_point(case_of(wildcards))}"


def flagged(flag, paths):
    """Command-line words that give each path its flag; `{params.x:q}` quotes them one by one."""
    return [
        word
        for path in ([paths] if isinstance(paths, str) else paths)
        for word in (flag, path)
    ]


def sweep_points(case):
    """The case's own point and those of the sweep over eps."""
    return points_of(
        case_of(case),
        list(SETTINGS.sweeps[case].eps) if case in SETTINGS.sweeps else [],
    )
