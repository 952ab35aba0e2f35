"""A run takes nothing from the folder that it is started in but the case: no module, no profile."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.little_cart import write_cart

MODULES = ("yaml", "types", "numpy", "simgap", "snakemake", "sitecustomize", "usercustomize", "json", "pandas")
RAN = "open({!r}, 'a').write(__file__ + '\\n')\nraise ImportError('of the folder')\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """With modules and a profile beside the case, and a note of which of the modules ran."""
    (tmp_path / "here/profiles/default").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here")
    bound = {
        "simulator": {"engine": "equations", "integrator": "rk4"},
        "grid": {"eps": 0.1},
        "gap": {"basis": ["x", 1]},
    }
    write_cart(Path(), name="bounded", **bound).rename("bounded.yaml")
    write_cart(Path())
    for name in MODULES:
        Path(f"{name}.py").write_text(RAN.format(str(tmp_path / "ran")))
    Path("profiles/default/config.yaml").write_text("touch: true\nquiet: [all]\n")
    return tmp_path / "here"


def command(*words):
    return subprocess.run(
        [Path(sys.executable).with_name("simgap"), *words], capture_output=True, text=True, timeout=200, check=False
    )


def test_modules_and_profiles_beside_the_case_are_left_alone(folder):
    Path("sweep.yaml").write_text("case: bounded.yaml\naxes: {domain.tau: [0.01, 0.02]}\n")
    for words in (["run", "cart.yaml", "--dry-run"], ["sweep", "sweep.yaml", "--dry-run"], ["check", "bounded.yaml"]):
        done = command(*words)
        assert "check" in done.stdout + done.stderr, done.stderr  # the plan: its own profile says quiet: all
    assert not (folder.parent / "ran").exists()
