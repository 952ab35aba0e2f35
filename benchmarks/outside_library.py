"""What no effect of the library is, hidden in four plants, alone and beside a gain: is a wrong name ever sure?

    python benchmarks/outside_library.py [--plants oscillator] [--kinds absorber] [--seeds 1] [--first 0] [--again]

Sixteen mechanisms of `tests/undeclared/rig/strange.py` (SciPy; nothing shared with the fit), 2 x 10 s each. Two of them
are a force of the place alone, which the library holds as a curve since: the last row leaves them out. `attributed`
with a name that was not hidden is wrong, and so is `none`. Each row is kept in benchmarks/results/outside_library.json
as soon as it is there; the table is benchmarks/results/outside_library.md.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from kept_rows import Rows, asked, places  # noqa: E402

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.record.record import Record, Trace  # noqa: E402
from simgap.diagnosis.result import DiagnosisSettings  # noqa: E402
from tests.undeclared.nominals import nominal  # noqa: E402
from tests.undeclared.rig.strange import MECHANISMS, strange_runs  # noqa: E402
from tests.undeclared.rig.textbook import PLANTS  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "outside_library.json"
HERE = ("oscillator", "pendulum", "dc_motor", "cart_pole")
VERDICTS = ("unexplained", "partial", "none", "attributed")
GAIN = 0.88
OF_THE_PLACE = ("soft stop", "square spring")


def one(plant: str, kind: str, beside: bool, seed: int, budget: float | None) -> dict[str, Any]:
    """Make one record, diagnose it."""
    book = PLANTS[plant]()
    made = strange_runs(book, kind, seed, GAIN if beside else 1.0)
    traces = tuple(Trace(f"run{k + 1}", t, np.ascontiguousarray(y), u) for k, (t, y, u) in enumerate(made))
    begun = time.process_time()
    d = diagnose(nominal(plant), Record(traces, book.measured, book.inputs), DiagnosisSettings(budget_s=budget))
    answer = [[e.name, e.on] for e in d.effects]
    truth = [["input_gain", book.inputs[0]]] if beside else []
    if kind in OF_THE_PLACE:
        truth += [a for a in answer if a[0] == "force_curve"]
    return {
        "plant": plant, "kind": kind, "beside": beside, "seed": seed, "verdict": d.verdict, "answer": answer,
        "other": [a for a in answer if a not in truth], "faults": [f.fault for f in d.recording],
        "chi2_dof": [d.before.chi2_dof, d.after.chi2_dof], "ratio": d.after.held_out_ratio,
        "cpu_s": round(time.process_time() - begun, 1),
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one mechanism a row."""
    head = ("records", *VERDICTS, "attributed to what is not there", "CPU s, median")
    lines = ["| hidden | " + " | ".join(head) + " |", "|---" * (len(head) + 1) + "|"]
    outside = set(MECHANISMS) - set(OF_THE_PLACE)
    for kind, kinds in [*((k, {k}) for k in MECHANISMS), ("together, outside the library", outside)]:
        own = [r for r in rows if r["kind"] in kinds]
        if own:
            said = [sum(r["verdict"] == v for r in own) for v in VERDICTS]
            wrong = sum(r["verdict"] == "attributed" and bool(r["other"]) for r in own)
            cells = (len(own), *said, wrong, f"{float(np.median([r['cpu_s'] for r in own])):.3g}")
            lines.append(f"| {kind} | " + " | ".join(str(c) for c in cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make what is asked for and is not there yet."""
    given = asked(__doc__, HERE, MECHANISMS)
    rows = Rows(OUT, table, given.again)
    for place in places(given, beside=(False, True)):
        rows.make(place, lambda place=place: one(**place, budget=given.budget))


if __name__ == "__main__":
    main()
