"""The picture of a proposed recording, from plain arrays to a matplotlib figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from simgap.arrays import Floats
from simgap.io import figure_style as style
from simgap.notation import axis_label

COLOURS = (style.BLUE, style.VERMILLION, style.GREEN, style.PURPLE, style.ORANGE)


@dataclass(frozen=True, eq=False)
class Proposed:
    """What is drawn.

    Attributes:
        t: (n,) s; u: (n, m); inputs: names of its columns.
        labels: of the rivals; readings: of each, (n, k); measured: names of the k columns.
        missed: (n, k) what the closest other one would miss, fitted again, in units of the noise; None for one alone.
        pair: the right one and the one that misses.
        title: how sure one will be, and by how long a recording.
    """

    t: Floats
    u: Floats
    inputs: Sequence[str]
    labels: Sequence[str]
    readings: Sequence[Floats]
    measured: Sequence[str]
    missed: Floats | None
    pair: tuple[int, int]
    title: str = "what to play"


def next_figure(p: Proposed, units: Mapping[str, str]) -> Any:
    """The input, what each rival predicts, and what the closest wrong one would miss."""
    import matplotlib.pyplot as plt

    rows = 2 if p.missed is None else 3
    figure, axes = plt.subplots(rows, 1, sharex=True, figsize=(style.WIDTH, 2.2 * rows + 0.8))
    for j, name in enumerate(p.inputs):
        axes[0].step(p.t, p.u[:, j], where="post", lw=1.2, color=COLOURS[j % len(COLOURS)], label=name)
    axes[0].set_ylabel(axis_label(p.inputs[0], units) if len(p.inputs) == 1 else "inputs")
    axes[0].set_title(p.title)
    if len(p.inputs) > 1:
        axes[0].legend(loc="upper right", ncols=4)
    for k, (label, y) in enumerate(zip(p.labels, p.readings, strict=True)):
        dash = "-" if k == 0 else (0, (4, 1 + k))
        axes[1].plot(p.t, y[:, 0], color=COLOURS[k % len(COLOURS)], ls=dash, lw=1.4, label=label)
    axes[1].set_ylabel(axis_label(p.measured[0], units))
    axes[1].set_title("what each explanation predicts")
    if p.missed is not None:
        for k, name in enumerate(p.measured):
            axes[2].plot(p.t, p.missed[:, k], lw=1.2, color=COLOURS[k % len(COLOURS)], label=name)
        axes[2].axhspan(-2, 2, color=style.FLOOR, alpha=0.35, lw=0, label="noise, ±2σ")
        axes[2].set_ylabel("missed / σ")
        right, wrong = p.pair
        axes[2].set_title(f"if {p.labels[right]} is right, what {p.labels[wrong]} misses, fitted again")
        axes[2].legend(loc="upper right", ncols=4)
    axes[-1].set_xlabel("time (s)")
    figure.align_ylabels()
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure
