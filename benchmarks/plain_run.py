"""Where the CPU time of a plain run goes, and how fast the machine is that it was measured on.

    python benchmarks/plain_run.py                    seconds of a fixed PyBullet loop, to compare machines by
    python benchmarks/plain_run.py RESULTS            and the CPU time of a run by stage, kept beside the one before

A row is a group of stages, a column a case, from what the jobs left behind (`simgap times`); what is kept makes the
table in docs/evidence/speed.md (`python benchmarks/tables.py`).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from pathlib import Path

import numpy as np
import pybullet as p
from rollouts import bare

from simgap.io.runs import job_times

OUT = Path(__file__).parent / "results" / "plain_run.json"
GROUPS = {
    "roll-outs, fresh, borders": "rollouts|fresh|borders|grid",
    "scp, lipschitz, gap": "scp|lipschitz|gap",
    "synthesis": "synthesis",
    "validation": "validation",
    "audit": "audit",
    "diagnosis, check, pages, other": "",
}
LOOP, ROUNDS = 100_000, 5


def machine() -> float:
    """CPU seconds of the loop: reset, torque, step and read of a pendulum; the least of a few rounds."""
    rng = np.random.default_rng(0)
    x, u = rng.uniform([-0.2, -0.5], [0.2, 0.5], (LOOP, 2)), rng.uniform(-1.2, 1.2, (LOOP, 1))
    return min(bare(x, u, time.process_time) for _ in range(ROUNDS))


def by_stage(results: Path) -> dict[str, dict[str, float]]:
    """CPU seconds by case and group of stages; other numbers of trials than a plain run's are left out."""
    found: dict[str, dict[str, float]] = {}
    for job in job_times(results):
        if job.case.endswith(("/full", "/deep")):
            continue
        name = next(n for n, stages in GROUPS.items() if re.match(stages, job.job))
        case = found.setdefault(job.case.removesuffix("/first"), dict.fromkeys(GROUPS, 0.0))
        case[name] = round(case[name] + job.cpu, 1)
    return found


def main() -> None:
    """Print, and keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, nargs="?")
    given = parser.parse_args().results
    seconds = machine()
    print(
        f"{seconds:.2f} CPU s for {LOOP:,} steps of a pendulum in PyBullet {p.getAPIVersion()}, {os.cpu_count()} cores"
    )
    if given is None:
        return
    kept = json.loads(OUT.read_text()) if OUT.exists() else {}
    kept["now"] = {"machine_s": round(seconds, 2), "cases": by_stage(given)}
    OUT.write_text(json.dumps(kept, indent=1) + "\n")
    json.dump(kept["now"], sys.stdout, indent=1)


if __name__ == "__main__":
    main()
