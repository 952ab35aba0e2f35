"""Stage `trace`: the closed loop as a recording to look at, from the table of traces."""

from __future__ import annotations

from simgap.io.controller_file import load_controller_of
from simgap.io.rerun.closed_loop import write_recording
from simgap.io.traces import split
from simgap.plants.context import Context
from simgap.report.scene import recording_content
from simgap.stages import CasePath, GapAwareController, NominalController, Out, Traces, log
from simgap.stages.gap_inputs import read_table


def run(
    case_path: CasePath, nominal: NominalController, gap_aware: GapAwareController, traces_path: Traces, out: Out
) -> None:
    """Write the recording of a case.

    Raises:
        UserError: damaged traces or controllers.
    """
    context = Context.load(case_path)
    with context.blame():
        traces = split(read_table(context, traces_path, "validation"), context.states, context.inputs)
        controllers = (load_controller_of(path, context, whole=False) for path in (nominal, gap_aware))
        content = recording_content(context, traces, *controllers)
    write_recording(out, content)
    log.info("recorded %d runs", len(traces))
