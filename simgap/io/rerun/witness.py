"""A recording of one run that broke a promise: states, inputs, and the gap of every step between its bounds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from simgap.arrays import Floats
from simgap.io import figure_style as style
from simgap.io.rerun.content import curves, finite, root
from simgap.io.rerun.log import line, recording_file, send
from simgap.io.traces import Trace

_LOOK = {"lower": (style.ORANGE, 1.5), "upper": (style.ORANGE, 1.5), "actual": (style.BLUE, 3.0)}


def write_witness(
    path: Path,
    case: str,
    what: str,
    trace: Trace,
    states: Sequence[str],
    inputs: Sequence[str],
    measured: Floats | None = None,
) -> None:
    """Write the recording atomically; `rerun PATH` opens it. `measured` (n, nx) is what the controller saw."""
    import rerun as rr

    with recording_file(path, "simgap", f"simgap-witness-{case}") as recording:
        recording.log("about", rr.TextDocument(f"# {case}\n\n{what}", media_type="text/markdown"), static=True)
        every = [*curves(trace, states, inputs)]
        if measured is not None:
            every += [finite(f"{root(trace)}/measured/{n}", trace.t, measured[:, j]) for j, n in enumerate(states)]
        for entity, t, values in every:
            name = entity.rsplit("/", 1)[-1]
            colour, width = _LOOK.get(name, (style.BLACK, 2.0))
            line(recording, entity, colour, width, name)
            send(recording, entity, t, values)
