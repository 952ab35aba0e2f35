"""What a command may have imported when it ends, of all that takes long to import: a stage imports what it uses."""

import subprocess
import sys

import pytest

from tests.little_cart import CASE, write_cart

LARGE = {
    "sympy", "numba", "scipy.linalg", "scipy.sparse", "scipy.special", "scipy.optimize", "scipy.signal", "scipy.stats",
    "pyarrow", "pydrake", "pybullet", "mujoco", "matplotlib", "rerun", "cvxpy", "jinja2", "pandas", "snakemake",
}  # fmt: skip
COMPILED = {"sympy", "numba", "scipy.linalg"}  # numba asks SciPy for its linear algebra
STAGES = {
    "check cart.yaml": {"sympy"},
    "grid cart.yaml --point eps~0.1 --out grid": {"pyarrow"},
    "fresh cart.yaml --workers 1 --out fresh.parquet": {"pyarrow"},
    "rollouts cart.yaml --grid grid --out shard.parquet": {"pyarrow"},
    "borders cart.yaml --point eps~0.1 --out borders.parquet": {"pyarrow", "sympy"},
    "lipschitz cart.yaml --grid grid --rollouts shard.parquet --out slopes.json":
        COMPILED | {"pyarrow", "scipy.special", "scipy.optimize", "scipy.sparse", "scipy.stats"},
    "scp cart.yaml --grid grid --rollouts shard.parquet --borders borders.parquet --out program.json":
        COMPILED | {"pyarrow", "scipy.special", "scipy.sparse"},
    "synthesis cart.yaml --out nominal.npz --summary nominal.json": COMPILED,
}  # fmt: skip
RUN = "from simgap.cli import main\ntry: main({})\nexcept SystemExit as ended: assert not ended.code, ended.code\n"
HASHES = """
from pathlib import Path; from simgap.config.load import load_case
from simgap.provenance import READS, code_digest, versions
for path in sorted(Path('configs/cases').glob('*.yaml')):
    case = load_case(path)
    for stage in READS: code_digest(stage, case, path.parent), versions(stage, case, path.parent)
"""
OTHERS = {
    "import simgap": set(),
    "import simgap.cli": set(),
    "import simgap.api": set(),
    HASHES: set(),  # each start of the workflow reads its cases and hashes their stages
    "import simgap.lint.engine, simgap.simulators.rollouts": set(),  # what a process of an engine begins with
    "import simgap.stages.diagnosis": {"numba", "scipy.linalg", "scipy.special"},  # it draws when it has an answer
    "import simgap.stages.report": set(),
    "import simgap.stages.synthesis, simgap.stages.audit, simgap.stages.validation": set(),
}
TABLE = """
import sys
import numpy as np
from simgap.cli.process import without_pandas
without_pandas()
from simgap.io.results import read_parquet, stack, table, write_parquet
from pathlib import Path
path = Path("t.parquet")
write_parquet(path, table({"x": np.arange(3.0)}, {}, {"case": "rod", "seed": 1}, {}))
assert stack(read_parquet(path), ["x"]).tolist() == [[0.0], [1.0], [2.0]]
assert "pandas" not in sys.modules
import pandas  # what a plug-in asks for itself
assert pandas.Series([1, 2]).sum() == 3
"""


def imported(code, folder):
    """Which of the large packages a process has when it has run the code."""
    told = f"\nimport sys\nprint('had', *({LARGE} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code + told], cwd=folder, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split()[1:])


def test_a_stage_imports_what_it_uses(tmp_path):
    equations = {"dynamics": {"x": "v", "v": "F - 0.1*v"}}
    simulator = {"engine": "equations", "integrator": "rk4", "equations": equations, "slopes": "sampled"}
    target = {"kind": "invariance"}
    write_cart(
        tmp_path, domain=CASE["domain"] | {"tau": 0.2}, simulator=simulator, grid={"eps": 0.1, "shards": 1},
        gap={"basis": ["v", 1], "fresh_samples": 100},
        synthesis={"cells": [20, 20], "specification": target},
    )  # fmt: skip
    for command, allowed in STAGES.items():
        found = imported(RUN.format(command.split()), tmp_path)
        assert found <= allowed, (command, found - allowed)


@pytest.mark.parametrize("code", OTHERS)
def test_nothing_is_imported_before_it_is_needed(code, root):
    assert imported(code, root) <= OTHERS[code]


def test_tables_need_no_pandas_and_a_plugin_gets_it(tmp_path):
    assert "pandas" in imported(TABLE, tmp_path)
