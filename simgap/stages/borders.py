"""Stage `borders`: the simulator on the border of X and beside switching surfaces, where random states never lie."""

from __future__ import annotations

from pathlib import Path

from simgap.gap.noise import draws_at
from simgap.gap.sampling.borders import border_states, parts_of, roll_out_borders
from simgap.gap.sampling.points import covering_grid, own_point
from simgap.plants.context import Context
from simgap.simulators.process import run_in_processes
from simgap.stages import CasePath, Out, Point, log
from simgap.stages.gap_inputs import write_rollouts


def run(case_path: CasePath, point: Point, out: Out, engine_log: Path | None = None) -> None:
    """Roll out the states of a point (the case's own if none is named) and write them.

    Raises:
        UserError: a case without simulator or with a hidden state, a point that it does not have.
    """
    context = Context.load(case_path)
    with context.blame():
        name = point or own_point(context.case)
        states = {part: border_states(context, name, part).x for part in parts_of(context)}
        places = covering_grid(context.case, context.box, name).size * len(context.input_set)
        job = (context.case, context.folder, states, context.input_set, draws_at(context.case, places))
        ((columns, engine),) = run_in_processes(roll_out_borders, [job], log=engine_log)
    section = context.need(context.case.gap, "gap")
    write_rollouts(context, out, "borders", columns, engine, {"lattice": section.seed}, point=name)
    counts = ", ".join(f"{len(x)} for the {part}" for part, x in states.items())
    log.info("wrote %d roll-outs on borders and beside switching surfaces (states: %s)", len(columns["part"]), counts)
