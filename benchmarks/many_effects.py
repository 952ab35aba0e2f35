"""Three, four and five things missing at once, delay or lag and dry friction with rests among them, read by encoders.

    python benchmarks/many_effects.py [--plants stage ball] [--hidden dry+gain+delay] [--seeds 1] [--again]

Records of 20 s come from `tests/undeclared/rig/many.py`, which shares no code with the fit: a belt stage, a motor, a
mass on a spring, a ball on a beam and a cart with a pole, under feedback. Nothing, one and two hidden things tell
whether the search for many names too many. Each row is kept in benchmarks/results/many_effects.json as soon as it is
there; the table is benchmarks/results/many_effects.md.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.result import DiagnosisSettings  # noqa: E402
from tests.undeclared.many import many_model, many_record  # noqa: E402
from tests.undeclared.rig.many import PLANTS  # noqa: E402
from tests.undeclared.scoring import mark  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "many_effects.json"
HIDDEN = (
    "", "dry", "delay", "dry+viscous", "gain+lag", "dry+viscous+delay", "dry+gain+lag", "viscous+gain+delay",
    "dry+viscous+gain+delay", "dry+viscous+gain+lag", "dry+gain+bias+delay", "dry+viscous+gain+bias+delay",
    "dry+viscous+gain+bias+lag",
)  # fmt: skip


def one(plant: str, hidden: str, seed: int) -> dict[str, Any]:
    """Make one record, diagnose it, score it."""
    model = many_model(plant)
    made, truth = many_record(plant, tuple(h for h in hidden.split("+") if h), seed)
    diagnose(model, made, DiagnosisSettings(max_effects=1))  # what compiles at its first use is not counted
    begun = time.process_time()
    d = diagnose(model, made, DiagnosisSettings())
    cpu = time.process_time() - begun
    sealed = {
        "effects": [list(k) for k in truth], "library": True,
        "parameters": {f"{name} {on}": values for (name, on), values in truth.items()},
    }  # fmt: skip
    m = mark(d, sealed)
    return {
        "plant": plant, "hidden": hidden, "seed": seed, "count": len(truth), "verdict": d.verdict, "truth": m.truth,
        "answer": m.answer, "exact": m.exact, "listed": m.listed, "covered": m.covered, "errors": m.errors,
        "listed_errors": m.listed_errors,
        "wrong": [list(a) for a in m.answer if tuple(a) not in truth and not m.exact],
        "faults": [f.fault for f in d.recording], "chi2_dof": [d.before.chi2_dof, d.after.chi2_dof],
        "ratio": d.after.held_out_ratio, "excess_share": d.excess_share,
        "nearest": [[e.name, e.on] for e in d.nearest.effects] if d.nearest else [], "warnings": list(d.warnings),
        "cpu_s": round(cpu, 1),
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one number of hidden effects a row."""
    head = ("hidden", "records", "right verdict", "right set", "listed", "wrong attributed", "wrong partial",
            "intervals that cover", "CPU s, median", "CPU s, most")  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for count in sorted({r["count"] for r in rows}):
        own = [r for r in rows if r["count"] == count]
        covered = [c for r in own for c in r["covered"]]
        wrong = {v: sum(r["verdict"] == v and bool(r["wrong"]) for r in own) for v in ("attributed", "partial")}
        cells = (
            count or "nothing", len(own), sum(r["verdict"] == ("attributed" if count else "none") for r in own),
            sum(r["exact"] for r in own), sum(r["listed"] for r in own), wrong["attributed"], wrong["partial"],
            f"{sum(covered)} of {len(covered)}" if covered else "",
            f"{float(np.median([r['cpu_s'] for r in own])):.3g}", f"{max(r['cpu_s'] for r in own):.3g}",
        )  # fmt: skip
        lines.append("| " + " | ".join(str(c) for c in cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make what is asked for and is not there yet; write after each record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="*", default=list(PLANTS), choices=list(PLANTS))
    parser.add_argument("--hidden", nargs="*", default=list(HIDDEN))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--again", action="store_true", help="make again what is there")
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args()
    known = json.loads(given.out.read_text()) if given.out.exists() else []
    given.out.parent.mkdir(exist_ok=True)
    key = ("plant", "hidden", "seed")
    for seed in range(given.first, given.first + given.seeds):
        for plant in given.plants:
            for hidden in given.hidden:
                there = [r for r in known if [r[k] for k in key] == [plant, hidden, seed]]
                if there and not given.again:
                    continue
                row = one(plant, hidden, seed)
                known = [r for r in known if r not in there] + [row]
                print({k: row[k] for k in row if k not in ("truth", "warnings", "errors", "listed_errors")}, flush=True)
                given.out.write_text(json.dumps(known, indent=1) + "\n")
                given.out.with_suffix(".md").write_text(table(known))


if __name__ == "__main__":
    main()
