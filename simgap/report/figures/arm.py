"""The pictures of an arm's diagnosis, each from plain arrays to a matplotlib figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from simgap.diagnosis.arms.answer import ArmDiagnosis
from simgap.diagnosis.result import WindowPrediction
from simgap.io import figure_style as style
from simgap.notation import axis_label


def torque_figure(p: WindowPrediction, inputs: Sequence[str], units: Mapping[str, str]) -> Any:
    """Torques of one trace: measured, of the model as declared and as corrected, one panel a joint."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        len(inputs), 1, sharex=True, figsize=(style.WIDTH, 1.5 * len(inputs) + 0.6), squeeze=False
    )
    for j, name in enumerate(inputs):
        axis = axes[j, 0]
        axis.plot(p.t, p.measured[:, j], color=style.MEASURED, lw=3.2, alpha=0.35, label="measured")
        axis.plot(p.t, p.before[:, j], color=style.BEFORE, ls=(0, (5, 2)), label="before")
        axis.plot(p.t, p.after[:, j], color=style.AFTER, lw=1.3, label="after")
        axis.set_ylabel(axis_label(name, units))
    axes[0, 0].set_title(f"{p.trace}: never fitted")
    axes[-1, 0].set_xlabel("time (s)")
    figure.align_ylabels()
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def torque_error_figure(found: ArmDiagnosis, inputs: Sequence[str], units: Mapping[str, str]) -> Any:
    """RMS error of each joint's torque on *confirm*, before and after."""
    import matplotlib.pyplot as plt
    import numpy as np

    figure, axis = plt.subplots(figsize=(style.WIDTH, 3.2))
    place = np.arange(len(inputs))
    for shift, rms, colour, label in (
        (-0.2, found.before, style.BEFORE, "before"),
        (0.2, found.after, style.AFTER, "after"),
    ):
        bars = axis.bar(place + shift, [rms[name] for name in inputs], 0.38, color=colour, label=label)
        axis.bar_label(bars, fmt="%.2g", fontsize=10)
    axis.set_xticks(place, [axis_label(name, units) for name in inputs])
    axis.set_ylabel("RMS error")
    axis.grid(axis="x", visible=False)
    figure.legend(loc="outside upper left", ncols=2)
    return figure
