"""The study of the next experiment: does one proposed recording settle what a first one left open?

    python benchmarks/next_experiment.py [--confusions 20]

A pendulum hides one effect or two, drawn at random, and is recorded in a short small movement, by fine steps that share
no code with the fit. Where the diagnosis cannot tell its answer from others, or is wrong, one more recording is made
twice over: as `simgap.diagnosis.experiment` proposes it, and as a random multisine of the same length within the same
limits. Both are diagnosed together with the first. Settled is a diagnosis whose answer is what was hidden (or moves the
plant exactly as that does) and that lists no other one. Writes benchmarks/results/next_experiment.json and .md.
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
RESULTS = Path(__file__).parent / "results"
sys.path.insert(0, str(ROOT))

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.experiment.ask import Question, ask  # noqa: E402
from simgap.diagnosis.experiment.waves import random_wave  # noqa: E402
from simgap.diagnosis.reading.record import Record, Trace  # noqa: E402
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings  # noqa: E402
from simgap.geometry import Box  # noqa: E402
from tests.undeclared.plant import pendulum  # noqa: E402
from tests.undeclared.rig.pendulum import RATE, Hidden, move, multisine  # noqa: E402

FIRST_SEED, SIGMA, SECONDS, TORQUE = 9000, 1e-3, 4.0, 6.0  # as long as the first recording
EFFECTS = (
    "viscous_friction", "coulomb_friction", "quadratic_drag", "spring", "cubic_spring", "gravity_tilt", "input_gain",
    "input_bias", "parameter_error", "input_dead_zone",
)  # fmt: skip
# name, on -> numbers of the rig for a size between 0 and 1
HIDDEN = {
    ("viscous_friction", "hinge"): lambda s: {"b": 0.02 + 0.15 * s},
    ("coulomb_friction", "hinge"): lambda s: {"F_c": 0.02 + 0.15 * s},
    ("quadratic_drag", "hinge"): lambda s: {"c": 0.02 + 0.1 * s},
    ("spring", "hinge"): lambda s: {"k": 0.2 + 0.8 * s},
    ("gravity_tilt", "plant"): lambda s: {"tilt": 0.01 + 0.05 * s},
    ("input_bias", "torque"): lambda s: {"bias": 0.05 + 0.3 * s},
    ("input_gain", "torque"): lambda s: {"gain": 0.8 + 0.15 * s},
    ("parameter_error", "rod.com"): lambda s: {"com": 0.5 * (1.03 + 0.1 * s)},
}
SETTINGS = DiagnosisSettings(effects=EFFECTS, max_effects=2)
Keys = frozenset[tuple[str, str]]


def first(hidden: Hidden, rng: np.random.Generator) -> Trace:
    """A small short movement: what somebody records who is careful."""
    u = multisine(rng, int(4.0 * RATE) + 1, RATE, top=float(np.exp(rng.uniform(np.log(0.05), np.log(0.4)))))
    return recorded("first", hidden, u, rng)


def recorded(name: str, hidden: Hidden, u: np.ndarray, rng: np.random.Generator) -> Trace:
    """The rig under these commands from rest, its angle with noise."""
    x = move(hidden, u, np.zeros(2))
    y = x[:, :1] + hidden.offset + SIGMA * rng.standard_normal((len(u), 1))
    return Trace(name, np.arange(len(u)) / RATE, y, u[:, None])


def settled(found: Diagnosis, truth: Keys) -> bool:
    """Whether the answer is what was hidden, up to exact equals, and nothing else is listed."""
    answer = frozenset((e.name, e.on) for e in found.effects)
    sets = [(frozenset((e.name, e.on) for e in a.effects), a.exact) for a in found.alternatives]
    equal = truth == answer or any(keys == truth and exact for keys, exact in sets)
    return equal and all(exact for _, exact in sets)


def open_sets(found: Diagnosis) -> tuple[Any, ...]:
    """The answer and what cannot be told from it, exact equals aside: no recording tells these."""
    return (found.applied, *(a.effects for a in found.alternatives if not a.exact))[:4]


def one(seed: int) -> dict[str, Any] | None:
    """One confusion, opened twice; None where the first recording leaves nothing open."""
    rng = np.random.default_rng(seed)
    picked = rng.choice(len(HIDDEN), size=int(rng.integers(1, 3)), replace=False)
    keys = [list(HIDDEN)[k] for k in picked]
    numbers: dict[str, float] = {}
    for key in keys:
        numbers |= HIDDEN[key](float(rng.uniform()))
    hidden, truth = Hidden(rig=numbers), frozenset(keys)
    trace = first(hidden, rng)
    model, record = pendulum(), Record((trace,), ("angle",), ("torque",))
    before = diagnose(model, record, SETTINGS)
    if not before.effects or settled(before, truth) or len(open_sets(before)) < 2:
        return None
    t = np.arange(int(SECONDS * RATE) + 1) / RATE
    question = Question(
        model, record, SETTINGS, dict(before.sigma), open_sets(before), t, np.zeros(2), Box([-6.0, -20.0], [6.0, 20.0]),
        np.zeros(1), np.full(1, TORQUE),
    )  # fmt: skip
    begun = time.process_time()
    advice = ask(question, np.random.default_rng(1))
    cpu = time.process_time() - begun
    best = advice.proposal.best
    row: dict[str, Any] = {
        "seed": seed, "hidden": sorted(map(list, truth)), "open": [r.label for r in advice.known.rivals],
        "right_among_them": any(truth == frozenset((a.name, a.on) for a in s) for s in question.sets),
        "probability": advice.proposal.sure, "cpu_s": cpu,
    }  # fmt: skip
    wave = random_wave(t, 1, rng)
    tries = {"proposed": None if best is None else best.u[:, 0], "random": TORQUE * wave.u[:, 0]}
    for name, u in tries.items():
        if u is None:
            row[name] = False
            continue
        more = recorded(name, hidden, u, np.random.default_rng([seed, 7]))
        after = diagnose(model, Record((trace, more), ("angle",), ("torque",)), SETTINGS)
        row[name] = settled(after, truth)
        row[f"{name}_answer"] = [sorted([e.name, e.on] for e in after.effects), len(after.alternatives)]
    return row


def main() -> None:
    """Make confusions until there are as many as asked for, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--confusions", type=int, default=20)
    parser.add_argument("--cpu-s", type=float, default=600.0, help="CPU seconds after which no further one is begun")
    arguments = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    rows: list[dict[str, Any]] = []
    seed = FIRST_SEED
    while len(rows) < arguments.confusions and time.process_time() < arguments.cpu_s:
        row = one(seed)
        seed += 1
        if row is not None:
            rows.append(row)
            print(json.dumps(row), flush=True)
            (RESULTS / "next_experiment.json").write_text(
                json.dumps({"tried": seed - FIRST_SEED, "rows": rows}, indent=1)
            )
            (RESULTS / "next_experiment.md").write_text(table(rows, seed - FIRST_SEED))


def table(rows: list[dict[str, Any]], tried: int) -> str:
    """Markdown."""
    among = [r for r in rows if r["right_among_them"]]
    heads = (
        "records", "that left something open", "settled by the proposed recording", "by a random one",
        "the right set was among those left open", "settled by the proposed one", "by a random one", "CPU s, median",
    )  # fmt: skip
    lines = [
        "| " + " | ".join(heads) + " |",
        "|---" * len(heads) + "|",
        f"| {tried} | {len(rows)} | {sum(r['proposed'] for r in rows)} | {sum(r['random'] for r in rows)} | "
        f"{len(among)} | {sum(r['proposed'] for r in among)} | {sum(r['random'] for r in among)} | "
        f"{np.median([r['cpu_s'] for r in rows]):.1f} |",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
