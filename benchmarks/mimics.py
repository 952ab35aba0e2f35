"""What looks like a push and is none, beside friction that is to be found: it must not be `attributed` with a push.

    python benchmarks/mimics.py [--plants dc_motor two_link] [--kinds stop] [--seeds 3] [--again]

A stop, a stiff one, a brake above a speed and a strip that rubs lie where one of two runs goes alone, near its end;
beside them two pushes, one at the start or the end of a run, a long one, and a push with a change in mid-record. They
are made by SciPy (tests/undeclared/rig/textbook.py). Few effects are sought, so that less can stand in for what is
hidden. The table is benchmarks/results/mimics.md.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from kept_rows import Rows, asked, places  # noqa: E402
from other_plants import SIZES  # noqa: E402

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.result import DiagnosisSettings  # noqa: E402
from tests.undeclared.nominals import nominal, record  # noqa: E402
from tests.undeclared.rig.textbook import PLANTS, Hidden, runs  # noqa: E402
from tests.undeclared.scoring import mark  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "mimics.json"
SOUGHT = (
    "viscous_friction", "coulomb_friction", "input_gain", "quadratic_drag", "input_saturation", "spring",
    "parameter_error",
)  # fmt: skip
MIMICS = ("stop", "stiff stop", "brake", "strip that rubs")
PUSHES = ("two pushes", "push at the start", "push at the end", "long push", "push and change")
Force = Callable[[float, float], float]


def mimic(kind: str, size: float, place: np.ndarray, pace: np.ndarray) -> Force:
    """A force (place, speed) -> force that one run alone meets.

    Args:
        kind: of `MIMICS`; size: of a push.
        place, pace: (runs, n) position and speed in runs without it.
    """
    wide, tops, paces = float(np.ptp(place)), sorted(place.max(axis=1)), sorted(np.abs(pace).max(axis=1))
    edge = max(tops[-2], tops[-1] - 0.03 * wide) + 1e-3 * wide
    fast = max(paces[-2], 0.97 * paces[-1]) + 1e-3 * paces[-1]
    slow = 1e-3 * paces[-1]
    return {
        "stop": lambda q, v: -30.0 * size / wide * max(q - edge, 0.0),
        "stiff stop": lambda q, v: -1000.0 * size / wide * max(q - edge, 0.0),
        "brake": lambda q, v: -size * float(np.sign(v)) * (abs(v) > fast),
        "strip that rubs": lambda q, v: -size * float(np.tanh(v / slow)) * (edge < q < edge + 0.01 * wide),
    }[kind]


def hidden(plant: str, kind: str, seed: int) -> Hidden:
    """Viscous friction, and what the kind says."""
    book, (here, b, _, _, _, push) = PLANTS[plant](), SIZES[plant]
    rng = np.random.default_rng([seed, *kind.encode()])
    friction = Hidden(viscous={here: b * float(rng.uniform(0.7, 1.4))})
    if kind in MIMICS:
        quiet = replace(book, measured=book.states, sigma=(0.0,) * len(book.states))
        seen = np.stack([y for _, y, _ in runs(quiet, friction, seed)])
        force = mimic(kind, push, seen[:, :, book.positions[here]], seen[:, :, book.speeds[here]])
        return replace(friction, more={here: force})
    at = float(rng.uniform(1.5, 8.0))
    pushes: dict[str, tuple[tuple[int, float, float, str, float], ...]] = {
        "two pushes": ((0, at, at + 0.1, here, push), (1, 9.5 - at, 9.6 - at, here, -push)),
        "push at the start": ((0, 0.05, 0.15, here, push),),
        "push at the end": ((0, 9.85, 9.95, here, push),),
        "long push": ((0, at, at + 0.4, here, 0.3 * push),),
        "push and change": ((0, at, at + 0.1, here, push),),
    }
    both = replace(friction, pushes=pushes[kind])
    if kind == "push and change":
        return replace(both, after=(1, 5.0), later=Hidden(viscous={here: 2.0 * friction.viscous[here]}))
    return both


def one(plant: str, kind: str, seed: int) -> dict[str, Any]:
    """Make one record, diagnose it, say whether it is too bold."""
    force, key = hidden(plant, kind, seed), ("viscous_friction", SIZES[plant][0])
    made = record(PLANTS[plant](), force, seed)
    begun = time.process_time()
    d = diagnose(nominal(plant), made, DiagnosisSettings(effects=SOUGHT))
    whole = kind not in MIMICS and kind != "push and change"
    values = {f"{key[0]} {key[1]}": {"b": force.viscous[key[1]]}}
    m = mark(d, {"effects": [list(key)], "library": whole, "parameters": values})
    faults = [f.fault for f in d.recording]
    bold = d.verdict == "attributed" and not (m.exact and (whole or "push" not in faults))
    return {
        "plant": plant, "kind": kind, "seed": seed, "verdict": d.verdict, "answer": m.answer, "exact": m.exact,
        "faults": faults, "unconfirmed": list(d.unconfirmed), "bold": bold, "covered": m.covered,
        "ratio": d.after.held_out_ratio, "cpu_s": round(time.process_time() - begun, 1),
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one kind a row."""
    head = (
        "beside friction",
        "records",
        "push reported",
        "attributed",
        "right names, partial",
        "too bold",
        "unexplained",
    )
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for kind in (*MIMICS, *PUSHES):
        own = [r for r in rows if r["kind"] == kind]
        told = [r for r in own if "push" in r["faults"]]
        counts = (
            len(own), len(told), sum(r["verdict"] == "attributed" for r in own),
            sum(r["verdict"] == "partial" and r["exact"] for r in own), sum(r["bold"] for r in own),
            sum(r["verdict"] == "unexplained" for r in own),
        )  # fmt: skip
        lines.append(f"| {kind} | " + " | ".join(map(str, counts)) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make what is asked for and is not there yet."""
    given = asked(__doc__, SIZES, (*MIMICS, *PUSHES), ("oscillator", "dc_motor", "cart_pole", "two_link"))
    rows = Rows(OUT, table, given.again)
    for place in places(given):
        rows.make(place, lambda place=place: one(**place))


if __name__ == "__main__":
    main()
