"""The wheel, built and installed far from the checkout, diagnoses a recording in an empty folder."""

import json
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.stages import diagnosis_example as example

ROOT = Path(__file__).parents[2]
MEASURED = "measured: {effects: [coulomb_friction], max_effects: 1}\n"


def call(*arguments, cwd):
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(arguments, cwd=cwd, env=env, capture_output=True, text=True, timeout=1800, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder of the executables of an environment with the wheel; its dependencies are those of this one."""
    folder = tmp_path_factory.mktemp("wheel")
    status, _, error = call(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder), cwd=ROOT)
    assert status == 0, error
    (wheel,) = folder.glob("simgap-*.whl")
    venv.create(folder / "venv", with_pip=True)
    python = folder / "venv/bin/python"
    status, _, error = call(
        str(python), "-m", "pip", "install", "--no-deps", "--no-index", "--quiet", str(wheel), cwd=folder
    )
    assert status == 0, error
    (site,) = (folder / "venv/lib").glob("python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")  # searched after its own packages
    status, where, error = call(str(python), "-c", "import simgap; print(simgap.__file__)", cwd=folder)
    assert where.strip().startswith(str(site)), error
    return folder / "venv/bin"


@pytest.fixture
def bench(tmp_path):
    (tmp_path / "bench.yaml").write_text(example.CASE + MEASURED)
    (trace,) = example.record().traces
    rows = np.column_stack([trace.t, trace.y, trace.u])
    np.savetxt(tmp_path / "bench.csv", rows, delimiter=",", header="t,q,v,u", comments="", fmt="%.9g")
    return tmp_path


def test_the_version_is_the_same_everywhere(installed, tmp_path):
    status, text, _ = call(str(installed / "simgap"), "--version", cwd=tmp_path)
    assert status == 0
    name, version = text.split()[:2]
    assert (name, version) == ("simgap", tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"])
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert str(cited["version"]) == version
    newest = re.search(r"^## (\S+) \((\S+)\)$", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)
    assert newest.groups() == (version, str(cited["date-released"]))
    status, text, _ = call(str(installed / "python"), "-c", "import simgap; print(simgap.__version__)", cwd=tmp_path)
    assert (status, text.strip()) == (0, version)


def test_a_diagnosis_in_an_empty_folder(installed, bench):
    status, text, error = call(
        str(installed / "simgap"), "diagnose", "bench.yaml", "bench.csv", "--out", "d", cwd=bench
    )
    assert status == 0, error
    assert text.startswith("attributed: Coulomb friction")
    assert json.loads((bench / "d/diagnosis.json").read_text())["verdict"] == "attributed"
    page = (bench / "d/report.html").read_text()
    assert "Coulomb friction" in page
    assert "--ink:" in page  # the style sheet is inside


def test_the_whole_workflow_without_a_checkout(installed, bench):
    """The rules, profiles and templates come with the wheel; this case has no more than a nominal model to check."""
    status, _, error = call(str(installed / "simgap"), "run", "bench.yaml", "--cores", "1", cwd=bench)
    assert status == 0, error
    assert json.loads((bench / "results/bench/check/check.json").read_text())["case"] == "bench"
    status, text, error = call(str(installed / "simgap"), "run", "bench.yaml", cwd=bench)
    assert status == 0, error
    assert "Nothing to be done" in text + error


def test_the_schema_is_shipped(installed):
    (schema,) = installed.parent.glob("lib/python*/site-packages/simgap/workflow/schema.json")
    assert schema.read_bytes() == (ROOT / "configs/schema.json").read_bytes()


def test_the_checker_is_shipped(installed):
    (checker,) = installed.parent.glob("lib/python*/site-packages/simgap/workflow/checker/check.py")
    assert call(str(installed / "python"), str(checker), "--help", cwd=checker.parent)[0] == 0


def test_types_are_shipped(installed):
    (marker,) = installed.parent.glob("lib/python*/site-packages/simgap/py.typed")
    assert marker.is_file()


def test_a_missing_template_is_told_before_the_fit(installed, bench):
    (template,) = installed.parent.glob("lib/python*/site-packages/simgap/templates/diagnosis.html.j2")
    hidden = template.rename(template.with_suffix(".away"))
    status, _, error = call(str(installed / "simgap"), "diagnose", "bench.yaml", "bench.csv", "--out", "e", cwd=bench)
    hidden.rename(template)
    assert status == 2
    assert "diagnosis.html.j2" in error
    assert len(error.strip().splitlines()) == 1
    assert not (bench / "e").exists()
