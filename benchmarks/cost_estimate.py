"""What `simgap check` says a case will cost beside what its stages spent.

    python benchmarks/cost_estimate.py RESULTS [--cases dc_motor dcdc]     (results of a run with these cases)
    python benchmarks/cost_estimate.py --run dc_motor dcdc                 (runs them first, a minute or two each)

Estimates are made now, with the engine asked now; measured are CPU seconds from the logs of the run, jobs of the case's
own point alone. What `check` calls "at most" is no estimate and is marked. The last column is estimate over measured.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from simgap.gap.sampling.points import own_point
from simgap.io.runs import JobTime, job_times
from simgap.lint.costs import costs, slowness
from simgap.lint.engine import of_engine
from simgap.plants.context import Context

ROOT = Path(__file__).parents[1]
APART = 3.0
"""How far apart estimate and measurement of a stage may be; of a whole run benchmarks/public_models.py has it."""


def measured(jobs: Sequence[JobTime], case: str, stage: str, point: str) -> float:
    """CPU seconds of a stage of a case at its own point, both controllers, all shards and all states."""
    own = [j for j in jobs if j.case == case and re.fullmatch(rf"{stage}(-.*)?", j.job)]
    own = [j for j in own if j.job not in ("synthesis-baseline", "audit-deep")]
    return sum(j.cpu for j in own if "~" not in j.job or point in j.job)


def rows(results: Path, folder: Path, case: str) -> list[tuple[str, float, float, bool]]:
    """Stage, estimate, measured, whether the estimate is an upper end."""
    context = Context.load(folder / f"{case}.yaml")
    began = time.process_time()
    _ = context.plant.sampled
    build = time.process_time() - began
    _, rollout = of_engine(context, None)
    jobs, point = job_times(results), own_point(context.case)
    every = costs(context, rollout, build=build, slower=slowness())
    found = [(c.stage, c.seconds, measured(jobs, case, c.stage, point), c.at_most) for c in every]
    return [row for row in found if row[2] > 0]


def show(results: Path, folder: Path, cases: Sequence[str]) -> int:
    """Print a table; -> how many estimates are too far from what was measured."""
    apart = 0
    print("| case | stage | estimate, CPU s | measured | ratio |\n|---|---|---|---|---|")
    for case in cases:
        found = rows(results, folder, case)
        whole = ("all of these", sum(e for _, e, _, m in found if not m), sum(s for *_, s, m in found if not m), False)
        for stage, estimate, spent, at_most in [*found, whole]:
            ratio = estimate / spent
            far = ratio < 1 / APART or (ratio > APART and not at_most)
            apart += far
            mark = " (at most)" if at_most else " **apart**" if far else ""
            print(f"| {case} | {stage} | {estimate:.1f} | {spent:.1f} | {ratio:.2f}{mark} |")
    return apart


def main() -> None:
    """Compare; status 1 where an estimate is off."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="?")
    parser.add_argument("--cases", nargs="+")
    parser.add_argument(
        "--from", dest="folder", type=Path, default=ROOT / "configs" / "cases", help="folder of the cases"
    )
    parser.add_argument("--run", nargs="+", default=[])
    given = parser.parse_args()
    if given.results is not None:
        cases = given.cases or sorted({j.case for j in job_times(given.results) if "/" not in j.case})
        sys.exit(bool(show(given.results, given.folder, cases)))
    with tempfile.TemporaryDirectory() as folder:
        files = [str(given.folder.resolve() / f"{name}.yaml") for name in given.run or ("dc_motor", "dcdc")]
        subprocess.run([sys.executable, "-m", "simgap.cli", "run", *files, "--cores", "1"], cwd=folder, check=True)
        sys.exit(bool(show(Path(folder) / "results", given.folder, [Path(f).stem for f in files])))


if __name__ == "__main__":
    main()
