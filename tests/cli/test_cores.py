"""Cores of a job: one beside other cases, so that none is idle; two where a case is alone."""

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize(("cases", "workers"), [('["pendulum"]', "2"), ('["pendulum","turtlebot"]', "1")])
def test_a_job_takes_one_core_beside_other_cases(root, tmp_path, cases, workers):
    plan = ["-n", "-p", "--cores", "2", "--config", f"cases={cases}", "--forceall"]
    target = "results/pendulum/synthesis/nominal/controller.npz"
    done = subprocess.run(
        [sys.executable, "-m", "snakemake", *plan, "--", target], cwd=root, capture_output=True, text=True,
        env={k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {"XDG_CACHE_HOME": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "compiles its kernels, once" in done.stderr  # none are kept there yet
    (line,) = (row for row in done.stdout.splitlines() + done.stderr.splitlines() if "simgap synthesis " in row)
    assert f"--workers {workers} " in line
