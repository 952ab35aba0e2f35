"""`simgap sweep` as a person types it: options for Snakemake, and mistakes of points before any of them runs."""

from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from simgap.cli import app, workflow
from simgap.errors import UserError

CASE = {
    "name": "rod",
    "plant": {
        "states": {"q": {"unit": "rad"}, "w": {"unit": "rad/s"}},
        "inputs": {"u": {"unit": "N*m"}},
        "symbolic": {"parameters": {}, "dynamics": {"q": "w", "w": "-10*sin(q) + u"}},
    },
    "domain": {"tau": 0.01, "X": {"q": [-0.2, 0.2], "w": [-1, 1]}, "U": {"u": {"values": [-1, 1]}}},
    "simulator": {"engine": "equations", "integrator": "rk4"},
    "grid": {"eps": 0.1},
    "gap": {"basis": ["q", 1]},
}


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """What the workflow would be asked, in a folder with a case."""
    monkeypatch.chdir(tmp_path)
    Path("rod.yaml").write_text(yaml.safe_dump(CASE))
    calls = []
    monkeypatch.setattr(workflow, "snakemake", lambda *arguments: calls.append(arguments))
    return calls


def typed(*words, name="fine", **content):
    Path(f"{name}.yaml").write_text(yaml.safe_dump({"case": "rod.yaml"} | content))
    return CliRunner().invoke(app, ["sweep", *words])


AXES = {"gap.fresh_samples": [500, 600]}


@pytest.mark.parametrize("words", [["fine.yaml", "--dry-run", "--quiet", "rules"], ["--dry-run", "fine.yaml"]])
def test_other_options_go_to_snakemake(asked, words):
    done = typed(*words, axes=AXES)
    assert done.exit_code == 0, done.exception
    ((_, cases, _, options, _),) = asked
    assert cases == ["rod"]
    assert options[-2:] == ["--", "results/sweeps/fine/report.html"]
    assert "--dry-run" in options
    assert "fine.yaml" not in options
    assert "Page:" not in done.output


def test_what_was_made_is_said_at_the_end(asked):
    Path("results/sweeps/fine").mkdir(parents=True)
    Path("results/sweeps/fine/report.html").touch()
    assert "fine: 2 points. Page: results/sweeps/fine/report.html" in typed("fine.yaml", axes=AXES).output


def test_a_run_that_ends_well_without_its_page_is_an_error(asked):
    assert isinstance(typed("fine.yaml", axes=AXES).exception, workflow.WorkflowFailed)
    done = CliRunner().invoke(app, ["run", "rod.yaml"])
    assert isinstance(done.exception, workflow.WorkflowFailed)
    assert "did not write results/rod/check/check.json" in str(done.exception)


def test_a_point_that_costs_too_much_is_told_with_its_values_before_any_runs(asked):
    done = typed("fine.yaml", axes={"grid.eps": [0.1, 1e-9]})
    assert isinstance(done.exception, UserError)
    assert "fine.yaml: grid.eps: the point grid.eps = 1e-09: " in str(done.exception)
    assert asked == []


@pytest.mark.parametrize("name", ["two words", "Upper", "a--b", "1st"])
def test_a_file_name_that_is_none_of_a_sweep_is_told_as_that(asked, name):
    done = typed(f"{name}.yaml", name=name, axes=AXES)
    assert isinstance(done.exception, UserError)
    assert "Rename it" in str(done.exception)
    assert asked == []


def test_a_case_without_a_bound_has_no_sweep(asked):
    """The workflow ended in an AttributeError."""
    Path("rod.yaml").write_text(yaml.safe_dump({key: value for key, value in CASE.items() if key != "gap"}))
    assert "gap: asks for no bound" in str(typed("fine.yaml", axes={"domain.tau": [0.01, 0.02]}).exception)
