"""Two recordings that nothing has read, held against the bounds of a real servo before and after its correction.

    snakemake --cores 2 servo && python benchmarks/servo_loop.py

The uncorrected model gets what the corrected one gets: its own gap to the simulator and the split-conformal bound of
what the same held-out recordings leave of it, near rest and in motion if that narrows it. Both bounds are compared by
their mean and largest width over X and U, and by the share of the transitions of the two recordings inside. Writes
benchmarks/results/servo_loop.json and .md.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simgap.correction.transitions import seen, transitions, within
from simgap.diagnosis.result import WindowPrediction
from simgap.gap.bounds.function import GapFunction
from simgap.gap.fitting.acceptance import covering_remainder
from simgap.io.gap_file import load_gap
from simgap.io.recordings.measured import load_reading
from simgap.plants.context import Context

ROOT = Path(__file__).parents[1]
CASE, RESULTS = ROOT / "configs/cases/go1_servo.yaml", ROOT / "results/go1_servo"
SEALED = ("sin_sin_2kg.csv", "up_and_down_2kg.csv")
OUT = ROOT / "benchmarks/results"


def sealed_windows(context: Context) -> dict[str, list[WindowPrediction]]:
    """The recordings as windows: what is read, and nothing that a model says."""
    section, model = context.case.measured, context.plant.corrected
    assert section is not None
    folder = (context.folder / section.files[0]).parent
    assert not any(name in str(f) for f in section.files for name in SEALED), "the case reads what is to judge it"
    quiet = section.model_copy(update={"conditions": (), "masks": (), "held_out": type(section.held_out)()})
    record = load_reading(model, quiet, [folder / name for name in SEALED], context.folder).record
    rows: dict[str, list[WindowPrediction]] = {}
    for trace in record.traces:
        unknown = np.zeros((len(trace.t), len(model.state_names)))
        window = WindowPrediction(trace.name, True, trace.t, trace.y, trace.y, trace.y, unknown, trace.u)
        rows.setdefault(trace.name.split(":")[0], []).append(window)
    return rows


def inside(context: Context, gap: GapFunction, windows: list[WindowPrediction], sigma: float) -> tuple[int, int]:
    """Transitions inside `f +- gamma` in position and speed, and all that begin in X with an input in the hull of U."""
    model, domain = context.plant.corrected, context.case.domain
    assert domain is not None
    whole, _ = seen(windows, {"q": sigma}, model)
    part = within(transitions(whole, ["q", "v"], model, {}, domain.tau), model, domain.X)
    x, u = part.start[:, :2], part.start[:, 2:]
    taken = (u[:, 0] >= context.input_set.min()) & (u[:, 0] <= context.input_set.max())
    nearest = context.input_set[np.argmin(np.abs(u - context.input_set.T), axis=1)]
    lo, hi = gap.bounds(x, nearest)
    residual = part.then - context.plant.sampled.step(x, u)
    good = np.all((residual >= lo) & (residual <= hi), axis=1)
    return int(np.sum(good & taken)), int(np.sum(taken))


def widths(gap: GapFunction, context: Context) -> dict[str, dict[str, float]]:
    """State -> mean and largest of (hi - lo)/2 at 200,000 random points of X and U."""
    rng = np.random.default_rng(0)
    x = context.box.lo + rng.random((200_000, 2)) * (context.box.hi - context.box.lo)
    lo, hi = gap.bounds(x, context.input_set[rng.integers(len(context.input_set), size=len(x))])
    half = 0.5 * (hi - lo)
    return {n: {"mean": float(half[:, i].mean()), "largest": float(half[:, i].max())} for i, n in enumerate("qv")}


def remainder_of(context: Context, document: Mapping[str, Any]) -> Any:
    """The gap section of the uncorrected case, with what its held-out transitions leave."""
    own, rest = document["remainder"], document["remainder"]["rest_before"]
    box = [] if rest is None else [{"where": {rest["velocity"]: [-rest["below"], rest["below"]]}, "by": rest["by"]}]
    section = context.case.gap
    assert section is not None
    content = section.model_dump() | {"remainder": own["before"], "remainder_within": box}
    return type(section).model_validate(content)


def main() -> None:
    """Hold both bounds against the recordings, and write the figures."""
    first, later = Context.load(CASE), Context.load(RESULTS / "diagnosis/corrected_case.yaml")
    document = json.loads((RESULTS / "diagnosis/diagnosis.json").read_text())
    gaps = [next(folder.glob("gap/*/gap.json")) for folder in (RESULTS, RESULTS / "corrected")]
    before = covering_remainder(load_gap(gaps[0], first).function, remainder_of(first, document))
    after = load_gap(gaps[1], later).function
    windows, sigma = sealed_windows(first), document["noise"]["q"]
    found: dict[str, Any] = {"verdict": document["verdict"], "sentence": document["sentences"][0]}
    for side, own, gap in (("before", first, before), ("after", later, after)):
        counts = {name: inside(own, gap, parts, sigma) for name, parts in windows.items()}
        found[side] = {"inside": counts, "half_width": widths(gap, own)}
    for n in "qv":
        mean, top = ([found[s]["half_width"][n][k] for s in ("before", "after")] for k in ("mean", "largest"))
        found[f"ratio_{n}"] = {"mean": mean[1] / mean[0], "largest": top[1] / top[0]}
    OUT.mkdir(exist_ok=True)
    (OUT / "servo_loop.json").write_text(json.dumps(found, indent=1))
    (OUT / "servo_loop.md").write_text(table(found))
    print(json.dumps(found, indent=1))


def table(found: Mapping[str, Any]) -> str:
    """Markdown."""
    lines = ["| figure | before | after | after / before |", "|---|---|---|---|"]
    for n, unit in (("q", "rad"), ("v", "rad/s")):
        for k in ("mean", "largest"):
            a, b = (found[s]["half_width"][n][k] for s in ("before", "after"))
            lines.append(f"| {k} half-width of the bound in {n}, {unit} | {a:.3g} | {b:.3g} | {b / a:.2f} |")
    for name in found["before"]["inside"]:
        a, b = (found[s]["inside"][name] for s in ("before", "after"))
        lines.append(f"| transitions of {name} inside | {a[0]} of {a[1]} | {b[0]} of {b[1]} | |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
