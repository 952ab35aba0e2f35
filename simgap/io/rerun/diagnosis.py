"""The diagnosis as a Rerun recording: measured, before and after, residuals and inputs on one time line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simgap.diagnosis.result import WindowPrediction
from simgap.io import figure_style as style
from simgap.io.pages import text
from simgap.io.rerun.recording import laid_out, plot, recording_file
from simgap.late import rerun as rr
from simgap.late import rerun_blueprint as rrb
from simgap.notation import axis_label, printable

_LINES = (("measured", style.MEASURED_IN_A_VIEWER, 1.5), ("before", style.BEFORE, 3.0), ("after", style.AFTER, 3.0))


def write_recording(
    path: Path,
    windows: Sequence[WindowPrediction],
    measured: Sequence[str],
    inputs: Sequence[str],
    units: Mapping[str, str],
    title: str,
    sentence: str = "",
) -> None:
    """Write the recording, atomically; the sentence is the verdict.

    Entities: `/<trace>/<state>/{measured,before,after}`, `/<trace>/residual/<state>/{before,after}` and
    `/<trace>/input/<input>`, each a scalar over `sim_time`; the traces' own stamps are kept. `/<trace>/never_fitted` is
    1 in the windows that were held out for the verdict and 0 elsewhere; `/about` says it all in words.
    """
    traces = list(dict.fromkeys(w.trace for w in windows))
    look = _blueprint(traces, measured, inputs, units)
    identifier = "".join(c if c.isalnum() else "-" for c in title) or "diagnosis"
    with recording_file(path, "simgap_diagnosis", identifier, look) as recording:
        words = printable(text("diagnosis_recording.md.j2", title=title, sentence=sentence))
        about = rr.TextDocument(words, media_type="text/markdown")
        recording.log("about", about, static=True)
        for trace in traces:
            own = sorted((w for w in windows if w.trace == trace), key=lambda w: float(w.t[0]))
            _log_trace(recording, _entity(trace), own, measured, inputs)


def _entity(trace: str) -> str:
    return "".join(c if c.isalnum() or c in "_-" else "_" for c in trace)


def _log_trace(
    recording: Any, root: str, windows: Sequence[WindowPrediction], measured: Sequence[str], inputs: Sequence[str]
) -> None:
    t = np.concatenate([w.t for w in windows])
    columns = {side: np.concatenate([getattr(w, side) for w in windows]) for side in ("measured", "before", "after")}
    u = np.concatenate([w.inputs for w in windows])
    held = np.concatenate([np.full(w.t.size, float(w.held_out)) for w in windows])
    plot(recording, f"{root}/never_fitted", t, held, style.YELLOW, 2.5)
    for k, state in enumerate(measured):
        for side, colour, width in _LINES:
            plot(recording, f"{root}/{state}/{side}", t, columns[side][:, k], colour, width)
        for side, colour, width in _LINES[1:]:
            residual = columns["measured"][:, k] - columns[side][:, k]
            plot(recording, f"{root}/residual/{state}/{side}", t, residual, colour, width)
    for j, name in enumerate(inputs):
        plot(recording, f"{root}/input/{name}", t, u[:, j], style.GREEN, 1.5)


def _blueprint(traces: Sequence[str], measured: Sequence[str], inputs: Sequence[str], units: Mapping[str, str]) -> Any:
    """One tab a trace: every state above its residual, the inputs and the windows that were never fitted below."""

    def view(name: str, origin: str) -> Any:
        return rrb.TimeSeriesView(name=name, origin=origin, plot_legend=rrb.PlotLegend(visible=False))

    tabs = []
    for trace in traces:
        root = _entity(trace)
        views = []
        for state in measured:
            label = axis_label(state, units)
            views += [
                view(name=label, origin=f"/{root}/{state}"),
                view(name=f"residual of {label}", origin=f"/{root}/residual/{state}"),
            ]
        if inputs:
            named = axis_label(inputs[0], units) if len(inputs) == 1 else ", ".join(inputs)
            views.append(view(name=f"input {named}", origin=f"/{root}/input"))
        views.append(view(name="1: never fitted, 0: fitted", origin=f"/{root}/never_fitted"))
        tabs.append(rrb.Vertical(*views, row_shares=[*([3.0] * (len(views) - 1)), 1.0], name=printable(trace)))
    curves = rrb.Tabs(*tabs) if len(tabs) > 1 else tabs[0]
    about = rrb.TextDocumentView(name="What this shows", origin="/about")
    return laid_out(rrb.Horizontal(about, curves, column_shares=[1.0, 3.0]))
