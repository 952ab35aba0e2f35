"""How long a plain run lasts by the order in which its jobs begin: the workflow again, with stages that sleep.

    python benchmarks/schedule.py RESULTS [--rules FOLDER] [--cores 2] [--scale 0.1]

Snakemake itself schedules a copy of the workflow. Every stage is a stand-in that sleeps for the wall time that its job
took in RESULTS (the `results` of a run), times the scale, and leaves empty files; nothing is computed, so that a busy
machine answers like an idle one. `--rules` takes the rules from elsewhere, such as from another commit. A stage that
was given another number of workers than then takes in proportion, but for `synthesis`, which gains little.

The last line compares the whole with what cannot be undercut: all core-seconds over the cores.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from schedule_stand_in import THEN

from simgap.io.runs import job_times

ROOT = Path(__file__).parents[1]
WIDE = ("validation", "audit", "fresh", "synthesis")  # jobs that had two cores each
STAND_IN = """
import sys
sys.path.insert(0, {here!r})
from schedule_stand_in import stand_in
stand_in({plan!r}, sys.argv[1:])
"""


def replay(results: Path, rules: Path, cores: int, scale: float) -> tuple[float, float]:
    """Seconds that the run lasts, and those that its jobs take on one core each, both without the scale."""
    jobs = {f"{job.case}/{job.job}": job.wall for job in job_times(results)}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name in ("configs", "profiles", "reports"):
            shutil.copytree(ROOT / name, folder / name)
        shutil.copytree(rules, folder / "rules")
        shutil.copy(rules.parent / "Snakefile", folder / "Snakefile")
        plan, script = folder / "plan.json", folder / "stand_in.py"
        plan.write_text(json.dumps({"jobs": jobs, "scale": scale, "results": str(results.resolve())}))
        script.write_text(STAND_IN.format(here=str(Path(__file__).parent), plan=str(plan)))
        for path in (folder / "rules").glob("*.smk"):
            path.write_text(path.read_text().replace('"simgap ', f'"python -S {script} '))
        began = time.monotonic()
        command = [sys.executable, "-m", "snakemake", "--cores", str(cores), "--quiet", "all"]
        subprocess.run(command, cwd=folder, check=True)
        lasted = time.monotonic() - began
        found = job_times(folder / "results")
    two = {name for name in jobs if name.rpartition("/")[2].split("-")[0] in WIDE}
    needed = sum(jobs.get(name, 0.0) * (THEN if name in two else 1) for name in (f"{j.case}/{j.job}" for j in found))
    return lasted / scale, needed


def main() -> None:
    """Print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path)
    parser.add_argument("--rules", type=Path, default=ROOT / "rules")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--scale", type=float, default=0.1)
    given = parser.parse_args()
    lasted, needed = replay(given.results, given.rules, given.cores, given.scale)
    print(
        f"{lasted:.0f} s on {given.cores} cores; {needed:.0f} core-seconds over them are {needed / given.cores:.0f} s"
    )


if __name__ == "__main__":
    main()
