"""Noise of other laws than the one that the diagnosis knows, with and without friction that is to be found.

    python benchmarks/noise_colours.py [--plants dc_motor] [--kinds filtered hum] [--seeds 1] [--budget 25] [--again]

On top of the white noise of records by SciPy (tests/undeclared/rig/textbook.py) comes noise of AR(2), of a low-pass
filter, of a moving mean, 1/f noise, heavy tails (Student's t with 2.5 degrees of freedom), a hum, a ramp and a random
walk, of twice its size or more. The table is benchmarks/results/noise_colours.md.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, lfilter

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from kept_rows import Rows, asked, places  # noqa: E402
from other_plants import SIZES  # noqa: E402

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.result import DiagnosisSettings  # noqa: E402
from tests.undeclared.nominals import nominal, record  # noqa: E402
from tests.undeclared.rig.textbook import PLANTS, Hidden  # noqa: E402
from tests.undeclared.scoring import mark  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "noise_colours.json"
BEFORE = 200  # samples that a filter has to settle
Noise = Callable[[int, np.random.Generator], np.ndarray]


def _coloured(law: Callable[[np.ndarray], np.ndarray]) -> Noise:
    """Twice as large as the white noise."""

    def made(n: int, rng: np.random.Generator) -> np.ndarray:
        y = law(rng.standard_normal(n + BEFORE))[BEFORE:]
        return np.asarray(2.0 * y / np.std(y))

    return made


def _pink(e: np.ndarray) -> np.ndarray:
    f = np.fft.rfft(e)
    return np.asarray(np.fft.irfft(f / np.sqrt(np.maximum(np.arange(len(f)), 1)), len(e)))


def _heavy(n: int, rng: np.random.Generator) -> np.ndarray:
    y = rng.standard_t(2.5, n)
    return np.asarray(2.0 * y / np.std(y))


def _hum(n: int, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(3.0 * np.sin(2 * np.pi * 0.17 * np.arange(n) + rng.uniform(0, 2 * np.pi)))


NOISES: dict[str, Noise] = {
    "AR(2)": _coloured(lambda e: lfilter([1.0], [1.0, -1.5, 0.7], e)),
    "filtered": _coloured(lambda e: lfilter(*butter(2, 0.15), e)),
    "moving mean": _coloured(lambda e: np.convolve(e, np.ones(5) / 5, "same")),
    "1/f": _coloured(_pink),
    "heavy tails": _heavy,
    "hum": _hum,
    "ramp": lambda n, rng: 6.0 * np.linspace(0.0, 1.0, n) * rng.choice([-1.0, 1.0]),
    "random walk": lambda n, rng: 0.04 * np.cumsum(rng.standard_normal(n)),
}


def one(plant: str, kind: str, friction: bool, seed: int, budget: float | None) -> dict[str, Any]:
    """Make one record, diagnose it, score it."""
    book, here, size = PLANTS[plant](), *SIZES[plant][:2]
    rng = np.random.default_rng([seed, *kind.encode()])
    b = size * float(rng.uniform(0.7, 1.4))
    made = record(book, Hidden(viscous={here: b} if friction else {}), seed)
    sigma = np.array(book.sigma)
    traces = tuple(
        replace(r, y=r.y + sigma * np.stack([NOISES[kind](len(r.t), rng) for _ in sigma], axis=1)) for r in made.traces
    )
    truth = {("viscous_friction", here): {"b": b}} if friction else {}
    begun = time.process_time()
    d = diagnose(nominal(plant), replace(made, traces=traces), DiagnosisSettings(budget_s=budget))
    values = {f"{name} {on}": own for (name, on), own in truth.items()}
    m = mark(d, {"effects": [list(k) for k in truth], "library": True, "parameters": values})
    return {
        "plant": plant, "kind": kind, "friction": friction, "seed": seed, "verdict": d.verdict, "answer": m.answer,
        "exact": m.exact, "covered": m.covered, "faults": [f.fault for f in d.recording],
        "chi2_dof": d.after.chi2_dof, "ratio": d.after.held_out_ratio, "cpu_s": round(time.process_time() - begun, 1),
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one noise a row."""
    head = ("noise", "records", "right verdict", "right names", "wrong attributed", "wrong partial",
            "intervals that cover", "push reported")  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for kind in NOISES:
        own = [r for r in rows if r["kind"] == kind]
        covered = [c for r in own for c in r["covered"]]
        wrong = {v: sum(r["verdict"] == v and not r["exact"] for r in own) for v in ("attributed", "partial")}
        cells = (
            len(own), sum(r["verdict"] == ("attributed" if r["friction"] else "none") for r in own),
            sum(r["exact"] for r in own), wrong["attributed"], wrong["partial"],
            f"{sum(covered)} of {len(covered)}" if covered else "", sum("push" in r["faults"] for r in own),
        )  # fmt: skip
        lines.append(f"| {kind} | " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make what is asked for and is not there yet."""
    given = asked(__doc__, SIZES, NOISES, ("oscillator", "dc_motor", "cart_pole"))
    rows = Rows(OUT, table, given.again)
    for place in places(given, friction=(True, False)):
        rows.make(place, lambda place=place: one(**place, budget=given.budget))


if __name__ == "__main__":
    main()
