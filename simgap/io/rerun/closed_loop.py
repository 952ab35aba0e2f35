"""The closed loop as a Rerun recording: both controllers' traces on one time line, in 3-D and as curves.

Entities, over the timeline `sim_time`:

    /runs/<controller>/<plant>/run-<k>/state/<state>              as in traces.parquet, every kept run
    /runs/<controller>/<plant>/run-<k>/input/<input>
    /runs/<controller>/<plant>/run-<k>/gap/<state>/{actual,lower,upper}
    /shown/<controller>/...       what is derived from the run on display: share of the bound, value function, events
    /scene/...                    the 3-D scene        /phase/...    winning domains with the runs in them
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.io import figure_style as style
from simgap.io.figure_style import COLOURS
from simgap.io.rerun.blueprint import blueprint
from simgap.io.rerun.content import SERIES, Content, curves, finite, share_of_bound
from simgap.io.rerun.log import TIMELINE, line, recording_file, send
from simgap.io.rerun.phase import log_phase
from simgap.io.rerun.scene import log_scene
from simgap.io.traces import SIMULATOR, TITLES, Trace, twin
from simgap.synthesis.controller import Controller


def write_recording(path: Path, content: Content) -> None:
    """Write the recording with its blueprint, atomically."""
    import rerun as rr

    with recording_file(path, "simgap", f"simgap-{content.case}", blueprint(content)) as recording:
        recording.log("about", rr.TextDocument(content.about, media_type="text/markdown"), static=True)
        for trace in content.traces:
            for entity, t, values in curves(trace, content.states, content.inputs):
                _style(recording, entity, trace)
                send(recording, entity, t, values)
        for controller, trace in content.shown.items():
            _log_shown(recording, content, controller, trace)
        _log_limits(recording, content)
        log_phase(recording, content)
        log_scene(recording, content)


def _style(recording: Any, entity: str, trace: Trace) -> None:
    colour = COLOURS[trace.controller] if trace.plant == SIMULATOR else style.GREY
    plant = "simulator" if trace.plant == SIMULATOR else "model"
    last = entity.rsplit("/", 1)[-1]
    if last in ("lower", "upper"):
        line(recording, entity, style.ORANGE, 1.5, f"{TITLES[trace.controller]}, {last} bound")
    else:
        width = 3.5 if last == "actual" else 2.0 if plant == "simulator" else 1.3
        line(recording, entity, colour, width, f"{TITLES[trace.controller]}, {plant}")


def _log_shown(recording: Any, content: Content, controller: str, trace: Trace) -> None:
    """The share of the bound, the value function and what happened, of the run on display."""
    import rerun as rr

    share = share_of_bound(trace)
    for j, name in enumerate(content.states):
        entity, t, values = finite(f"shown/{controller}/share/{name}", trace.t, share[:, j])
        line(recording, entity, SERIES[j % len(SERIES)][0], 2.0, name)
        send(recording, entity, t, values)
    policy = content.controllers[controller]
    if policy.solution.value is not None:
        line(recording, f"shown/{controller}/value", COLOURS[controller], 2.0, TITLES[controller])
        t, steps = steps_to_target(policy, trace)
        send(recording, f"shown/{controller}/value", t, steps)
    for when, text, level in events(content, controller, trace):
        recording.set_time(TIMELINE, duration=when)
        recording.log(f"shown/{controller}/events", rr.TextLog(text, level=level))
    recording.reset_time()


def steps_to_target(policy: Controller, trace: Trace) -> tuple[Floats, Floats]:
    """The value function along a run: times and steps, (n,) each, without the last where no pending input is known."""
    if not policy.late:
        return trace.t, policy.value(trace.x).astype(np.float64)
    pending = np.argmin(np.abs(policy.input_set[None] - trace.u[:-1, None]).sum(axis=2), axis=1)
    return trace.t[:-1], policy.value(trace.x[:-1], pending).astype(np.float64)


def events(content: Content, controller: str, trace: Trace) -> list[tuple[float, str, str]]:
    """Time, text and level of what a viewer should notice about a run."""
    title = TITLES[controller]
    out = [(0.0, f"{title}: run {trace.run} starts", "INFO")]
    if trace.violates:
        first = int(np.flatnonzero(~trace.safe)[0])
        t, x = float(trace.t[first]), trace.x[first]
        where = ", ".join(f"{n} = {v:.4g}" for n, v in zip(content.states, x, strict=True))
        out.append((t, f"{title}: the simulator is unsafe at {where}", "ERROR"))
    elif content.controllers[controller].in_target(trace.x[-1:])[0]:
        arrived = float(trace.t[content.controllers[controller].in_target(trace.x)][0])
        out.append((arrived, f"{title}: target reached after {arrived:g} s", "INFO"))
    elif content.controllers[controller].solution.target is not None:
        out.append((trace.duration, f"{title}: ends without reaching the target", "WARN"))
    else:
        out.append((trace.duration, f"{title}: safe at all {len(trace.t)} samples", "INFO"))
    model = twin(content.traces, trace)
    if model is not None and not model.violates and model.duration < trace.duration:
        out.append((model.duration, f"{title}, run on the nominal model: ends without an admissible input", "WARN"))
    elif model is not None and model.violates:
        out.append((model.duration, f"{title}, run on the nominal model: unsafe", "WARN"))
    return sorted(out)


def _log_limits(recording: Any, content: Content) -> None:
    """The safe set beside the states, and +-1 beside the share of the bound."""
    ends = np.array([0.0, max(t.duration for t in content.shown.values())])
    for j, name in enumerate(content.states):
        for side, value in (("lowest", content.safe.lo[j]), ("highest", content.safe.hi[j])):
            if np.isfinite(value):
                line(recording, f"safe_set/{name}/{side}", style.GREEN, 1.5, f"safe set, {side}")
                send(recording, f"safe_set/{name}/{side}", ends, np.full(2, value))
    for side, value in (("lower", -1.0), ("upper", 1.0)):
        line(recording, f"bound/{side}", style.ORANGE, 1.5, f"{side} bound")
        send(recording, f"bound/{side}", ends, np.full(2, value))
