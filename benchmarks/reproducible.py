"""The same commit in two clones, on other dates, with one core and two, with cold caches and warm ones: the same bytes.

    python benchmarks/reproducible.py [--folder DIR] [--clock libfaketime.so.1]

Takes the tiny cases (tiny_cases.py) through every stage by `simgap run` in each of the circumstances below, and
compares the SHA-256 of every file but the listed exceptions: logs, timings, recordings. Recordings are compared by
content. Without libfaketime the date stays what it is, and the results say so. What is not committed is not cloned.
Called again, it goes on where it was; a new folder begins anew, its caches cold.
Results: benchmarks/results/reproducible.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import stage_runs
from stage_runs import UNEQUAL, digests
from storage_faults import faketime
from tiny_cases import NAMES, write_cases

RESULT = stage_runs.ROOT / "benchmarks/results/reproducible.json"
# Only one run is on another date: under libfaketime a sleep may fail, and with it what starts a process.
RUNS: Mapping[str, Mapping[str, Any]] = {
    "one core, cold caches": {"clone": "a", "cores": 1, "caches": "first", "environment": {"PYTHONHASHSEED": "1"}},
    "two cores, warm caches, another clone, 400 days later": {
        "clone": "another place/with a longer path/b", "cores": 2, "caches": "first", "days": 400,
        "environment": {"PYTHONHASHSEED": "2", "TZ": "Asia/Kathmandu", "LC_ALL": "C", "COLUMNS": "40"},
    },
    "two cores, cold caches, another clone": {
        "clone": "another place/with a longer path/b", "cores": 2, "caches": "second",
        "environment": {"TZ": "America/St_Johns", "LANG": "tr_TR.UTF-8"},
    },
}  # fmt: skip


def cloned(place: Path) -> Path:
    """A clone of this very commit."""
    if not place.exists():
        subprocess.run(["git", "clone", "--quiet", "--local", str(stage_runs.ROOT), str(place)], check=True)
    return place


def run(folder: Path, name: str, about: Mapping[str, Any], clock: str, cases: Sequence[str]) -> Path:
    """All stages in a folder of its own beside its clone; -> that folder."""
    clone = cloned(folder / about["clone"])
    work = clone.parent / f"run {name}"
    if (work / "ended").exists():
        return work
    if not work.exists():
        write_cases(work)
    caches = folder / f"caches {about['caches']}"
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPYCACHEPREFIX", "NUMBA_CACHE_DIR")}
    environment |= {"PATH": path, "PYTHONPATH": str(clone), "XDG_CACHE_HOME": str(caches)} | about["environment"]
    if clock and "days" in about:
        environment |= {"LD_PRELOAD": clock, "FAKETIME": f"{about['days']:+d}d", "FAKETIME_DONT_FAKE_MONOTONIC": "1"}
        environment |= {"DONT_FAKE_MONOTONIC": "1"}
    command = [sys.executable, "-m", "simgap.cli", "run", *cases, "--cores", str(about["cores"])]
    done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{name}: status {done.returncode}: {(done.stdout + done.stderr)[-3000:]}")
    (work / "ended").touch()
    return work


def same_content(one: Path, other: Path) -> bool:
    """Whether two recordings hold the same, whatever the order in which their parts were written."""
    rerun = Path(sys.executable).with_name("rerun")
    compare = [str(rerun), "rrd", "compare", "--unordered", str(one), str(other)]
    return subprocess.run(compare, capture_output=True, check=False).returncode == 0


def _commit() -> str:
    asked = ["git", "rev-parse", "HEAD"]
    return subprocess.run(asked, cwd=stage_runs.ROOT, capture_output=True, text=True, check=True).stdout.strip()


def main() -> None:
    """Run, compare, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("/tmp/simgap-reproducible"))
    parser.add_argument("--cases", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--clock", default=faketime())
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    folders = {name: run(asked.folder, name, about, asked.clock, asked.cases) for name, about in RUNS.items()}
    found = {name: digests(folder) for name, folder in folders.items()}
    first, *others = RUNS
    differ = {
        name: sorted(n for n in found[first].keys() | found[name].keys() if found[first].get(n) != found[name].get(n))
        for name in others
    }
    every = [p.relative_to(folders[first]) for p in folders[first].rglob("*") if p.is_file()]
    shown = [str(p) for p in every if p.suffix == ".rrd"]
    other_content = {n: [p for p in shown if not same_content(folders[first] / p, folders[n] / p)] for n in others}
    content = {
        "runs": len(RUNS),
        "cases": [*asked.cases],
        "files": len(found[first]),
        "differing": sum(map(len, differ.values())),
        "differ": differ,
        "recordings": len(shown),
        "recordings_of_other_content": other_content,
        "excepted": sum(bool(UNEQUAL.fullmatch(str(p))) for p in every),
        "another_date": bool(asked.clock),
        "commit": subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=stage_runs.ROOT, capture_output=True, text=True
        ).stdout.strip(),
    }
    RESULT.write_text(json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
