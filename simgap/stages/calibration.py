"""Stage `calibration`: random samples that set the width of a conformal bound, drawn apart from those that check it."""

from __future__ import annotations

from pathlib import Path

from simgap.errors import UserError
from simgap.plants.context import Context
from simgap.stages import CasePath, Out, Workers
from simgap.stages.fresh import Draw, random_samples


def run(case_path: CasePath, out: Out, engine_log: Path | None = None, workers: Workers = 2) -> None:
    """Roll out `gap.conformal.calibration_samples` random pairs, uniform on X x U, and write them.

    Raises:
        UserError: a simulator that remembers earlier inputs, whose steps are not independent draws.
    """
    context = Context.load(case_path)
    section = context.need(context.case.gap, "gap").conformal
    if context.case.hidden_state is not None:
        problem = "a simulator that remembers earlier inputs has no conformal bound: its steps are not independent"
        raise UserError(problem, file=case_path, key="hidden_state")
    wanted = Draw("calibration", section.calibration_samples, section.seed)
    random_samples(context, wanted, out, engine_log, workers)
