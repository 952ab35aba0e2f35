"""A folder of its own with a case and the workflow, and the pieces of code that the documentation shows."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]


def block(page, heading, language):
    """The first block of a language below a heading of a page."""
    text = (ROOT / page).read_text()
    below = text[text.index(f"\n## {heading}\n") :]
    return re.search(rf"```{language}\n(.*?)```", below, flags=re.S).group(1)


def scratch(folder, case, files):
    """Write a case, the files beside it and what the workflow reads: -> the path of the case."""
    cases = folder / "configs/cases"
    cases.mkdir(parents=True)
    for name, content in files.items():
        (cases / name).write_text(content)
    path = cases / f"{case['name']}.yaml"
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    default = {"case_folder": "configs/cases", "rig_folder": "configs/rigs", "cases": [case["name"]], "sweeps": {}}
    (folder / "configs/default.yaml").write_text(yaml.safe_dump(default))
    return path


def snakemake(folder, *targets):
    """Make targets as a person does, with the workflow of this checkout."""
    env = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "--cores", "2", *targets]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=900, check=False)
    if done.returncode:
        pytest.fail(f"{command} failed:\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    return done
