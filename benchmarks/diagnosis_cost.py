"""What a diagnosis costs as a person runs it: CPU seconds and memory of whole processes, beside the goals.

    python benchmarks/diagnosis_cost.py [--only rod belt] [--again]

Each record is diagnosed by a process of its own: by the command line where it is a case and a recording, else by this
file (`--alone NAME`), whose seconds then leave out the making of the record. A first run, which is not counted, fills
an empty cache of machine code; a row called "cold" is such a first run. Each row is kept in
benchmarks/results/diagnosis_cost.json as soon as it is there.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

from kept_rows import Rows  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "diagnosis_cost.json"
TUTORIAL, PENDULUM = ROOT / "docs" / "tutorial", ROOT / "configs" / "cases" / "pendulum.yaml"
HIDDEN, DELAY, SEED = {"b": 0.08}, 0.004, 41
# record -> goal in CPU seconds, if it has one
GOALS: dict[str, float | None] = {
    "tutorial, cold": 10.0, "tutorial": 4.0,
    "pendulum, dry friction": 7.0, "DC motor, viscous friction": 7.0, "cart-pole, input gain": 7.0,
    "rod, ilqr": 15.0, "rod, sac": 15.0, "rod, direct collocation": 15.0, "rod with payload": 15.0,
    "127,000 readings": 60.0, "two-link arm, viscous friction": 20.0, "belt of two masses at 500 Hz": 25.0,
    "360 s at 1000 Hz": None, "3600 s at 1000 Hz": None,
}  # fmt: skip
PLANTS = {
    "pendulum, dry friction": ("pendulum", "dry friction"),
    "DC motor, viscous friction": ("dc_motor", "viscous friction"),
    "cart-pole, input gain": ("cart_pole", "gain"),
    "two-link arm, viscous friction": ("two_link", "viscous friction"),
}
RODS = {
    "rod, ilqr": "rod ilqr", "rod, sac": "rod sac", "rod, direct collocation": "rod direct_collocation",
    "rod with payload": "rod payload",
}  # fmt: skip
LENGTHS = {"127,000 readings": (2, 63.5), "360 s at 1000 Hz": (1, 360.0), "3600 s at 1000 Hz": (1, 3600.0)}


def write_record(path: Path, seconds: float, rate: float, seed: int) -> None:
    """One trace of the rig of the undeclared effects: viscous friction, inputs 4 ms late, noise on both channels."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    from tests.undeclared.rig import pendulum as rig

    rng = np.random.default_rng(seed)
    n, sample = int(seconds * rate) + 1, round(1.0 / (rate * rig.STEP))
    numbers = {**dict.fromkeys(rig.KEYS, 0.0), **rig.NOMINAL, "gain": 1.0, "limit": np.inf, "v_s": 1.0, **HIDDEN}
    u = np.resize(rig.multisine(rng, int(min(60.0, seconds) * rate), rate), n)
    late = round(DELAY / rig.STEP)
    x = rig.integrate(np.array([numbers[k] for k in rig.KEYS]), u, sample, late, np.zeros(2), rig.STEP)
    y = x + rng.normal(size=x.shape) * np.array([1e-3, 1e-2])
    pq.write_table(pa.table({"t": np.arange(n) / rate, "x1": y[:, 0], "x2": y[:, 1], "u": u}), path)


def alone(name: str) -> None:
    """Diagnose one record of a study in this process, and print what was answered as JSON."""
    import other_plants
    import sentinel

    from simgap.diagnosis.diagnose import diagnose
    from simgap.diagnosis.record.record import Record
    from tests.diagnosis import test_belt_drive as belt

    begun = time.process_time()
    if name in RODS:
        row = sentinel.real_row({"kind": RODS[name]})
        print(json.dumps({"verdict": row["verdict"], "answer": row["answer"]}))
        return
    if name in PLANTS:
        plant, kind = PLANTS[name]
        model, record = other_plants.nominal(plant), other_plants.make(plant, kind, SEED)[0]
    else:
        rng = np.random.default_rng(SEED)
        runs = tuple(belt.belt_run(rng, 6.0, 0.8) for _ in range(2))
        model, record = belt.belt_model(), Record(runs, ("x1", "x2"), ("F",))
    made = time.process_time() - begun
    d = diagnose(model, record)
    print(json.dumps({"verdict": d.verdict, "answer": [[e.name, e.on] for e in d.effects], "made_s": made}))


def command(name: str, folder: Path) -> list[str]:
    """What is run; the recordings are written first."""
    if name in PLANTS or name in RODS or name not in {*LENGTHS, "tutorial", "tutorial, cold"}:
        return [sys.executable, __file__, "--alone", name]
    case, recordings = TUTORIAL / "rod.yaml", [TUTORIAL / "swings.csv"]
    if name in LENGTHS:
        count, seconds = LENGTHS[name]
        case, recordings = PENDULUM, [folder / f"run{k}.parquet" for k in range(count)]
        for k, path in enumerate(recordings):
            write_record(path, seconds, 1000.0, SEED + k)
    return [sys.executable, "-m", "simgap.cli", "diagnose", *map(str, [case, *recordings, "--out", folder / "found"])]


def spent(run: Sequence[str], folder: Path) -> tuple[float, float, str]:
    """CPU seconds and peak GiB of a process, and what it printed last."""
    where = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), "PYTHONPATH": str(ROOT)}
    code = (
        "import json, resource, subprocess, sys\n"
        "out = subprocess.run(sys.argv[1:], check=True, stdout=subprocess.PIPE, text=True).stdout\n"
        "r = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(json.dumps([r.ru_utime + r.ru_stime, r.ru_maxrss / 2**20, (out.splitlines() or [''])[-1]]))"
    )
    out = subprocess.run([sys.executable, "-c", code, *run], check=True, stdout=subprocess.PIPE, text=True, env=where)
    cpu, peak, last = json.loads(out.stdout)
    return cpu, peak, last


def one(name: str) -> dict[str, Any]:
    """Measure one record."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        run = command(name, folder)
        cpu, peak, last = spent(run, folder)
        if not name.endswith("cold"):
            cpu, peak, last = spent(run, folder)
        if "--alone" in run:
            found = json.loads(last)
        else:
            written = json.loads((folder / "found" / "diagnosis.json").read_text())
            found = {"verdict": written["verdict"], "answer": [[e["name"], e["on"]] for e in written["effects"]]}
    seconds = round(cpu - found.pop("made_s", 0.0), 1)
    return {"record": name, **found, "cpu_s": seconds, "peak_gib": round(peak, 2), "goal_s": GOALS[name]}


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown, one record a row, in the order of the list."""
    lines = ["| record | verdict | named | CPU s | goal | met | memory, GiB |", "|---|---|---|---|---|---|---|"]
    for r in sorted(rows, key=lambda r: list(GOALS).index(r["record"])):
        named = ", ".join(f"{n} on {on}" for n, on in r["answer"]) or "-"
        goal = "" if r["goal_s"] is None else f"{r['goal_s']:g}"
        met = "" if r["goal_s"] is None else "yes" if r["cpu_s"] <= r["goal_s"] else "no"
        cells = (r["record"], r["verdict"], named, f"{r['cpu_s']:.3g}", goal, met, f"{r['peak_gib']:g}")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure what is asked for and is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", help="words of which a record's name has one")
    parser.add_argument("--again", action="store_true", help="make again what is there")
    parser.add_argument("--alone", choices=list(GOALS), help="diagnose this one here")
    given = parser.parse_args()
    if given.alone:
        alone(given.alone)
        return
    rows = Rows(OUT, lambda known: table(known) + "\n", given.again)
    for name in GOALS:
        if given.only is None or any(word in name for word in given.only):
            rows.make({"record": name}, lambda name=name: one(name))


if __name__ == "__main__":
    main()
