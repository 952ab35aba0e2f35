"""The study of undeclared effects: rigs with hidden effects, diagnosed blind, scored against what was sealed.

    python benchmarks/undeclared.py --records 100 --workers 2

writes benchmarks/results/undeclared.json (every record) and benchmarks/results/undeclared.md (the table). A record is
30 s at 200 Hz, in two traces; sizes, signs and excitation are drawn at random. Seeds are consecutive and no study has
those of another: records that share their noise would miss together. `--only` makes some studies anew and keeps what
the others found.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"
FIRST_SEED, SEEDS = 100_000, 1_000  # of the first study, and for each
# study -> kind, sigma of the angle in rad, velocity measured, share of --records
STUDIES: dict[str, tuple[str, float, bool, float]] = {
    "one effect": ("one", 1e-3, False, 1.0),
    "two effects": ("two", 1e-3, False, 0.6),
    "three effects": ("three", 1e-3, False, 0.2),
    "no effect": ("none", 1e-3, False, 1.0),
    "one effect, velocity measured": ("one", 1e-3, True, 0.3),
    "one effect, sigma 1e-2": ("one", 1e-2, False, 0.5),
    "no effect, sigma 1e-2": ("none", 1e-2, False, 0.3),
    "outside: Dahl friction": ("dahl", 1e-3, False, 0.1),
    "outside: periodic force": ("sine", 1e-3, False, 0.1),
    "outside: backlash": ("backlash", 1e-3, False, 0.1),
    "saturation": ("input_saturation", 1e-3, False, 0.2),
    "centre of mass": ("com", 1e-3, False, 0.2),
    "inertia": ("inertia", 1e-3, False, 0.2),
    "delay between samples": ("fractional_delay", 1e-3, False, 0.2),
    "one effect, in MuJoCo": ("mujoco", 1e-3, False, 0.2),
    "act as one: gain, mass": ("gain, mass", 1e-3, False, 0.1),
    "act as one: tilt, offset": ("tilt, offset", 1e-3, False, 0.1),
    "alike: small Stribeck peak": ("faint peak", 1e-3, False, 0.2),
    **{
        f"alike: {pair}": (pair, 1e-3, False, 0.1)
        for pair in (
            "delay, lag", "spring, tilt", "spring, centre of mass", "spring, cubic spring", "bias, tilt",
            "gain, inertia", "gain, saturation", "dead zone, Coulomb", "viscous, drag",
        )
    },
    "two effects, whole range": ("wide two", 1e-3, False, 0.3),
}  # fmt: skip


def one(job: tuple[str, str, int, float, bool]) -> dict[str, Any]:
    """Make one record, diagnose it, open the seal."""
    sys.path.insert(0, str(ROOT))
    from tests.undeclared.plant import pendulum
    from tests.undeclared.rig.seal import produce
    from tests.undeclared.scoring import examine

    study, kind, seed, sigma, velocity = job
    with tempfile.TemporaryDirectory() as folder:
        produce(Path(folder), kind, seed, sigma, velocity)
        begun = time.process_time()
        _, mark = examine(Path(folder), pendulum(), velocity)
        return {"study": study, "seed": seed, "cpu_s": time.process_time() - begun, **asdict(mark)}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of one study."""
    errors = [e for r in rows for k, e in r["errors"].items() if not k.endswith(".delay")]
    delays = [e for r in rows for k, e in r["errors"].items() if k.endswith(".delay")]
    beside = [e for r in rows for e in r["listed_errors"].values()]
    covered = [c for r in rows for c in r["covered"]]
    return {
        "records": len(rows),
        "exact": sum(r["exact"] for r in rows),
        "listed": sum(r["listed"] for r in rows),
        "one right": sum(r["hits"] >= 1 for r in rows),
        "two right": sum(r["hits"] >= 2 for r in rows),
        "attributed": sum(r["verdict"] == "attributed" for r in rows),
        "with effects": sum(bool(r["answer"]) for r in rows),
        "error median": float(np.median(errors)) if errors else None,
        "delay error median": float(np.median(delays)) if delays else None,
        "error median where an equal is the answer": float(np.median(beside)) if beside else None,
        "intervals that cover": float(np.mean(covered)) if covered else None,
        "held-out over floor, median": float(np.median([r["held_out_ratio"] for r in rows])),
        "CPU s, median": float(np.median([r["cpu_s"] for r in rows])),
    }


def table(figures: dict[str, dict[str, Any]]) -> str:
    """Markdown, one study a row."""
    columns = list(max(figures.values(), key=len))

    def cell(value: float | int | None) -> str:
        return "" if value is None else str(value) if isinstance(value, int) else f"{value:.3g}"

    lines = ["| study | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(cell(row.get(c)) for c in columns) + " |" for name, row in figures.items()]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the studies asked for and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=100, help="records with one effect; other studies follow")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=list(STUDIES), choices=list(STUDIES), help="studies to run")
    arguments = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        for study in arguments.only:
            kind, sigma, velocity, share = STUDIES[study]
            count, first = max(1, round(arguments.records * share)), FIRST_SEED + SEEDS * list(STUDIES).index(study)
            rows = []
            for row in pool.map(one, [(study, kind, first + k, sigma, velocity) for k in range(count)]):
                rows.append(row)
                print(f"{study} seed {row['seed']}: {row['verdict']} {row['answer']}", flush=True)
            keep(study, rows)  # after each study: a long run may end


def keep(study: str, rows: list[dict[str, Any]]) -> None:
    """Put one study among the results, in the place of what it found before."""
    path = RESULTS / "undeclared.json"
    known = json.loads(path.read_text()) if path.is_file() else {"figures": {}, "records": []}
    made = known["figures"] | {study: summary(rows)}
    figures = {name: made[name] for name in STUDIES if name in made}
    records = [r for r in known["records"] if r["study"] != study] + rows
    path.write_text(json.dumps({"figures": figures, "records": records}, indent=1) + "\n")
    (RESULTS / "undeclared.md").write_text(table(figures))


if __name__ == "__main__":
    main()
