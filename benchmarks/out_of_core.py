"""Peak memory of the stages from grid to scenario program by the number of samples, at the speed of equations.

    python benchmarks/out_of_core.py [1e6 4e6 ... 1e8]

The DC motor against equations that are treated as a black box, one shard for every million samples. The last row is
what a stage's peak grows by, in bytes a sample, between the smallest and the largest size: 0 for one that streams.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pyarrow.parquet as pq
import yaml

ROOT = Path(__file__).parents[1]
INPUTS = 13
AREA = 6.5 * 14.0
"""Of the states of configs/cases/dc_motor.yaml."""


def stage(*words: str) -> float:
    """Run a stage: -> peak resident memory of its largest process, bytes.

    The child is started by a small process, because a process begins with the peak of the one that it was forked from.
    """
    code = (
        "import resource, subprocess, sys\n"
        "subprocess.run([sys.executable, '-m', 'simgap.cli', *sys.argv[1:]], check=True)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    begun = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code, *words], check=True, stdout=subprocess.PIPE, text=True)
    peak = 1024.0 * float(done.stdout.split()[-1])
    print(f"{words[0]}: {time.monotonic() - begun:.0f} s, {peak / 2**20:.0f} MiB", file=sys.stderr, flush=True)
    return peak


def peaks(count: float) -> tuple[int, dict[str, float]]:
    """Samples that there were, and the peak of each stage in bytes, for about so many."""
    case = yaml.safe_load((ROOT / "configs" / "cases" / "dc_motor.yaml").read_text())
    case["simulator"]["slopes"] = "sampled"
    shards = max(1, round(count / 1e6))
    case["grid"] = {"eps": float((AREA * INPUTS / 2.0 / count) ** 0.5), "shards": shards}
    case["budget"] = {"memory": "64 GB", "time": "10 h"}
    for section in ("synthesis", "validation", "audit"):
        case.pop(section, None)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        path = folder / "dc_motor.yaml"
        path.write_text(yaml.safe_dump(case, sort_keys=False))
        grid, log = str(folder / "grid"), ("--log", str(folder / "log"))
        found = {"grid": stage("grid", str(path), "--out", grid, *log)}
        files = [str(folder / f"shard-{k}.parquet") for k in range(shards)]
        for k, file in enumerate(files):
            peak = stage("rollouts", str(path), "--grid", grid, "--shard", str(k), "--out", file, *log)
            found["rollouts"] = max(peak, found.get("rollouts", 0.0))
        point = f"eps~{case['grid']['eps']:g}"
        borders = str(folder / "borders.parquet")
        found["borders"] = stage("borders", str(path), "--point", point, "--out", borders, *log)
        rolled = [word for file in files for word in ("--rollouts", file)]
        common = (str(path), "--grid", grid, *rolled, "--out", str(folder / "out.json"), *log)
        found["lipschitz"] = stage("lipschitz", *common)
        found["scp"] = stage("scp", *common, "--borders", borders)
        total = sum(pq.read_metadata(file).num_rows for file in files)
        return total, found


def main() -> None:
    """Print the table."""
    rows = [peaks(float(word)) for word in sys.argv[1:] or ("1e6", "4e6")]
    names = list(rows[0][1])
    print("| samples | " + " | ".join(f"{n}, MiB" for n in names) + " |\n|" + "---|" * (1 + len(names)))
    for count, found in rows:
        print(f"| {count:,} | " + " | ".join(f"{found[n] / 2**20:.0f}" for n in names) + " |")
    (few, least), (many, most) = rows[0], rows[-1]
    if many > few:
        grown = " | ".join(f"{(most[n] - least[n]) / (many - few):.1f}" for n in names)
        print(f"| bytes a sample more | {grown} |")


if __name__ == "__main__":
    main()
