"""The study of the next experiment: does one proposed recording settle what a first one left open?

    python benchmarks/next_experiment.py [--plants pendulum oscillator ...] [--confusions 20]

Plants that hide one effect or two are recorded for 4 s in a small movement (`next_experiment_plants.py`). Where the
diagnosis cannot tell its answer from others, or is wrong, one more recording is made three times over: as
`simgap.extras.experiment` proposes it, of the length that it chose itself; with a random multisine of full size of
the same length; with the same kind of multisine as long as the first recording. Each is diagnosed together with the
first. Settled is a diagnosis whose answer is what was hidden (or moves the plant exactly as that does) and that lists
no other one. Of each plant records are made until there are so many confusions, whatever comes of them. Writes
benchmarks/results/next_experiment/PLANT.json, and next_experiment.md of all that are there (`--plants` alone: no more).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

RESULTS = Path(__file__).parent / "results"
sys.path[:0] = [str(Path(__file__).parent)]

from next_experiment_plants import STUDIES, Confusion, confusion, random_wave  # noqa: E402

from simgap.extras.experiment.ask import ask  # noqa: E402

FIRST_SEED = 40_000
"""Rules were set on records from seeds 7000 and 20000 on."""
PLANTS = ["pendulum", *STUDIES]
KINDS = ("proposed", "random", "random_long")


def opened(c: Confusion) -> dict[str, Any]:
    """One confusion, opened three times."""
    begun = time.process_time()
    advice = ask(c.question, np.random.default_rng(1))
    cpu = time.process_time() - begun
    best, t = advice.proposal.best, advice.proposal.bench.t
    row: dict[str, Any] = {
        "plant": c.plant, "seed": c.seed, "hidden": sorted(map(list, c.truth)),
        "open": [r.label for r in advice.known.rivals],
        "right_among_them": any(c.truth == frozenset((a.name, a.on) for a in s) for s in c.question.sets),
        "seconds": float(t[-1]), "probability": advice.proposal.sure,
        "shown": advice.proposal.shown,
        "probability_longest": (advice.longest or advice.proposal).sure, "cpu_s": cpu,
    }  # fmt: skip
    waves = {"proposed": None if best is None else best.u}
    for name, stamps in (("random", t), ("random_long", c.question.t)):
        wave = random_wave(stamps, len(c.question.middle), np.random.default_rng([c.seed, 11])).u
        waves[name] = c.question.middle + c.question.reach * wave / np.abs(wave).max(axis=0)
    for name, u in waves.items():
        row[name] = False
        if u is not None:
            after = c.diagnosed(c.play(name, u))
            row[name] = c.settled(after)
            row[f"{name}_answer"] = [sorted([e.name, e.on] for e in after.effects), len(after.alternatives)]
    return row


def table(made: dict[str, Any]) -> str:
    """Markdown: a plant a row, then what was told before against what came of it."""
    heads = (
        "plant", "records", "that left something open", "length chosen, median", "settled by the proposed recording",
        "by a random one as long", "by a random one of 4 s", "CPU s, median",
    )  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    rows = [r for m in made.values() for r in m["rows"]]
    for name, tried, of in (
        *((p, m["tried"], m["rows"]) for p, m in made.items()),
        ("all", sum(m["tried"] for m in made.values()), rows),
    ):
        if of:
            counts = " | ".join(str(sum(r[k] for r in of)) for k in KINDS)
            seconds, cpu = (float(np.median([r[k] for r in of])) for k in ("seconds", "cpu_s"))
            lines.append(f"| {name} | {tried} | {len(of)} | {seconds:.3g} s | {counts} | {cpu:.1f} |")
    heads = (
        "what was hidden", "confusions", "told", "settled by the proposed recording", "by a random one as long",
        "by a random one of 4 s",
    )  # fmt: skip
    lines += ["", "| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    kinds: tuple[tuple[str, Callable[[dict[str, Any]], bool]], ...] = (
        ("it was among what was left open", lambda r: r["right_among_them"]),
        ("it was not", lambda r: not r["right_among_them"]),
        ("dry friction, alone or beside something", _dry),
        ("no dry friction", lambda r: not _dry(r)),
    )
    for word, wanted in kinds:
        of = [r for r in rows if wanted(r)]
        if of:
            told = 100 * float(np.mean([r["probability" if r["right_among_them"] else "shown"] for r in of]))
            counts = " | ".join(str(sum(r[k] for r in of)) for k in KINDS)
            lines.append(f"| {word} | {len(of)} | {told:.1f} % | {counts} |")
    return "\n".join(lines) + "\n"


def _dry(row: dict[str, Any]) -> bool:
    return any(name == "coulomb_friction" for name, _ in row["hidden"])


def main() -> None:
    """Make confusions on each plant until there are as many as asked for, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="*", default=PLANTS, choices=PLANTS)
    parser.add_argument("--confusions", type=int, default=20, help="of each plant")
    parser.add_argument("--cpu-s", type=float, default=900.0, help="CPU seconds a plant, after which no more is begun")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    arguments = parser.parse_args()
    (RESULTS / "next_experiment").mkdir(parents=True, exist_ok=True)
    for plant in arguments.plants:
        begun, rows, tried = time.process_time(), list[dict[str, Any]](), 0
        while len(rows) < arguments.confusions and time.process_time() - begun < arguments.cpu_s:
            made = confusion(plant, arguments.first_seed + tried)
            tried += 1
            if made is not None:
                rows.append(opened(made))
                print(json.dumps(rows[-1]), flush=True)
                _write(plant, {"tried": tried, "rows": rows})
        print(f"{plant}: {tried} records, {len(rows)} left something open", flush=True)
    _write_table()


def _write(plant: str, made: dict[str, Any]) -> None:
    folder = RESULTS / "next_experiment"
    (folder / f"{plant}.json").write_text(json.dumps(made, indent=1) + "\n")
    _write_table()


def _write_table() -> None:
    folder = RESULTS / "next_experiment"
    there = {p: json.loads(f.read_text()) for p in PLANTS if (f := folder / f"{p}.json").is_file()}
    (RESULTS / "next_experiment.md").write_text(table(there))


if __name__ == "__main__":
    main()
