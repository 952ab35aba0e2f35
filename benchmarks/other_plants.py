"""Plants other than the pendulum of `undeclared.py`, with effects, faults of the recording, pushes and changes hidden.

    python benchmarks/other_plants.py [--plants dc_motor two_link] [--kinds push] [--seeds 1] [--budget 120] [--again]

Records are made by SciPy from textbook equations (tests/undeclared/rig/textbook.py). Each row is kept in
benchmarks/results/other_plants.json as soon as it is there, and what is there is not made again without `--again`; the
table is benchmarks/results/other_plants.md.
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

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.record.record import Record, Trace  # noqa: E402
from simgap.diagnosis.result import DiagnosisSettings  # noqa: E402
from tests.undeclared.nominals import nominal, record  # noqa: E402
from tests.undeclared.rig.textbook import PLANTS, Hidden  # noqa: E402
from tests.undeclared.scoring import mark  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "other_plants.json"
# plant -> coordinate and its viscous and dry friction, another and its viscous friction, push on the first
SIZES: dict[str, tuple[str, float, float, str, float, float]] = {
    "dc_motor": ("shaft", 4e-4, 0.012, "shaft", 8e-4, 0.3),
    "oscillator": ("slide", 0.3, 0.25, "slide", 0.6, 15.0),
    "pendulum": ("hinge", 0.1, 0.12, "hinge", 0.2, 8.0),
    "cart_pole": ("cart", 0.6, 0.4, "pole", 0.03, 15.0),
    "cart_pole_urdf": ("rail", 0.8, 0.3, "hinge", 0.1, 8.0),
    "two_link": ("shoulder", 0.2, 0.25, "elbow", 0.1, 25.0),
    "vtol": ("x", 0.3, 0.0, "a", 0.03, 8.0),
}
Truth = dict[tuple[str, str], dict[str, float]]
Made = tuple[Record, Truth, tuple[str, ...]]
"""A record, the effects that are hidden in it with their numbers, and the faults of the recording."""


def _scatter(seed: int, kind: str) -> float:
    """A factor on sizes between 0.7 and 1.4."""
    return float(np.random.default_rng([seed, *kind.encode()]).uniform(0.7, 1.4))


def _hidden(plant: str, kind: str, seed: int) -> tuple[Hidden, Truth]:
    size, first = _scatter(seed, kind), PLANTS[plant]().inputs[0]
    ratio = 1.0 - 0.12 * size
    gain: tuple[Hidden, Truth] = Hidden(gain={first: ratio}), {("input_gain", first): {"ratio": ratio}}
    if plant == "wheeled":
        return _wheeled(kind, size, gain)
    here, b, dry, there, b2, _ = SIZES[plant]
    if kind.startswith("payload"):
        weight: Truth = {("payload", "lower"): {"m_p": 0.15 * size, "r": 0.6}}
        with_more: Truth = {("viscous_friction", there): {"b": size * b2}} if "friction" in kind else {}
        return Hidden(
            factors={"payload": 0.15 * size}, viscous={there: size * b2} if with_more else {}
        ), weight | with_more
    if kind == "mass of a link":
        return Hidden(factors={"m2": 1.0 + 0.2 * size}), {
            ("parameter_error", "lower.mass"): {"ratio": 1.0 + 0.2 * size}
        }
    viscous: Truth = {("viscous_friction", here): {"b": size * b}}
    if kind == "gain":
        return gain
    if kind in ("dry friction", "push") and dry > 0.0:
        return Hidden(coulomb={here: size * dry}), {("coulomb_friction", here): {"F_c": size * dry}}
    if kind == "friction elsewhere":
        return Hidden(viscous={there: size * b2}), {("viscous_friction", there): {"b": size * b2}}
    if kind in ("two effects", "push on two effects"):
        return Hidden(viscous={here: size * b}, gain=gain[0].gain), viscous | gain[1]
    if kind in ("viscous friction", "push", "dry friction", "input late", "state late", "coloured noise"):
        return Hidden(viscous={here: size * b}), viscous
    return Hidden(), {}


def _wheeled(kind: str, size: float, gain: tuple[Hidden, Truth]) -> tuple[Hidden, Truth]:
    """A robot has no friction to name: the turning's gain and bias stand in its place."""
    turn = 1.0 + 0.1 * size
    if kind in ("dry friction", "friction elsewhere"):
        return Hidden(bias={"w": 0.05 * size}), {("input_bias", "w"): {"bias": 0.05 * size}}
    if kind == "two effects":
        told = {("input_gain", "w"): {"ratio": turn}, ("input_bias", "v"): {"bias": 0.02 * size}}
        return Hidden(gain={"w": turn}, bias={"v": 0.02 * size}), told
    if kind in ("viscous friction", "input late", "state late", "coloured noise"):
        return Hidden(gain={"w": turn}), {("input_gain", "w"): {"ratio": turn}}
    return gain if kind == "gain" else (Hidden(), {})


def _changed_later(plant: str, seed: int) -> tuple[Hidden, Truth]:
    """From somewhere in the second run on there is more friction (or another gain)."""
    at = 2.0 + 6.0 * float(np.random.default_rng([seed, 5]).uniform())
    if plant == "wheeled":
        return Hidden(gain={"w": 1.1}, after=(1, at), later=Hidden(gain={"w": 1.25})), {("input_gain", "w"): {}}
    here, b = SIZES[plant][0], SIZES[plant][1] * 1.5
    told: Truth = {("viscous_friction", here): {}}
    return Hidden(viscous={here: b}, after=(1, at), later=Hidden(viscous={here: 2.5 * b})), told


def make(plant: str, kind: str, seed: int) -> Made:
    """A record of 2 x 10 s, and what is hidden."""
    book, (hidden, truth) = PLANTS[plant](), _hidden(plant, kind, seed)
    more: tuple[str, ...] = ()
    if "push" in kind and plant != "wheeled":
        here, force = SIZES[plant][0], SIZES[plant][5]
        at = np.random.default_rng([seed, 3]).uniform(1.0, 8.5, 2)
        pushes = tuple((k, float(a), float(a) + 0.1, here, force) for k, a in enumerate(at))
        hidden, more = replace(hidden, pushes=pushes), ("push",)
    if kind == "plant changed":
        (hidden, truth), more = _changed_later(plant, seed), ("plant_changed",)
    made = record(book, hidden, seed)
    fault = RECORDERS.get(kind)
    if fault is not None:
        made, more = fault[0](made, np.random.default_rng([seed, 9])), (fault[1],)
    return made, truth, more


def _late(made: Record, rng: np.random.Generator) -> Record:
    """Inputs two samples late."""
    return Record(tuple(Trace(r.name, r.t, r.y, np.vstack([r.u[:1], r.u[:1], r.u[:-2]])) for r in made.traces),
                  made.measured, made.inputs)  # fmt: skip


def _late_state(made: Record, rng: np.random.Generator) -> Record:
    """The first channel two samples late."""
    traces = []
    for r in made.traces:
        y = r.y.copy()
        y[2:, 0] = r.y[:-2, 0]
        traces.append(Trace(r.name, r.t[2:], np.ascontiguousarray(y[2:]), np.ascontiguousarray(r.u[2:])))
    return Record(tuple(traces), made.measured, made.inputs)


def _coloured(made: Record, rng: np.random.Generator) -> Record:
    """Noise on top that is correlated over three samples, twice as large as the white one."""
    traces, keep = [], np.exp(-1.0 / 3.0)
    for r in made.traces:
        sigma = np.std(np.diff(r.y, 6, axis=0), axis=0) / np.sqrt(924.0)
        e = rng.standard_normal(r.y.shape) * 2.0 * sigma
        for i in range(1, len(e)):
            e[i] = keep * e[i - 1] + np.sqrt(1 - keep**2) * e[i]
        traces.append(Trace(r.name, r.t, r.y + e, r.u))
    return Record(tuple(traces), made.measured, made.inputs)


RECORDERS: dict[str, tuple[Callable[[Record, np.random.Generator], Record], str]] = {
    "input late": (_late, "late_log"),
    "state late": (_late_state, "late_log"),
    "coloured noise": (_coloured, "coloured_noise"),
}
KINDS = (
    "nothing", "viscous friction", "dry friction", "friction elsewhere", "gain", "two effects", "push",
    "push on two effects",
    "plant changed", "payload", "payload, friction elsewhere", "mass of a link", *RECORDERS,
)  # fmt: skip


def makes_sense(plant: str, kind: str) -> bool:
    """Whether a kind makes sense for a plant."""
    if kind.startswith("payload") or kind == "mass of a link":
        return plant == "two_link"  # at the tip of its second link
    if plant == "wheeled":
        return "push" not in kind
    single = len(PLANTS[plant]().measured) == 1
    return not (kind == "state late" and single) and not (kind == "dry friction" and plant == "vtol")


def one(plant: str, kind: str, seed: int, budget: float | None) -> dict[str, Any]:
    """Make one record, diagnose it, score it."""
    made, truth, faults = make(plant, kind, seed)
    begun = time.process_time()
    d = diagnose(nominal(plant), made, DiagnosisSettings(budget_s=budget))
    sealed = {
        "effects": [list(k) for k in truth], "library": True,
        "parameters": {f"{name} {on}": values for (name, on), values in truth.items()},
    }  # fmt: skip
    m = mark(d, sealed)
    right = {tuple(t) for t in m.truth} if m.exact else set()
    wrong = [list(a) for a in m.answer if tuple(a) not in truth and not right]
    return {
        "plant": plant, "kind": kind, "seed": seed, "verdict": d.verdict, "truth": m.truth, "answer": m.answer,
        "exact": m.exact, "listed": m.listed, "wrong": wrong, "covered": m.covered,
        "hidden_faults": list(faults), "faults": [f.fault for f in d.recording],
        "said": [f.sentence for f in d.recording], "ratio": d.after.held_out_ratio,
        "chi2_dof": [d.before.chi2_dof, d.after.chi2_dof],
        "nearest": [[e.name, e.on] for e in d.nearest.effects] if d.nearest else [],
        "cpu_s": round(time.process_time() - begun, 1),
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one kind a row."""
    head = ("records", "exact", "listed", "right verdict", "fault found", "other faults", "wrong attributed",
            "wrong partial", "intervals that cover", "CPU s, median")  # fmt: skip
    lines = ["| hidden | " + " | ".join(head) + " |", "|---" * (len(head) + 1) + "|"]
    for kind in KINDS:
        own = [r for r in rows if r["kind"] == kind]
        if not own:
            continue
        covered = [c for r in own for c in r["covered"]]
        cells = (
            len(own), sum(r["exact"] for r in own), sum(r["listed"] for r in own),
            sum(r["verdict"] == ("attributed" if r["truth"] else "none") for r in own),
            sum(set(r["hidden_faults"]) <= set(r["faults"]) for r in own) if own[0]["hidden_faults"] else "",
            sum(bool(set(r["faults"]) - set(r["hidden_faults"])) for r in own),
            sum(r["verdict"] == "attributed" and bool(r["wrong"]) for r in own),
            sum(r["verdict"] == "partial" and bool(r["wrong"]) for r in own),
            f"{sum(covered)} of {len(covered)}" if covered else "",
            f"{float(np.median([r['cpu_s'] for r in own])):.3g}",
        )  # fmt: skip
        lines.append(f"| {kind} | " + " | ".join(str(c) for c in cells) + " |")
    return "\n".join(lines) + "\n"


UNSAID = ("said", "hidden_faults")


def main() -> None:
    """Make what is asked for and is not there yet."""
    given = asked(__doc__, PLANTS, KINDS)
    rows = Rows(OUT, table, given.again)
    for place in places(given):
        if makes_sense(place["plant"], place["kind"]):
            rows.make(place, lambda place=place: one(**place, budget=given.budget), unsaid=("said", "hidden_faults"))


if __name__ == "__main__":
    main()
