"""Effects of drives and sensors, each hidden alone and beside what resembles it, on several plants.

    python benchmarks/drive_library.py [--kinds torque_speed_limit] [--plants arm] [--seeds 1] [--again]

Records are made in steps of 20 microseconds (tests/undeclared/rig/drives.py), 2 x 12 s at 200 Hz, position alone. Each
row is kept in benchmarks/results/drive_library.json as soon as it is there; the table is drive_library.md beside it.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from drive_kinds import ASIDE, KINDS, ONLY_NAMED, PLACED, UNNAMED, hidden  # noqa: E402
from drive_plants import PLANTS, label, made_on  # noqa: E402
from kept_rows import Rows, asked  # noqa: E402

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.result import Diagnosis  # noqa: E402
from simgap.effects import EFFECTS  # noqa: E402
from tests.undeclared.joints import JOINTS  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "drive_library.json"
Numbers = dict[str, dict[str, float]]


def one(plant: str, kind: str, seed: int, budget: float | None) -> dict[str, Any]:
    """Make one record, diagnose it, score it."""
    told, truth = hidden(plant, kind, seed)
    model, made, settings = made_on(plant, told, seed)
    named = {n for part, n in ASIDE.items() if part in KINDS[kind] and not kind.endswith(UNNAMED)}
    if named:  # what is sought only where it is named, and what it extends
        also = {n for names in named for n in names}
        usual = {n for n, e in EFFECTS.items() if not e.second and n not in ONLY_NAMED}
        settings = replace(settings, effects=tuple(n for n in EFFECTS if n in usual | also))
    begun = time.process_time()
    d = diagnose(model, made, replace(settings, budget_s=budget))
    cpu = time.process_time() - begun
    return {"plant": plant, "kind": kind, "seed": seed, **scored(plant, d, truth), "cpu_s": round(cpu, 1)}


def scored(plant: str, d: Diagnosis, truth: Numbers) -> dict[str, Any]:
    """The answer beside the truth; `equal`: it is another set, which is said to be no other thing to any record."""

    def own(name: str, on: str) -> str:
        return label(plant, name, on)

    answer = {own(e.name, e.on): {n: p.value for n, p in e.parameters.items()} for e in d.effects}
    answer |= {f.fault: {"lag": f.value} for f in d.recording if f.fault == "filtered_reading"}
    sets = [({own(a.name, a.on): dict(a.values) for a in other.effects}, other.exact) for other in d.alternatives]
    exact = set(answer) == set(truth)
    same = [values for values, equal in sets if equal and set(values) == set(truth)]
    told: Numbers = same[0] if same and not exact else answer
    errors = [abs(told[name][n] - v) / abs(v) for name, at in truth.items() if name in told for n, v in at.items()]
    ci = {(own(e.name, e.on), n): p.ci95 for e in d.effects for n, p in e.parameters.items()}
    covered = [bool(ci[name, n][0] <= v <= ci[name, n][1]) for name, numbers in truth.items() if name in answer
               for n, v in numbers.items() if ci.get((name, n)) is not None]  # fmt: skip
    return {
        "verdict": d.verdict, "truth": truth, "answer": answer,
        "right": d.verdict == ("attributed" if set(truth) - {"filtered_reading"} else "none"),
        "exact": exact, "equal": bool(same) and not exact,
        "listed": exact or set(truth) in [set(values) for values, _ in sets],
        "wrong": sorted(set(answer) - set(truth)), "error": max(errors, default=None), "covered": covered,
        "ratio": d.after.held_out_ratio, "chi2_dof": [d.before.chi2_dof, d.after.chi2_dof],
        "alternatives": [sorted(values) for values, _ in sets], "faults": [f.fault for f in d.recording],
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one kind a row."""
    head = ("plants", "records", "exact", "equal", "listed", "right verdict", "wrong attributed", "wrong partial",
            "largest error of an exact answer", "intervals that cover", "CPU s, median")  # fmt: skip
    lines = ["| hidden | " + " | ".join(head) + " |", "|---" * (len(head) + 1) + "|"]
    for kind in KINDS:
        own = [r for r in rows if r["kind"] == kind]
        if not own:
            continue
        covered = [c for r in own if r["exact"] for c in r["covered"]]
        errors = [r["error"] for r in own if (r["exact"] or r.get("equal")) and r["error"] is not None]
        wrong = [r for r in own if not r["listed"] and r["wrong"]]
        cells = (
            ", ".join(p for p in PLANTS if any(r["plant"] == p for r in own)), len(own),
            sum(r["exact"] for r in own), sum(bool(r.get("equal")) for r in own), sum(r["listed"] for r in own),
            sum(r.get("right", r["verdict"] == ("attributed" if r["truth"] else "none")) for r in own),
            sum(r["verdict"] == "attributed" for r in wrong), sum(r["verdict"] == "partial" for r in wrong),
            f"{max(errors):.2g}" if errors else "", f"{sum(covered)} of {len(covered)}" if covered else "",
            f"{float(np.median([r['cpu_s'] for r in own])):.3g}",
        )  # fmt: skip
        lines.append(f"| {kind} | " + " | ".join(str(c) for c in cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make what is asked for and is not there yet."""
    given = asked(__doc__, PLANTS, KINDS, usual=("arm", "motor"))
    rows = Rows(OUT, table, given.again)
    for seed in range(given.first, given.first + given.seeds):
        for kind in given.kinds:
            for plant in PLACED.get(kind, [p for p in given.plants if p in JOINTS]):
                place = {"plant": plant, "kind": kind, "seed": seed}
                rows.make(place, lambda place=place: one(**place, budget=given.budget), unsaid=("covered",))


if __name__ == "__main__":
    main()
