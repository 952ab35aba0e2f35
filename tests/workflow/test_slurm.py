"""The pendulum through a real SLURM of one node: the same bytes as here, and nothing left behind."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.workflow.one_node_slurm import DAEMONS, installed, one_node
from tests.workflow.test_workflow import Project

ASKED = "SIMGAP_TEST_SLURM"
pytestmark = [
    pytest.mark.skipif(ASKED not in os.environ, reason=f"takes four minutes: set {ASKED}=1"),
    pytest.mark.skipif(not installed(), reason="slurm-wlm and munge are not installed, or this is not root"),
]
QUICK = (
    "--slurm-init-seconds-before-status-checks",
    "1",
    "--seconds-between-status-checks",
    "2",
    "--latency-wait",
    "5",
)
NOT_EQUAL = ("logs", "benchmarks")  # and recordings, of which the content alone is the same
TIMED = ("cost.json", "check.json")


def results(folder: Path) -> dict[str, bytes]:
    """Every result whose bytes are promised to be the same, by place."""
    every = sorted(p for p in (folder / "results").rglob("*") if p.is_file())
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in every
        if not set(p.parts) & set(NOT_EQUAL) and p.suffix != ".rrd" and p.name not in TIMED
    }


def test_the_cluster_gives_the_same_bytes(tmp_path):
    folders = [tmp_path / "here", tmp_path / "there"]
    for folder in folders:
        folder.mkdir()
    here, there = map(Project, folders)
    here.snakemake()
    with one_node(tmp_path / "slurm") as env:
        there.snakemake("--profile", "profiles/slurm", "--jobs", "4", *QUICK, env=env)
        assert there.planned() == {}
        ran = (tmp_path / "slurm/slurmctld.log").read_text().count("_job_complete: JobId=")
    mine, theirs = results(here.folder), results(there.folder)
    assert {"results/index.html", "results/small/audit/audit.json", "results/small/report.html"} <= set(mine)
    assert sorted(mine) == sorted(theirs)
    assert [name for name in mine if mine[name] != theirs[name]] == []
    assert ran >= 10
    left = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True).stdout
    assert not [line for line in left.splitlines() if str(tmp_path / "slurm") in line and line.split()[0] in DAEMONS]
