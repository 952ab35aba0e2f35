"""Snakemake as a person runs it, on a copy of the project with a small case."""

import copy
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml

from simgap.cli.commands import COMMANDS

ROOT = Path(__file__).parents[2]
ROAD = {"grid", "rollouts", "fresh", "borders", "scp", "lipschitz", "gap"}
SMALL = {
    "domain": {
        "tau": 0.005,
        "X": {"x1": [-0.2, 0.2], "x2": [-0.5, 0.5]},
        "U": {"u": {"min": -1.2, "max": 1.2, "step": 0.4}},
    },
    "grid": {"eps": 0.02, "shards": 2},
    "synthesis": {
        "cells": [200, 100],
        "specification": {"kind": "invariance", "safe": {"x1": [0.0, 0.2], "x2": [-0.5, 0.5]}},
    },
    "validation": {"starts": 20, "steps": 100, "seed": 1},
    "audit": {"evaluations": 5000, "steps": 1000},
}


class Project:
    """A copy of the workflow with one small case, on whose own package Python imports."""

    def __init__(self, folder: Path):
        self.folder = folder
        for name in ("Snakefile", "rules", "profiles", "configs", "reports", "simgap"):
            source = ROOT / name
            taken = shutil.copytree if source.is_dir() else shutil.copy
            taken(
                source, folder / name, **({"ignore": shutil.ignore_patterns("__pycache__")} if source.is_dir() else {})
            )
        self.case = folder / "configs/cases/small.yaml"
        content = yaml.safe_load((ROOT / "configs/cases/pendulum.yaml").read_text())
        content.pop("measured", None)
        content |= SMALL | {"name": "small"}
        content["gap"] |= {"fresh_samples": 2000, "padding": "per_axis"}
        self.write(content)
        (folder / "configs/default.yaml").write_text(
            yaml.safe_dump(
                {"case_folder": "configs/cases", "rig_folder": "configs/rigs", "cases": ["small"], "sweeps": {}}
            )
        )

    def copied(self, folder):
        """Another one with its results, in which a run may fail: what a failed job was to write is gone then."""
        other = copy.copy(self)
        other.folder = shutil.copytree(self.folder, folder)
        other.case = other.folder / self.case.relative_to(self.folder)
        return other

    def write(self, content):
        self.case.write_text(yaml.safe_dump(content, sort_keys=False))

    def change(self, edit):
        content = yaml.safe_load(self.case.read_text())
        edit(content)
        self.write(content)

    def snakemake(self, *arguments, check=True, env=None):
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        env = os.environ | {"PYTHONPATH": str(self.folder), "PATH": path} | (env or {})
        command = [sys.executable, "-m", "snakemake", "--cores", "2", *arguments]
        done = subprocess.run(
            command, cwd=self.folder, env=env, capture_output=True, text=True, timeout=900, check=False
        )
        if check and done.returncode:
            pytest.fail(f"{command} failed:\n{done.stdout[-3000:]}\n{done.stderr[-6000:]}")
        return done

    def planned(self, *arguments):
        """How many jobs of each rule a call would run."""
        done = self.snakemake("-n", "--quiet", "rules", *arguments)
        text = done.stdout + done.stderr
        if "Nothing to be done" in text:
            return {}
        rows = [line.split() for line in text.splitlines()]
        jobs = {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}
        jobs.pop("total", None)
        jobs.pop("all", None)
        return jobs


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    made = Project(tmp_path_factory.mktemp("project"))
    made.snakemake()
    return made


def test_everything_is_there(project):
    results = project.folder / "results/small"
    for name in (
        "report.html",
        "summary.json",
        "picture.png",
        "figures/domains.svg",
        "trace/trace.rrd",
        "validation/traces.parquet",
        "audit/audit.json",
        "audit/margins.parquet",
        "gap/eps~0.02/gap.json",
    ):
        assert (results / name).stat().st_size > 0
    logs = sorted(p.name for p in (results / "logs").glob("*.log"))
    assert "validation.log" in logs
    assert "rollouts-eps~0.02-0.log" in logs


def test_snakemakes_own_report_holds_page_and_figures(project):
    """One archive to send around: every page and figure with its caption, by case."""
    project.snakemake("--report", "sent.zip")
    with zipfile.ZipFile(project.folder / "sent.zip") as archive:
        names = archive.namelist()
        said = "".join(archive.read(n).decode() for n in names if n.endswith((".js", ".html", ".json")))
    for figure in ("domains.svg", "trajectories.svg", "gap.svg", "bound.png", "report.html"):
        assert any(name.endswith(figure) for name in names), names
    assert "The whole page of the case" in said
    assert "the gap along a run between its bounds" in said


def test_a_second_call_runs_nothing(project):
    assert project.planned() == {}


def test_a_synthesis_key_reruns_no_rollout(project):
    original = project.case.read_text()
    project.change(lambda c: c["synthesis"].__setitem__("cells", [180, 90]))
    jobs = project.planned()
    project.case.write_text(original)
    assert jobs.get("synthesis") == 2
    assert jobs.get("validation") == 1
    assert jobs.get("audit") == 1
    assert not ROAD & set(jobs)


@pytest.mark.parametrize(
    ("change", "again"),
    [
        ({"basis": ["x1", "x2", "u", 1]}, {"scp", "gap"}),
        ({"slack": 0.02}, {"scp", "gap"}),
        ({"padding": "paper"}, {"gap"}),  # added after the program
        ({"padding": "inflate"}, {"scp", "gap"}),  # part of the program
        ({"lipschitz": {"extreme_value": False}}, {"lipschitz", "gap"}),
        ({"lipschitz": {"rough_limit": 0.2}}, {"gap"}),
        ({"confidence": 0.99}, {"gap"}),
        ({"fresh_samples": 2100}, {"fresh", "gap"}),
    ],
)
def test_each_stage_of_the_bound_is_kept_for_itself(project, change, again):
    original = project.case.read_text()
    project.change(lambda c: c["gap"].update(change))
    jobs = project.planned()
    project.case.write_text(original)
    assert ROAD & set(jobs) == again
    assert all(jobs[stage] == 1 for stage in again)


@pytest.mark.parametrize(
    ("file", "again"),
    [
        ("fitting/scenario.py", {"scp", "gap"}),
        ("lipschitz/estimates.py", {"lipschitz"}),
        ("checked_bound.py", {"gap"}),
    ],
)
def test_an_edited_core_reruns_the_stages_that_use_it(project, file, again):
    core = project.folder / "simgap/gap" / file
    original = core.read_text()
    core.write_text(original + "\n# changed\n")
    jobs = project.planned()
    core.write_text(original)
    assert {"grid", "rollouts", "fresh", "borders", "scp", "lipschitz"} & set(jobs) == again - {"gap"}
    assert "gap" in jobs


def test_the_rule_graph_shows_the_road(project):
    done = project.snakemake("--rulegraph")
    names = dict(re.findall(r'(\d+)\[label = "(\w+)"', done.stdout))
    edges = {(names[a], names[b]) for a, b in re.findall(r"(\d+) -> (\d+)", done.stdout)}
    road = ("grid", "rollouts", "scp", "gap", "synthesis", "validation", "audit", "report")
    assert set(itertools.pairwise(road)) <= edges
    assert {
        ("rollouts", "lipschitz"),
        ("lipschitz", "gap"),
        ("fresh", "gap"),
        ("rollouts", "audit"),
        ("borders", "scp"),
        ("borders", "gap"),
    } <= edges
    assert not {("scp", "lipschitz"), ("lipschitz", "scp")} & edges
    for stage in road:
        assert stage in COMMANDS
        assert (project.folder / f"simgap/stages/{stage}.py").is_file()


@pytest.mark.parametrize("point", ["hidden-state", "full-table"])
def test_a_robot_takes_the_same_road(project, point):
    jobs = project.planned("--", f"results/turtlebot/gap/{point}/gap.json")
    assert jobs == {"grid": 1, "rollouts": 2, "fresh": 1, "scp": 1, "lipschitz": 1, "gap": 1}


def test_a_robot_has_its_fair_baseline(project):
    jobs = project.planned("--", "results/turtlebot/validation/validation.json")
    assert jobs["synthesis"] == 3
    assert jobs["validation"] == 1


def test_an_edited_kernel_reruns_exactly_its_dependents(project):
    kernel = project.folder / "simgap/synthesis/games/invariance.py"
    original = kernel.read_text()
    kernel.write_text(original + "\n# changed\n")
    jobs = project.planned()
    kernel.write_text(original)
    assert jobs.get("synthesis") == 2
    assert not ROAD & set(jobs)


def edited(project, file, edit):
    """The jobs that a call would run with this file changed."""
    path = project.folder / file
    original = path.read_text()
    path.write_text(edit(original))
    jobs = project.planned()
    path.write_text(original)
    return jobs


def test_an_edited_engine_reruns_exactly_the_cases_that_use_it(project):
    jobs = edited(project, "simgap/simulators/pybullet.py", lambda text: text + "\n# changed\n")
    assert {"rollouts": 2, "fresh": 1}.items() <= jobs.items()
    assert jobs["synthesis"] == 1  # the one with the gap; that of the nominal model knows no engine
    assert edited(project, "simgap/simulators/mujoco.py", lambda text: text + "\n# changed\n") == {}


def test_another_engine_reruns_nothing(project):
    line = '"mujoco": "simgap.simulators.mujoco:MuJoCoJoints",'
    assert (
        edited(project, "simgap/plugins.py", lambda text: text.replace(line, line + line.replace("mujoco", "b"))) == {}
    )


def test_what_is_left_of_a_diagnosis_does_not_hinder_a_case_that_lost_its_recordings(project):
    left = project.folder / "results/small/diagnosis/diagnosis.json"
    left.parent.mkdir()
    left.write_text("{}")
    (left.parent / "transitions.parquet").touch()
    jobs = project.planned()
    shutil.rmtree(left.parent)
    assert jobs == {}


def test_a_model_file_is_part_of_what_was_read(project):
    urdf = project.folder / "configs/models/pendulum.urdf"
    original = urdf.read_text()
    urdf.write_text(original.replace('mass value="1.0"', 'mass value="1.1"'))
    jobs = project.planned()
    urdf.write_text(original)
    assert jobs.get("rollouts") == 2


def test_an_overlay_of_the_sweep_adds_only_new_points(project):
    overlay = project.folder / "more.yaml"
    overlay.write_text(yaml.safe_dump({"sweeps": {"small": {"eps": [0.02, 0.05]}}}))
    jobs = project.planned("--configfile", str(overlay), "--", "results/small/full/report.html")
    assert {stage: jobs.get(stage) for stage in ROAD - {"fresh"}} == {
        "grid": 1, "rollouts": 2, "borders": 1, "scp": 1, "lipschitz": 1, "gap": 1
    }  # fmt: skip
    assert not {"fresh", "synthesis"} & set(jobs)
    assert jobs["validation"] == jobs["audit"] == jobs["report"] == 1  # the trials of a full run


def test_a_truncated_shard_is_one_line_with_the_file_and_the_remedy(project, tmp_path):
    shard = project.folder / "results/small/rollouts/eps~0.02/shard-0.parquet"
    cut = tmp_path / "cut.parquet"
    cut.write_bytes(shard.read_bytes()[:-200])
    command = [sys.executable, "-m", "simgap.cli", "scp", str(project.case), "--rollouts", str(cut)]
    command += ["--rollouts", str(shard.with_name("shard-1.parquet"))]
    command += ["--grid", str(project.folder / "results/small/grid/eps~0.02")]
    command += ["--borders", str(project.folder / "results/small/borders/eps~0.02/samples.parquet")]
    command += ["--out", str(tmp_path / "x1.json"), "--log", str(tmp_path / "l")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert str(cut) in done.stderr
    assert "Delete it" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "x1.json").exists()


def test_a_mistake_in_a_case_is_told_by_the_workflow(project):
    original = project.case.read_text()
    project.change(lambda c: c["grid"].__setitem__("epz", 1))
    done = project.snakemake("-n", check=False)
    project.case.write_text(original)
    assert done.returncode != 0
    assert "grid.epz" in done.stderr + done.stdout


def test_what_a_stage_refuses_is_the_last_line_of_the_run(project, tmp_path):
    own = project.copied(tmp_path / "own")
    own.change(lambda c: c["gap"].__setitem__("basis", ["x1", "zz", 1]))
    done = own.snakemake(check=False)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("simgap: configs/cases/small.yaml: gap.basis: 'zz' names 'zz', which is not known.")
    assert last.endswith("[check, results/small/logs/check.log]")


def test_cases_that_are_no_list_are_one_line(project):
    overlay = project.folder / "one.yaml"
    overlay.write_text("cases: small\n")
    done = project.snakemake("-n", "--configfile", str(overlay), check=False)
    assert done.returncode == 2
    assert "cases: a list of names is needed, got 'small'. Write `cases: [small]`." in done.stderr
    assert "Traceback" not in done.stderr


def test_cases_of_other_configs_stay_on_the_index(project):
    """A second case is run by a config of its own; both are linked, and the first config has nothing to do again."""
    content = yaml.safe_load(project.case.read_text()) | {"name": "second", "title": "Second of two"}
    (project.folder / "own").mkdir()
    urdf = project.folder / "configs/models/pendulum.urdf"
    content["plant"]["urdf"] = os.path.relpath(urdf, project.folder / "own")
    (project.folder / "own/second.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    results = project.folder / "results"
    shutil.copytree(results / "small", results / "other")  # as if a run of another config had made it
    env = os.environ | {"PYTHONPATH": str(project.folder)}
    command = [sys.executable, "-m", "simgap.cli", "run", "own/second.yaml", "--until=index", "--forcerun=index"]
    plan = subprocess.run([*command, "--dry-run", "-p"], cwd=project.folder, env=env, capture_output=True, text=True)
    shutil.rmtree(results / "other")
    assert plan.returncode == 0, plan.stderr
    (line,) = [row for row in (plan.stdout + plan.stderr).splitlines() if "simgap index" in row]
    assert "--summary results/second/summary.json" in line
    assert "--earlier results/other/summary.json" in line
    assert "--earlier results/small/summary.json" in line


def test_the_name_of_a_recording_is_never_shell(project):
    """A free pendulum without friction, recorded under a name that a shell or a wildcard would take apart."""
    name = "$(touch PWNED) run {1}'; touch PWNED; '.csv"
    folder = project.folder / "configs/cases"
    case = yaml.safe_load((ROOT / "configs/cases/multiarm_pendulum.yaml").read_text())
    case |= {"name": "named", "measured": {"files": [name], "window_s": 0.5, "horizon_s": 0.5}}
    (folder / "named.yaml").write_text(yaml.safe_dump(case, sort_keys=False))
    t = np.arange(0, 4, 0.01)
    q = 0.05 * np.cos(8.012 * t)  # small swings at sqrt(m g c / inertia)
    rows = "\n".join(
        f"{a:.4f},{b:.6f}" for a, b in zip(t, q + 1e-3 * np.random.default_rng(5).normal(size=t.size), strict=True)
    )
    (folder / name).write_text("t,q\n" + rows + "\n")
    overlay = project.folder / "named.yaml"
    overlay.write_text(yaml.safe_dump({"cases": ["named"], "sweeps": {}}))
    result = "results/named/diagnosis/diagnosis.json"
    project.snakemake("--configfile", str(overlay), "--", result)
    assert json.loads((project.folder / result).read_text())["data"]
    assert not list(project.folder.rglob("PWNED"))
    (folder / name).unlink()
