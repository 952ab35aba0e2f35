"""Faults of a recording, with and without a missing effect, on two plants that share no code with the fit.

    python benchmarks/recording_faults.py [--seeds 1] [--seconds 6] [--faults hum stale]

Each row is kept in benchmarks/results/recording_faults.json. A right answer names the fault that was put in and no
other, and viscous friction where it is missing and nothing where it is not.
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
from tests.diagnosis import rigs  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "recording_faults.json"
VISCOUS = 0.3
EFFECTS = (
    "viscous_friction",
    "coulomb_friction",
    "quadratic_drag",
    "spring",
    "input_gain",
    "input_bias",
    "input_delay",
)
SETTINGS = DiagnosisSettings(effects=EFFECTS)


def one(rig: rigs.Rig, fault: str, seed: int, seconds: float, missing: bool) -> dict[str, Any]:
    """Diagnose one record."""
    hidden = {"viscous": VISCOUS} if missing else {}
    begun = time.process_time()
    d = diagnose(rig.model, rigs.record(rig, fault, seed, seconds, **hidden), SETTINGS)
    friction = [e.parameters["b"] for e in d.effects if e.name == "viscous_friction"]
    return {
        "plant": rig.name, "fault": fault, "seed": seed, "missing": missing, "verdict": d.verdict,
        "effects": [e.name for e in d.effects], "found": [f.fault for f in d.recording],
        "sizes": [f.value for f in d.recording],
        "covered": [bool(p.ci95[0] <= VISCOUS <= p.ci95[1]) for p in friction] if missing else [],
        "cpu_s": round(time.process_time() - begun, 1),
    }  # fmt: skip


def main() -> None:
    """Run what is asked for and write after each record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--faults", nargs="*", default=list(rigs.FAULTS))
    asked = parser.parse_args()
    known = json.loads(OUT.read_text()) if OUT.exists() else []
    for seed in range(asked.first, asked.first + asked.seeds):
        for fault in asked.faults:
            for rig in (rigs.pendulum(), rigs.oscillator()):
                for missing in (False, True):
                    row = one(rig, fault, seed, asked.seconds, missing)
                    key = ("plant", "fault", "seed", "missing")
                    known = [r for r in known if [r[k] for k in key] != [row[k] for k in key]] + [row]
                    print(row, flush=True)
                    OUT.write_text(json.dumps(known, indent=1) + "\n")


if __name__ == "__main__":
    main()
