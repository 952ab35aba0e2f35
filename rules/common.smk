# Names and hashes that the rules share. A data rule has two hashes among its parameters: of the sections of the case that
# its stage reads, and of the code that its stage runs. Snakemake reruns a rule when either changes.

from pathlib import Path

from snakemake.exceptions import WorkflowError

from simgap.config.load import load_case
from simgap.errors import SimgapError
from simgap.provenance import code_digest, digest, sections_digest, versions
from simgap.stages.reads import READS

CASE_FOLDER = Path(config["case_folder"])
CASES = config["cases"]
ENGINES = digest(versions("drake", "pybullet", "numpy", "numba", "clarabel", "cvxpy"))


wildcard_constraints:
    case="[a-z][a-z0-9_-]*",
    eps=r"[0-9]+(\.[0-9]+)?(e-?[0-9]+)?",
    shard="[0-9]+",
    kind="nominal|gap",


def case_path(name):
    return str(CASE_FOLDER / f"{name}.yaml")


def load(name):
    try:
        return load_case(Path(case_path(name)))
    except SimgapError as error:
        raise WorkflowError(str(error)) from None


LOADED = {name: load(name) for name in CASES}


def case_of(wildcards):
    return LOADED.setdefault(wildcards.case, None) or load(wildcards.case)


def reads(stage):
    """What the stage reads of the case, as a hash for `params`."""
    return lambda wildcards: sections_digest(case_of(wildcards), READS[stage], CASE_FOLDER)


def code(stage):
    """The code that the stage runs and the engines under it, as a hash for `params`."""
    return code_digest(f"simgap.stages.{stage}") + ENGINES


def eps_of(wildcards):
    return f"{case_of(wildcards).grid.eps:g}"


def eps_table(case):
    """The case's own eps and those of the sweep."""
    own = LOADED[case].grid.eps
    return [f"{eps:g}" for eps in sorted({own, *config.get("sweeps", {}).get(case, {}).get("eps", [])}, reverse=True)]
