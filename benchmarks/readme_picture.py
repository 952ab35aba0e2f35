"""README's picture: the tutorial's rod before and after, from a finished run of the tutorial.

    simgap tutorial && simgap run rod.yaml && python benchmarks/readme_picture.py rod.yaml

Left: the recording, and what the model of the URDF and the corrected model predict over half a second, restarted from
the recording. Middle and right: one start in PyBullet, with controllers made for the one and for the other model. Where
a controller has no admissible input left, the full torque towards upright is applied. Writes
docs/pictures/diagnosis.png and benchmarks/results/tutorial.json.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyarrow.parquet as pq

import simgap
from simgap.io.figure_style import COLOURS
from simgap.io.traces import Trace, split
from simgap.signals import savgol_filter
from simgap.simulators.rollouts import make_simulator

ROOT = Path(__file__).parents[1]
GREY, BEFORE, AFTER = "#3A3F47", "#D55E00", "#0072B2"
NAMES = {"nominal": "controller that trusts the model", "gap": "controller that knows the gap"}
LIMIT, TORQUE, SECONDS = 0.25, 1.5, 4.99  # rad, N m, s of a run that lasts: docs/tutorial/rod.yaml


def recording(axes: plt.Axes, cases: tuple[Path, Path], data: Path) -> None:
    """The measured angle and the predictions of both models."""
    t, q, u = np.loadtxt(data, delimiter=",", skiprows=1).T
    v = savgol_filter(q, 15, 3, 1, t[1] - t[0])
    shown, half = slice(200, 601), 50
    axes.plot(t[shown], q[shown], color=GREY, lw=5, alpha=0.4, label="measured")
    looks = ((BEFORE, "--", "model of the URDF"), (AFTER, "-", "corrected model"))
    for case, (colour, style, label) in zip(cases, looks, strict=True):
        model = simgap.load_plant(case).sampled
        for start in range(shown.start, shown.stop - half, half):
            x = [np.array([q[start], v[start]])]
            for torque in u[start : start + half]:
                x.append(model.step(x[-1][None], np.array([[torque]]))[0])
            own = label if start == shown.start else None
            axes.plot(t[start : start + half + 1], np.array(x)[:, 0], color=colour, ls=style, lw=1.8, label=own)
    axes.set(xlabel="time (s)", ylabel="angle (rad)", title="Recording: predicted half a second ahead")
    axes.set_ylim(-0.45, 0.45)


def fall(case: Path, run: Trace) -> np.ndarray:
    """What PyBullet does from the end of a run (nx,) under the full torque towards upright: (k, nx)."""
    simulator = make_simulator(simgap.load_case(case), case.parent)
    x = [run.x[-1]]
    simulator.reset(x[0])
    while abs(x[-1][0]) < 0.45 and len(x) < 200:
        x.append(simulator.advance(np.array([-TORQUE * np.sign(x[-1][0])])))
    simulator.close()
    return np.array(x)


def closed_loop(axes: plt.Axes, case: Path, results: Path, number: int | None, title: str) -> int:
    """Runs of both controllers from one start, the first that the nominal-only controller fails if none is given."""
    runs = split(pq.read_table(results / "validation/traces.parquet"), ("q", "v"), ("u",))
    runs = [run for run in runs if run.plant == "simulator"]
    if number is None:
        number = next(run.run for run in runs if run.controller == "nominal" and run.duration < SECONDS)
    for kind, dashes in (("gap", "-"), ("nominal", "--")):  # both are seen where they coincide
        for run in (r for r in runs if r.controller == kind and r.run == number):
            axes.plot(run.t, run.x[:, 0], dashes, color=COLOURS[kind], lw=2.5, label=NAMES[kind])
            if run.duration < SECONDS:
                after = fall(case, run)
                axes.plot(run.t[-1], run.x[-1, 0], "X", color="black", ms=10, mec="white", zorder=5)
                t = run.t[-1] + 0.01 * np.arange(len(after))
                axes.plot(t, after[:, 0], ":", color=COLOURS[kind], lw=2)
    axes.axhspan(-LIMIT, LIMIT, fc="#E8F3EC", zorder=0)
    axes.set(xlabel="time (s)", title=title, xlim=(0, 2.5), ylim=(-0.45, 0.45))
    return number


def figures(results: Path) -> dict[str, object]:
    """What the tutorial quotes of a summary."""
    summary = simgap.load_summary(results)
    loops = {kind: summary["closed_loop"][kind]["simulator"] for kind in ("nominal", "gap")}
    return {
        "largest_gap": summary["sup_gamma"][0]["states"]["v"]["sampled"],
        "winning": summary["winning_fraction"],
        "failed": {kind: [t["runs_that_violated_it"], t["runs"]] for kind, t in loops.items()},
    }


def main() -> None:
    """Three panels, side by side."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    case = Path(sys.argv[1]).resolve()
    results = case.parent / "results/rod"
    corrected = results / "diagnosis/corrected_case.yaml"
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4.4), layout="constrained", sharey=True)
    recording(left, (case, corrected), case.parent / "swings.csv")
    number = closed_loop(middle, case, results, None, "PyBullet, controllers from the URDF's model")
    closed_loop(right, case, results / "corrected", number, "PyBullet, controllers from the corrected model")
    middle.text(1.55, 0.21, "limit of the safe set", fontsize=9, color=GREY)
    left.legend(loc="lower right", fontsize=9, framealpha=0.9)
    middle.legend(loc="upper right", fontsize=9, framealpha=0.9)
    for axes in (left, middle, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(ROOT / "docs/pictures/diagnosis.png", dpi=110, metadata={"Software": None})
    found = {"before": figures(results), "after": figures(results / "corrected")}
    (ROOT / "benchmarks/results/tutorial.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
