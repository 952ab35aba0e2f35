"""Records with rests: does the fit do its work where friction sticks?

    python benchmarks/dry_friction.py [--records 20] [--label now]

Seeded records of a drive on a rail (closed form between events) and of a pendulum (fine steps), read by an encoder;
both stick in about half of the time. Each is diagnosed; then the held-out windows are judged at the fitted parameters,
jointly by simgap and one window at a time by SciPy's least squares from seven starts. Rows of another label stay in
benchmarks/results/dry_friction.json, so that two versions can stand side by side.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from simgap.diagnosis import diagnose as whole  # noqa: E402
from simgap.diagnosis.record.record import Record, Trace  # noqa: E402
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings  # noqa: E402
from simgap.diagnosis.simulation.initial import initial_states  # noqa: E402
from simgap.diagnosis.simulation.parts import parts_of  # noqa: E402
from simgap.diagnosis.simulation.problem import Problem  # noqa: E402
from simgap.diagnosis.verdict.held_out import judge  # noqa: E402
from simgap.model.symbolic import SymbolicModel  # noqa: E402
from tests.diagnosis.plants import block, point_pendulum  # noqa: E402
from tests.undeclared.rig import dry_friction as rig  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "dry_friction.json"
SETTINGS = DiagnosisSettings(
    horizon_s=0.2, effects=("coulomb_friction", "viscous_friction", "input_bias", "input_gain"), max_effects=3
)
SECONDS = 10.0


def make(kind: str, seed: int) -> tuple[SymbolicModel, Record, dict[str, float]]:
    """Declared model, record and the hidden numbers."""
    rng = np.random.default_rng([seed, 5])
    friction = float(rng.uniform(0.5, 1.5))
    if kind == "pendulum":
        traces = rig.pendulum_record(0.3 * friction, seed, seconds=SECONDS)
        record = Record(tuple(Trace(f"t{k}", *a) for k, a in enumerate(traces)), ("angle",), ("torque",))
        return point_pendulum(1.0, 0.5, 1.0 / 3.0), record, {"coulomb_friction": 0.3 * friction}
    hidden = {"coulomb_friction": friction}
    if kind == "drive with bias":
        hidden["input_bias"] = float(rng.uniform(0.1, 0.4) * rng.choice([-1.0, 1.0]))
    drive = rig.Drive(friction=friction, bias=hidden.get("input_bias", 0.0))
    traces = rig.drive_record(drive, seed, seconds=SECONDS)
    record = Record(tuple(Trace(f"t{k}", *a) for k, a in enumerate(traces)), ("q",), ("u",))
    return block(2.0), record, hidden


def alone(problem: Problem, theta: np.ndarray) -> float:
    """chi^2 of the windows, each refitted by itself from several starts."""
    guess, total = initial_states(problem), 0.0
    for w in range(len(guess)):
        part = problem.on(problem.windows.pick(np.array([w])))

        def residual(z: np.ndarray, part: Problem = part) -> np.ndarray:
            return part.residuals(theta, z[None, :]).ravel()

        first = int(part.windows.start[0])
        q, v = float(part.y[first : first + 5, 0].mean()), float(guess[w, 1])
        starts = [guess[w], [q, 0.0], [q, 0.3 * v], [q, v + 0.02], [q, v - 0.02], [q, v + 0.2], [q, v - 0.2]]
        ends = [least_squares(residual, s, x_scale=[1e-4, 1e-2], max_nfev=60) for s in starts]
        total += 2.0 * min(float(e.cost) for e in ends)
    return total


def fitted(problem: Problem, d: Diagnosis) -> np.ndarray:
    """The parameters of an answer."""
    theta = problem.model.null.copy()
    for a in d.applied:
        c = problem.model.find(a.name, a.on)
        theta[list(c.slots)] = [a.values[p.symbol] for p in c.effect.parameters]
    return theta


def one(kind: str, seed: int) -> dict[str, Any]:
    """Diagnose one record and judge the windows that confirm in both ways."""
    model, record, hidden = make(kind, seed)
    begun = time.process_time()
    d = whole.diagnose(model, record, SETTINGS)
    cpu = time.process_time() - begun
    held = parts_of(model, record, SETTINGS)[0].confirm
    theta = fitted(held, d)
    states = judge(held, theta, 0.0).states
    found = {e.name: next(iter(e.parameters.values())) for e in d.effects}
    return {
        "kind": kind, "seed": seed, "verdict": d.verdict, "found": {n: p.value for n, p in found.items()},
        "hidden": hidden, "exact": set(found) == set(hidden), "settled": not any("settled" in w for w in d.warnings),
        "covered": [bool(p.ci95[0] <= hidden[n] <= p.ci95[1]) for n, p in found.items() if n in hidden],
        "jointly": float(np.sum(held.residuals(theta, states) ** 2)), "alone": alone(held, theta),
        "ahead_over_floor": max(v / d.floor.horizon_rmse[n] for n, v in d.after.horizon_rmse.items()),
        "cpu_s": round(cpu, 1),
    }  # fmt: skip


def main() -> None:
    """Run the records asked for and write the results after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=20, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="seed of the first record")
    parser.add_argument("--kinds", nargs="*", default=["drive", "drive with bias", "pendulum"])
    parser.add_argument("--label", default="now", help="name of this version in the results")
    asked = parser.parse_args()
    known = json.loads(OUT.read_text()) if OUT.exists() else []
    seeds = range(asked.first, asked.first + asked.records)
    redone = [(asked.label, kind, seed) for kind in asked.kinds for seed in seeds]
    rows = [r for r in known if (r["label"], r["kind"], r["seed"]) not in redone]
    for seed in seeds:
        for kind in asked.kinds:
            rows.append({"label": asked.label, **one(kind, seed)})
            print(rows[-1], flush=True)
            OUT.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
