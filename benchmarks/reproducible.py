"""Two runs of the same cases, in two folders, with one and two cores, warm and cold caches: the same bytes.

    python benchmarks/reproducible.py [--folder DIR] [--minutes 4]

Both runs are `simgap run` on the tiny cases of stage_runs.py. The first uses one core and a new cache folder, the
second two cores, the caches of the first, and another folder with a longer name. Every file is compared byte by byte;
logs, timings and recordings (`.rrd`) are the exception, recordings are compared by content in the tests. With
`--minutes` a run that is not done is ended, and goes on when the benchmark is called again. Results:
results/reproducible.json.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import stage_runs

RESULT = stage_runs.ROOT / "benchmarks/results/reproducible.json"


def complete(folder: Path, cores: int, cache: Path, end: float) -> bool:
    """Run until all is there or the time is over."""
    if not (folder / "small.yaml").exists():
        stage_runs.write_cases(folder)
    run = stage_runs.workflow(folder, cores, "--quiet", "all", XDG_CACHE_HOME=str(cache), NUMBA_CACHE_DIR="")
    try:
        told = run.communicate(timeout=max(1.0, end - time.monotonic()))[0]
    except subprocess.TimeoutExpired:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        return False
    if run.returncode:
        sys.exit(told[-3000:])
    return True


def main() -> None:
    """Run twice, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("/tmp/simgap-reproducible"))
    parser.add_argument("--minutes", type=float, default=1e9)
    asked = parser.parse_args()
    end, cache = time.monotonic() + 60 * asked.minutes, asked.folder / "cache"
    folders = asked.folder / "one", asked.folder / "a/longer/name/of/a/folder"
    for cores, folder in enumerate(folders, 1):
        folder.mkdir(parents=True, exist_ok=True)
        if not complete(folder, cores, cache, end):
            print("not done; call it again")
            return
    one, two = (stage_runs.digests(folder) for folder in folders)
    differ = sorted(name for name in one.keys() | two.keys() if one.get(name) != two.get(name))
    content = {"files_compared": len(one), "differ": differ}
    RESULT.write_text(json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
