"""What a diagnosis costs: CPU seconds and memory of `simgap diagnose` on records of growing length.

    python benchmarks/long_record.py [--lengths 30@200 360@1000 3600@1000]

A record of "seconds@hertz" is made by the rig of the undeclared effects (viscous friction, a delay of 4 ms, angle and
speed measured, sigma 1e-3), written as Parquet, and diagnosed by the command line with the whole library. The first,
short run of a fresh process compiles; its time is reported beside the others.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

ROOT = Path(__file__).parents[1]
OUT = ROOT / "benchmarks" / "results" / "long_record.json"
HIDDEN = {"b": 0.08}
DELAY = 0.004


def write_record(path: Path, seconds: float, rate: float) -> int:
    """One trace with hidden effects; returns its rows."""
    sys.path.insert(0, str(ROOT))
    from tests.undeclared.rig import pendulum as rig

    rng = np.random.default_rng(1)
    n, sample = int(seconds * rate) + 1, round(1.0 / (rate * rig.STEP))
    numbers = {**dict.fromkeys(rig.KEYS, 0.0), **rig.NOMINAL, "gain": 1.0, "limit": np.inf, "v_s": 1.0, **HIDDEN}
    piece = rig.multisine(rng, int(60 * rate), rate)
    u = np.resize(piece, n)
    x = rig.integrate(
        np.array([numbers[k] for k in rig.KEYS]), u, sample, round(DELAY / rig.STEP), np.zeros(2), rig.STEP
    )
    y = x + rng.normal(size=x.shape) * np.array([1e-3, 1e-2])
    columns = {"t": np.arange(n) / rate, "x1": y[:, 0], "x2": y[:, 1], "u": u}
    pq.write_table(pa.table(columns), path)
    return n


def measure(folder: Path, seconds: float, rate: float) -> dict[str, Any]:
    """One record through the command line, in a process of its own."""
    data, out = folder / "record.parquet", folder / "found"
    rows = write_record(data, seconds, rate)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    case = ROOT / "configs" / "cases" / "pendulum.yaml"
    subprocess.run([sys.executable, "-m", "simgap.cli", "diagnose", case, data, "--out", out], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    found = json.loads((out / "diagnosis.json").read_text())
    values = {f"{e['name']}.{k}": v["value"] for e in found["effects"] for k, v in e["parameters"].items()}
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "seconds": seconds, "hertz": rate, "rows": rows, "verdict": found["verdict"], "found": values,
        "cpu_s": round(cpu, 1), "peak_gib": round(after.ru_maxrss / 2**20, 2),
    }  # fmt: skip


def main() -> None:
    """Measure every length and write the table's numbers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lengths", nargs="*", default=["10@200", "30@200", "360@1000", "3600@1000"])
    rows = []
    for text in parser.parse_args().lengths:
        seconds, rate = (float(v) for v in text.split("@"))
        with tempfile.TemporaryDirectory() as folder:
            rows.append(measure(Path(folder), seconds, rate))
        print(rows[-1], flush=True)
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
