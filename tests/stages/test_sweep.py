"""A sweep over any key: its points are cases, points that need the same roll-outs share them, one table and page."""

import os
import re
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from simgap.config.load import load_case
from simgap.config.run import points_of_sweep
from simgap.errors import UserError
from simgap.extras.wizard import new_case as new
from simgap.gap.bounds.function import GapDomain, Tier
from simgap.gap.bounds.linear import Basis, Form, LinearGap
from simgap.geometry import Box
from simgap.io.results import write_json
from simgap.provenance import sections_digest
from simgap.stages import sweep

AXES = {"gap.slack": [0.01, 0.05], "synthesis.cells": [[200, 200], [100, 100]]}


@pytest.fixture
def write(tmp_path):
    """Write a sweep over a case that `simgap new` writes: -> its file."""
    case = new.run("mine", None, tmp_path)

    def make(axes, **more):
        path = tmp_path / "sweeps/two.yaml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(yaml.safe_dump({"case": f"../{case.name}", "axes": axes, **more}))
        return path

    return make


def test_every_combination_or_one_after_the_other(write):
    grid = points_of_sweep(write(AXES))
    assert [(p.case.gap.slack, p.case.synthesis.cells) for p in grid] == [
        (0.01, (200, 200)), (0.01, (100, 100)), (0.05, (200, 200)), (0.05, (100, 100)),
    ]  # fmt: skip
    zipped = points_of_sweep(write(AXES, mode="zip"))
    assert [p.name for p in zipped] == [grid[0].name, grid[3].name]  # named by what they are
    assert len({p.name for p in grid}) == 4


@pytest.mark.parametrize(
    ("axes", "more", "words"),
    [
        ({"gap.slak": [1]}, {}, "gap.slak: unknown key. Did you mean 'slack'?"),
        ({"gap.slack.x": [1], "gap.slack": [1]}, {}, "gap.slack"),
        ({"title.x": [1]}, {}, "axes.title.x: 'title' has no keys"),
        ({"gap.slack": [0.1, 0.2], "gap.seed": [1]}, {"mode": "zip"}, "axes: zipped axes have different lengths"),
        ({"gap.slack": []}, {}, "axes: there is no point"),
        ({"gap.slack": 3}, {}, "axes.gap.slack: a list is needed, got 3"),
        ({"gap.seed": list(range(50)), "audit.seed": list(range(50))}, {}, "axes: there are more than 1000 points"),
        ({"gap.slack": [1]}, {"axis": {}}, "axis: unknown key. Did you mean 'axes'?"),
        ({"gap.slack": [1]}, {"mode": "list"}, "mode: there is no choice 'list'"),
        ({}, {}, "axes: at least 1 entries are needed"),
        ({"gap.slack": [0.1, 0.1]}, {}, "axes: a point appears twice"),
    ],
)
def test_mistakes_are_one_line(write, axes, more, words):
    path = write(axes, **more)
    with pytest.raises(UserError, match=re.escape(words)) as told:
        points_of_sweep(path)
    assert str(path) in str(told.value)


def test_the_case_of_a_point_stands_by_itself(root, tmp_path):
    case = new.run("rod", root / "configs/models/pendulum.urdf", tmp_path)
    path = tmp_path / "wide.yaml"
    path.write_text(yaml.safe_dump({"case": case.name, "axes": {"grid.eps": [0.02]}}))
    (point,) = points_of_sweep(path)
    out = tmp_path / "results/sweeps/wide/cases/point.yaml"
    sweep.write_point(path, point.name, out)
    made = load_case(out)
    assert made.grid.eps == 0.02
    assert (out.parent / made.plant.urdf).resolve() == (root / "configs/models/pendulum.urdf").resolve()


def test_table_and_page(write, tmp_path):
    path = write({"gap.slack": [0.01], "synthesis.cells": [[100, 100]], "gap.seed": [3, 4]})
    files = []
    for k, point in enumerate(points_of_sweep(path)):
        files.append(tmp_path / "results" / point.name / "summary.json")
        files[-1].parent.mkdir(parents=True)
        write_json(files[-1], {"case": point.name, "winning_fraction": {"gap": 0.25 + k, "nominal": 0.5}, "l": [1]})
    (files[0].parent / "report.html").write_text("")
    out = tmp_path / "results/sweeps/two/report.html"
    sweep.run(path, files, out, out.with_name("table.parquet"))
    table = pq.read_table(out.with_name("table.parquet")).to_pydict()
    assert table["gap.seed"] == [3, 4]
    assert table["synthesis.cells"] == ["[100, 100]"] * 2
    assert table["winning_fraction.gap"] == [0.25, 1.25]
    page = out.read_text()
    assert page.count("<svg") == 1
    assert 'Every figure of every point is in <a href="table.parquet"><code>table.parquet</code></a>.' in page
    assert "<td>25 %</td>" in page
    assert page.count(f'href="../../{files[0].parent.name}/report.html"') == 1
    assert files[1].parent.name in page
    with pytest.raises(UserError, match="has 2 points, 1 results are given"):
        sweep.run(path, files[:1], out, out.with_name("table.parquet"))


def test_points_share_what_is_the_same(root, write, tmp_path):
    """Four points over slack and cells need one grid, one set of roll-outs and of slopes, two programs a state."""
    path = write(AXES)
    config = {"case_folder": ".", "sweep_folder": "sweeps", "cases": ["mine"]}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(config))
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(root / "Snakefile"), "--cores", "1", "-n"]
    command += ["-p", "--configfile", "config.yaml", "--", "results/sweeps/two/report.html"]
    env = os.environ | {"PYTHONPATH": str(root)}
    done = subprocess.run(command, cwd=path.parents[1], env=env, capture_output=True, text=True, check=True)
    # Files that a case names lie elsewhere seen from a point: of its bound a point takes what points made.
    assert "results/mine/gap" not in done.stdout + done.stderr
    jobs = dict(re.findall(r"^(\w+) +(\d+)$", done.stdout + done.stderr, flags=re.M))
    assert {rule: int(jobs[rule]) for rule in
            ("grid", "fresh", "borders", "scp", "lipschitz", "gap", "synthesis", "sweep")} == {
        "grid": 1, "fresh": 1, "borders": 1, "scp": 2, "lipschitz": 1, "gap": 4, "synthesis": 8, "sweep": 1,
    }  # fmt: skip
    assert int(jobs["rollouts"]) == load_case(path.parents[1] / "mine.yaml").grid.shards


def test_model_files_of_a_twin_move_along_and_are_hashed(root, tmp_path):
    """What a simulator stands for is a file too."""
    (tmp_path / "m.urdf").write_text((root / "configs/models/pendulum.urdf").read_text())
    case = new.run("rod", tmp_path / "m.urdf", tmp_path)
    own = yaml.safe_load(case.read_text())
    own["twin"] = {"of": {"engine": "pybullet", "urdf": "m.urdf", "inertia": "file"}}
    case.write_text(yaml.safe_dump(own))
    path = tmp_path / "wide.yaml"
    path.write_text(yaml.safe_dump({"case": case.name, "axes": {"gap.seed": [7]}}))
    out = tmp_path / "results/sweeps/wide/cases/point.yaml"
    sweep.write_point(path, points_of_sweep(path)[0].name, out)
    assert (out.parent / load_case(out).twin.of.urdf).resolve() == (tmp_path / "m.urdf").resolve()
    before = sections_digest(load_case(case), ("twin",), tmp_path)
    (tmp_path / "m.urdf").write_text((tmp_path / "m.urdf").read_text() + "<!-- heavier -->")
    assert sections_digest(load_case(case), ("twin",), tmp_path) != before


def test_a_point_without_a_controller_shows_its_bound(write, tmp_path):
    path = write({"gap.seed": [3], "synthesis": [None]})
    (point,) = points_of_sweep(path)
    assert point.case.synthesis is None
    domain = GapDomain(("q", "v"), ("u",), Box([-1.0, -1.0], [1.0, 1.0]), np.array([[0.0], [1.0]]))
    basis = Basis(("1",), domain.states, domain.inputs)
    ranges = basis.ranges(domain.box, domain.input_set)
    forms = [Form(basis, ranges, domain.box, np.array([c])) for c in (-0.25, 0.0, 0.125, 0.5)]
    bound = LinearGap(domain, (Tier(1, "Made up."),), tuple(forms[:2]), tuple(forms[2:]))
    file = tmp_path / "results" / point.name / "gap/eps~0.01/gap.json"
    file.parent.mkdir(parents=True)
    write_json(file, bound.to_json())
    out = tmp_path / "results/sweeps/two/report.html"
    sweep.run(path, [file], out, out.with_name("table.parquet"))
    table = pq.read_table(out.with_name("table.parquet")).to_pydict()
    assert table["sup_gamma.q.size"][0] == pytest.approx(0.25, rel=1e-9)
    assert table["sup_gamma.v.width"][0] == pytest.approx(0.5, rel=1e-9)
