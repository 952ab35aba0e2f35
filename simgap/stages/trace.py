"""Stage `trace`: the closed loop as a recording to look at, compared with the table of traces that it was made from."""

from __future__ import annotations

from simgap.io.controller_file import load_controller_of
from simgap.io.rerun.closed_loop import verify, write_recording
from simgap.io.traces import split
from simgap.plants.context import Context
from simgap.report.scene import recording_content
from simgap.stages import log
from simgap.stages.arguments import CasePath, GapAwareController, NominalController, Out, Traces
from simgap.stages.gap_inputs import read_table


def run(
    case_path: CasePath, nominal: NominalController, gap_aware: GapAwareController, traces_path: Traces, out: Out
) -> None:
    """Write the recording of a case and read it back.

    Raises:
        UserError: damaged traces or controllers.
        BrokenPromise: a recording that does not hold what the table holds.
    """
    context = Context.load(case_path)
    with context.blame():
        traces = split(read_table(context, traces_path, "validation"), context.states, context.inputs)
        controllers = (load_controller_of(path, context, whole=False) for path in (nominal, gap_aware))
        content = recording_content(context, traces, *controllers)
    write_recording(out, content)
    count = verify(out, traces, context.states, context.inputs)
    log.info("recorded %d runs; %d values read back and equal to the table", len(traces), count)
