"""Of a corrected case, which a diagnosis writes anew, a change reruns only what reads it: what is read is compared."""

import pytest

from tests.workflow.test_workflow import SMALL, Project

# Stands for every stage: a diagnosis that copies its case as the real one does, others that write a mark.
STUB = """
import sys
from pathlib import Path
import yaml

def main(words=None):
    words = list(sys.argv[1:] if words is None else words)
    with open("ran.txt", "a") as ran:
        ran.write(words[0] + "\\n")
    out = [Path(b) for a, b in zip(words, words[1:]) if a in ("--out", "--summary")]
    if words[0] != "diagnose":
        for path in out:
            path.write_text("made")
        return
    content = yaml.safe_load(Path(words[1]).read_text())
    content["name"] += "_corrected"
    content["plant"]["urdf"] = "../../../configs/models/pendulum.urdf"
    content["plant"]["effects"] = [{"name": "viscous_friction", "on": "hinge", "parameters": {"b": 0.1}}]
    content["measured"] = {"rig": "simulator", "files": ["../../../configs/cases/run.csv"]}
    (out[0] / "corrected_case.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    for name in ("diagnosis.json", "report.html", "residual.rrd", "transitions.parquet"):
        (out[0] / name).write_text("made")
"""
TARGETS = [f"results/small/corrected/{name}" for name in ("check/check.json", "synthesis/nominal/controller.npz")]


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    made = Project(tmp_path_factory.mktemp("project"))
    made.change(lambda c: c.update({"measured": {"rig": "simulator", "files": ["run.csv"]}}))
    (made.case.parent / "run.csv").write_text("t,x1,u\n0,0,0\n")
    (made.folder / "simgap/cli/__init__.py").write_text(STUB)
    assert ran(made) == {"diagnosis", "check", "synthesis"}
    return made


def ran(project):
    """The stages that a call ran."""
    told = project.folder / "ran.txt"
    told.write_text("")
    project.snakemake("--", *TARGETS)
    return {word.replace("diagnose", "diagnosis") for word in told.read_text().split()}


def test_a_second_call_runs_nothing(project):
    assert ran(project) == set()


@pytest.mark.parametrize(
    ("key", "value", "again"),
    [
        ("title", "Another title", {"diagnosis", "check"}),
        ("validation", {"starts": 30, "steps": 100}, {"diagnosis", "check"}),
        ("synthesis", SMALL["synthesis"] | {"cells": [180, 90]}, {"diagnosis", "check", "synthesis"}),
    ],
)
def test_what_reads_the_changed_key_runs_again_and_nothing_else(project, key, value, again):
    project.change(lambda c: c.update({key: value}))
    assert ran(project) == again
