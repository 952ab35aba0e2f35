"""README's picture: a model that drifts from a recording, and its correction; a controller that fails, one that holds.

    python benchmarks/readme_picture.py results/pendulum

Left: the recording of the tutorial, diagnosed here, and what both models predict from its first sample on by the torque
alone. Right: runs of both controllers of the pendulum in PyBullet from the same starts, those of the run's traces in
which the nominal-only one fails. Writes docs/pictures/diagnosis.png.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pyarrow.parquet as pq
from pydrake.systems.analysis import Simulator

import simgap
from simgap.io.figure_style import AFTER, BEFORE, COLOURS, GREY
from simgap.io.traces import split

ROOT = Path(__file__).parents[1]
SECONDS, LIMIT = 8.0, -0.5  # of the rate, rad/s: configs/cases/pendulum.yaml


def predicted(case: Path, t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Angles at the samples, from rest at 0, by the torque that was recorded."""
    system = simgap.load_plant(case).drake_system()
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    context.SetContinuousState([0.0, 0.0])
    angles = []
    for now, torque in zip(t, u, strict=True):
        if now > 0.0:
            simulator.AdvanceTo(now)
        angles.append(context.get_continuous_state_vector()[0])
        system.get_input_port().FixValue(context, [torque])
    return np.array(angles)


def recording(axes: plt.Axes) -> None:
    """The measured angle and both predictions."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in ("rod.urdf", "swings.csv"):
            shutil.copy(ROOT / "docs/tutorial" / file, folder)
        case = simgap.new_case("rod", urdf=folder / "rod.urdf", folder=folder)
        simgap.diagnose(case, [folder / "swings.csv"], out=folder / "found")
        t, q, u = np.loadtxt(folder / "swings.csv", delimiter=",", skiprows=1).T
        shown = t <= SECONDS
        before, after = (predicted(c, t[shown], u[shown]) for c in (case, folder / "found/corrected_case.yaml"))
    axes.plot(t[shown], q[shown], color=GREY, lw=5, alpha=0.5, label="measured")
    axes.plot(t[shown], before, color=BEFORE, lw=1.8, ls="--", label="model as declared")
    axes.plot(t[shown], after, color=AFTER, lw=1.5, label="with the friction that was found")
    axes.set(xlabel="time (s)", ylabel="angle (rad)", title="Model: predicted from the first sample")
    axes.legend(loc="upper right", fontsize=9, framealpha=0.9)


def closed_loop(axes: plt.Axes, results: Path) -> None:
    """Runs of both controllers near the limit of the rate, from a start where the nominal-only one fails."""
    table = pq.read_table(results / "validation/traces.parquet")
    runs = [run for run in split(table, ("x1", "x2"), ("u",)) if run.plant == "simulator"]
    failed = max((run for run in runs if run.controller == "nominal" and run.violates), key=lambda run: run.duration)
    names = {"gap": "controller that knows the gap", "nominal": "controller that trusts the model"}
    for run in (run for run in runs if run.run == failed.run):
        axes.plot(run.t, run.x[:, 1], ".-", color=COLOURS[run.controller], lw=1.5, label=names[run.controller])
    axes.plot(failed.t[-1], failed.x[-1, 1], "X", color=COLOURS["nominal"], ms=11, label="outside the safe set")
    axes.axhspan(LIMIT, 0.0, fc="#E8F3EC", zorder=0)
    axes.axhline(LIMIT, color="#3A3F47", lw=1.2)
    axes.text(0.198, LIMIT - 0.0035, "limit of the safe set", ha="right", fontsize=9, color="#3A3F47")
    axes.set(xlabel="time (s)", ylabel="rate (rad/s)", title="Controller: a run in PyBullet, at the limit")
    axes.set(xlim=(0.07, 0.2), ylim=(-0.51, -0.43))
    axes.legend(loc="upper right", fontsize=9, framealpha=0.9)


def main() -> None:
    """Both panels, side by side."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained", width_ratios=(1.35, 1))
    recording(left)
    closed_loop(right, Path(sys.argv[1]))
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(ROOT / "docs/pictures/diagnosis.png", dpi=120, metadata={"Software": None})


if __name__ == "__main__":
    main()
