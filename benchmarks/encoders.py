"""Positions read by encoders: a ball on a beam, a motor and a mass on a spring, with rests, counts fine and coarse.

    python benchmarks/encoders.py [--plants ball] [--steps 10] [--hidden dry both] [--seeds 2] [--again]

Records come from `tests/undeclared/rig/counts.py`, which shares no code with the fit; a step of an encoder is given as
a multiple of the white noise before the rounding. Each row is kept in benchmarks/results/encoders.json as soon as it is
there. A record is 2 x 10 s; seeds take 200, 500 and 100 Hz in turn.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.result import DiagnosisSettings  # noqa: E402
from tests.undeclared.counted import counted_model, counted_record  # noqa: E402
from tests.undeclared.rig.counts import HIDDEN, PLANTS  # noqa: E402
from tests.undeclared.scoring import mark  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "encoders.json"
STEPS = (0.5, 2.0, 5.0, 20.0, 50.0)
RATES = (200.0, 500.0, 100.0)  # Hz, one seed after the other


def one(plant: str, hidden: str, step: float, seed: int) -> dict[str, Any]:
    """Make one record, diagnose it, score it."""
    rate = RATES[seed % len(RATES)]
    made, truth = counted_record(plant, hidden, step * PLANTS[plant].noise, seed, rate=rate)
    begun = time.process_time()
    d = diagnose(counted_model(plant), made, DiagnosisSettings())
    sealed = {
        "effects": [list(k) for k in truth], "library": True,
        "parameters": {f"{name} {on}": values for (name, on), values in truth.items()},
    }  # fmt: skip
    m = mark(d, sealed)
    return {
        "plant": plant, "hidden": hidden, "step": step, "seed": seed, "rate": rate,
        "verdict": d.verdict, "truth": m.truth, "answer": m.answer, "exact": m.exact, "covered": m.covered,
        "errors": m.errors,
        "wrong": [list(a) for a in m.answer if tuple(a) not in truth and not m.exact],
        "faults": [[f.fault, f.value] for f in d.recording],
        "nearest": [[e.name, e.on] for e in d.nearest.effects] if d.nearest else [],
        "reasons": list(d.nearest.reasons) if d.nearest else [],
        "chi2_dof": [d.before.chi2_dof, d.after.chi2_dof], "ratio": d.after.held_out_ratio,
        "sigma_over_step": d.sigma["q"] / (step * PLANTS[plant].noise), "warnings": list(d.warnings),
        "cpu_s": round(time.process_time() - begun, 1),
    }  # fmt: skip


def main() -> None:
    """Make what is asked for and is not there yet; write after each record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="*", default=list(PLANTS), choices=list(PLANTS))
    parser.add_argument("--hidden", nargs="*", default=list(HIDDEN), choices=list(HIDDEN))
    parser.add_argument("--steps", nargs="*", type=float, default=list(STEPS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--again", action="store_true", help="make again what is there")
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args()
    known = json.loads(given.out.read_text()) if given.out.exists() else []
    given.out.parent.mkdir(exist_ok=True)
    key = ("plant", "hidden", "step", "seed")
    for seed in range(given.first, given.first + given.seeds):
        for plant in given.plants:
            for step in given.steps:
                for hidden in given.hidden:
                    there = [r for r in known if [r[k] for k in key] == [plant, hidden, step, seed]]
                    if there and not given.again:
                        continue
                    row = one(plant, hidden, step, seed)
                    known = [r for r in known if r not in there] + [row]
                    print({k: v for k, v in row.items() if k not in ("truth", "errors", "warnings")}, flush=True)
                    given.out.write_text(json.dumps(known, indent=1) + "\n")


if __name__ == "__main__":
    main()
