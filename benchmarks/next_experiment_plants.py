"""The study of the next experiment on other plants than the pendulum of `next_experiment.py`.

    python benchmarks/next_experiment_plants.py [--plants dc_motor oscillator cart_pole two_link] [--cpu-s 180]

The plants are those of tests/undeclared/rig/textbook.py, moved by SciPy from their equations of motion. Each hides one
effect or two, drawn at random, in a recording of 4 s with small inputs; where that leaves something open one more of
4 s is made as proposed, and one with a random multisine of up to the same inputs. What counts is as in
`next_experiment.py`. Each plant's rows are kept in benchmarks/results/next_experiment_plants.json when they are there.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

from next_experiment import open_sets, settled  # noqa: E402

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.experiment.ask import Question, ask  # noqa: E402
from simgap.diagnosis.experiment.waves import random_wave  # noqa: E402
from simgap.diagnosis.reading.record import Record, Trace  # noqa: E402
from simgap.diagnosis.result import DiagnosisSettings  # noqa: E402
from simgap.geometry import Box  # noqa: E402
from tests.undeclared.nominals import nominal  # noqa: E402
from tests.undeclared.rig.textbook import PLANTS, Hidden, Textbook, _moved  # noqa: E402

FIRST_SEED, SECONDS = 7000, 4.0
EFFECTS = ("viscous_friction", "coulomb_friction", "quadratic_drag", "spring", "input_gain", "input_bias",
           "parameter_error")  # fmt: skip
Key = tuple[str, str]
Size = Callable[[float], dict[str, dict[str, float]]]


@dataclass(frozen=True)
class Study:
    """Largest inputs, largest states, and what may be hidden, with a size between 0 and 1."""

    top: tuple[float, ...]
    reach: tuple[float, ...]
    hidden: dict[Key, Size]


def _force(name: str, kind: str, on: str, low: float, high: float) -> dict[Key, Size]:
    return {(name, on): lambda s: {kind: {on: low + (high - low) * s}}}


def _off(kind: str, name: str, on: str) -> dict[Key, Size]:
    return {(name, on): lambda s: {kind: {on: 0.8 + 0.15 * s}}}


STUDIES = {
    "dc_motor": Study((6.0,), (500.0, 300.0, 20.0), {
        **_force("viscous_friction", "viscous", "shaft", 1e-4, 6e-4),
        **_force("coulomb_friction", "coulomb", "shaft", 3e-3, 1.5e-2),
        **_force("input_bias", "bias", "V", 0.05, 0.3), **_off("gain", "input_gain", "V"),
        **_off("factors", "parameter_error", "J"),
    }),
    "oscillator": Study((6.0,), (3.0, 20.0), {
        **_force("viscous_friction", "viscous", "slide", 0.05, 0.4),
        **_force("coulomb_friction", "coulomb", "slide", 0.05, 0.3),
        **_force("input_bias", "bias", "u", 0.05, 0.3), **_off("gain", "input_gain", "u"),
        **_off("factors", "parameter_error", "m"), **_off("factors", "parameter_error", "k"),
    }),
    "cart_pole": Study((4.0,), (5.0, 10.0, 10.0, 30.0), {
        **_force("viscous_friction", "viscous", "cart", 0.1, 0.8),
        **_force("viscous_friction", "viscous", "pole", 3e-3, 3e-2),
        **_force("coulomb_friction", "coulomb", "cart", 0.05, 0.4),
        **_force("input_bias", "bias", "u", 0.05, 0.3), **_off("gain", "input_gain", "u"),
    }),
    "two_link": Study((6.0, 2.0), (10.0, 10.0, 40.0, 40.0), {
        **_force("viscous_friction", "viscous", "shoulder", 0.05, 0.3),
        **_force("viscous_friction", "viscous", "elbow", 0.02, 0.1),
        **_force("coulomb_friction", "coulomb", "shoulder", 0.05, 0.3),
        **_force("input_bias", "bias", "u2", 0.02, 0.1), **_off("gain", "input_gain", "u1"),
    }),
}  # fmt: skip


def recorded(book: Textbook, name: str, hidden: Hidden, u: np.ndarray, rng: np.random.Generator) -> Trace:
    """The plant under these inputs (n, m) from rest, its readings with noise."""
    t = np.arange(len(u)) / book.rate
    x, acted = _moved(book, hidden, 0, t, np.zeros(len(book.states)), u)
    read = [book.states.index(n) for n in book.measured]
    return Trace(name, t, x[:, read] + np.asarray(book.sigma) * rng.standard_normal((len(t), len(read))), acted)


def one(plant: str, seed: int) -> dict[str, Any] | None:
    """One confusion, opened twice; None where the first recording leaves nothing open."""
    book, study, model = PLANTS[plant](), STUDIES[plant], nominal(plant)
    rng = np.random.default_rng([seed, *plant.encode()])
    picked = [list(study.hidden)[k] for k in rng.choice(len(study.hidden), size=int(rng.integers(1, 3)), replace=False)]
    told: dict[str, dict[str, float]] = {}
    for key in picked:
        for kind, numbers in study.hidden[key](float(rng.uniform())).items():
            told[kind] = told.get(kind, {}) | numbers
    hidden, truth, top = Hidden(**told), frozenset(picked), np.array(study.top)
    t = np.arange(round(SECONDS * book.rate) + 1) / book.rate
    small = float(np.exp(rng.uniform(np.log(0.02), np.log(0.15))))
    trace = recorded(book, "first", hidden, small * top * random_wave(t, len(top), rng).u, rng)
    settings = DiagnosisSettings(effects=EFFECTS, max_effects=2, budget_s=60.0)
    before = diagnose(model, Record((trace,), book.measured, book.inputs), settings)
    if not before.effects or settled(before, truth) or len(open_sets(before)) < 2:
        return None
    reach = np.array(study.reach)
    question = Question(
        model, Record((trace,), book.measured, book.inputs), settings, dict(before.sigma), open_sets(before), t,
        np.zeros(len(book.states)), Box(-reach, reach), np.zeros(len(top)), top,
    )  # fmt: skip
    begun = time.process_time()
    advice = ask(question, np.random.default_rng(1))
    row: dict[str, Any] = {
        "plant": plant, "seed": seed, "hidden": sorted(map(list, truth)),
        "open": [r.label for r in advice.known.rivals], "probability": advice.proposal.sure,
        "cpu_s": time.process_time() - begun,
    }  # fmt: skip
    best = advice.proposal.best
    waves = {"proposed": None if best is None else best.u, "random": top * random_wave(t, len(top), rng).u}
    for name, u in waves.items():
        row[name] = False
        if u is not None:
            more = recorded(book, name, hidden, u, np.random.default_rng([seed, 7]))
            after = diagnose(model, Record((trace, more), book.measured, book.inputs), settings)
            row[name] = settled(after, truth)
            row[f"{name}_answer"] = [sorted([e.name, e.on] for e in after.effects), len(after.alternatives)]
    return row


def table(plants: dict[str, Any]) -> str:
    """Markdown, one plant a row."""
    heads = (
        "plant", "records", "that left something open", "settled by the proposed recording", "by a random one",
        "sure of 90 % and more", "of these settled", "CPU s, median",
    )  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for plant, made in plants.items():
        rows = made["rows"]
        sure = [r for r in rows if r["probability"] >= 0.9]
        spent = f"{np.median([r['cpu_s'] for r in rows]):.1f}" if rows else ""
        lines.append(
            f"| {plant} | {made['tried']} | {len(rows)} | {sum(r['proposed'] for r in rows)} | "
            f"{sum(r['random'] for r in rows)} | {len(sure)} | {sum(r['proposed'] for r in sure)} | {spent} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make confusions on each plant until its time is spent, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="*", default=list(STUDIES), choices=list(STUDIES))
    parser.add_argument("--cpu-s", type=float, default=180.0, help="CPU seconds a plant, after which no more is begun")
    arguments = parser.parse_args()
    path = RESULTS / "next_experiment_plants.json"
    for plant in arguments.plants:
        begun, rows, tried = time.process_time(), list[dict[str, Any]](), 0
        while time.process_time() - begun < arguments.cpu_s:
            row = one(plant, FIRST_SEED + tried)
            tried += 1
            if row is not None:
                rows.append(row)
                print(json.dumps(row), flush=True)
            known = json.loads(path.read_text()) if path.is_file() else {}
            known[plant] = {"tried": tried, "rows": rows}
            path.write_text(json.dumps(known, indent=1) + "\n")
            path.with_suffix(".md").write_text(table(known))
        print(f"{plant}: {tried} records, {len(rows)} left something open", flush=True)


if __name__ == "__main__":
    main()
