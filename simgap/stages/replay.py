"""Stage `replay`: what an audit found, simulated again, as a table and as a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.attack.witness import SIMULATOR as ON_SIMULATOR
from simgap.attack.witness import STEP, Witness
from simgap.closed_loop import GapAudit
from simgap.config.case import Case
from simgap.errors import UserError
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.function import GapFunction
from simgap.gap.bounds.load import from_json
from simgap.geometry import nearest_inputs
from simgap.io.rerun.closed_loop import write_witness
from simgap.io.results import read_json
from simgap.io.traces import GAP_AWARE, MODEL, SIMULATOR, Trace
from simgap.notation import pretty_unit
from simgap.plants.context import Context, pose_axes
from simgap.simulators.body_samples import REST, to_body
from simgap.simulators.process import run_in_processes
from simgap.specifications.space import Space
from simgap.stages import log

SHOWN = 30  # rows of the table; the last ones of longer runs


def run(path: Path, out: Path | None = None, engine_log: Path | None = None) -> str:
    """Simulate a witness again: -> its table; with `out` a recording of it too.

    Raises:
        UserError: a file that is no witness, or the case of which is gone.
    """
    data = read_json(path)
    if "case" not in data or "gap" not in data:
        raise UserError("not a witness", file=path, remedy="Give a witness.json that the audit wrote.")
    context = Context.load(reading.real(path.parent / str(data["case"])))
    context.own(path, data.get("provenance"), "audit")
    witness = Witness.read(data, len(context.states), len(context.inputs))
    gap = from_json(data["gap"])
    states = witness.states
    if witness.plant == ON_SIMULATOR:
        job = (context.case, context.folder, witness)
        states = run_in_processes(simulate, [job], 1, engine_log)[0]
    trace = _trace(context, gap, witness, states)
    if out is not None:
        measured = witness.measured if _measured(witness) else None
        write_witness(out, context.case.name, witness.what, trace, context.states, context.inputs, measured)
        log.info("wrote %s", out)
    return text(context, witness, trace, states)


def simulate(case: Case, folder: Path, witness: Witness) -> Floats:
    """The states of a witness in the simulator, in the engine's process: (k + 1, nx)."""
    from simgap.simulators.rollouts import make_simulator

    with make_simulator(case, folder) as simulator:
        if simulator.remembers and witness.kind == STEP:
            least, largest = simulator.spread(witness.states[:1], witness.inputs[-1:])
            nearer_top = np.abs(witness.d - witness.hi) <= np.abs(witness.d - witness.lo)
            return np.concatenate([witness.states[:1], np.where(nearer_top, largest, least)])
        simulator.reset(witness.states[0])
        return np.array([witness.states[0], *(simulator.advance(u) for u in witness.inputs)])


def _trace(context: Context, gap: GapFunction, witness: Witness, states: Floats) -> Trace:
    """Gap and bound of every step; of a robot that remembers in its own frame, where the bound is tightest."""
    space, u = Space.of(context.case), witness.inputs
    x, following = space.unwound(states[:-1], states[1:])
    d = following - context.plant.sampled.step(x, u)
    if isinstance(gap, BodyFrameGap):
        pose = pose_axes(context)
        m = nearest_inputs(gap.domain.input_set, u)
        lo, hi = gap.bounds_of_inputs(m, np.append(REST, m)[: len(m)])
        d = to_body(d, x[:, pose[2]], pose)
    else:
        lo, hi = gap.bounds(x, u)
    plant, safe = SIMULATOR if witness.plant == ON_SIMULATOR else MODEL, ~GapAudit(d, lo, hi).outside
    return Trace.of((GAP_AWARE, plant, 0), context.domain.tau, states, (u, d, lo, hi), np.append(safe, True))


def text(context: Context, witness: Witness, trace: Trace, states: Floats) -> str:
    """A row a step: time, state, input, and for each state the gap between its bounds; `*` where it is outside."""
    units, rows, measured = context.units, [], _measured(witness)
    names = [f"{n} [{pretty_unit(units[n])}]" for n in (*context.states, *context.inputs)]
    measured_columns = [f"{n} as measured" for n in context.states] if measured else []
    heads = ["step", "t [s]", *names, *measured_columns, *(f"gap in {n}: lower, gap, upper" for n in context.states)]
    count = len(trace.t)
    for k in range(max(0, count - SHOWN), count):
        gaps = [
            "" if np.isnan(trace.d[k, j]) else f"{trace.lo[k, j]:.6g}, {trace.d[k, j]:.6g}, {trace.hi[k, j]:.6g}"
            + ("" if trace.lo[k, j] <= trace.d[k, j] <= trace.hi[k, j] else " *")
            for j in range(len(context.states))
        ]  # fmt: skip
        own = witness.measured[k] if measured else ()
        values = ["" if np.isnan(v) else f"{v:.6g}" for v in (*trace.x[k], *trace.u[k], *own)]
        rows.append([str(k), f"{trace.t[k]:g}", *values, *gaps])
    lines = [f"{context.case.name}: {witness.what}.", *_aligned([heads, *rows])]
    if count > SHOWN:
        lines.insert(1, f"The last {SHOWN} of {count} samples:")
    return "\n".join([*lines, _again(witness, trace, states)])


def _measured(witness: Witness) -> bool:
    """True if what the controller saw of a run is something else than where the plant was."""
    return len(witness.measured) > 0 and not np.array_equal(witness.measured, witness.states, equal_nan=True)


def _aligned(rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in rows]


def _again(witness: Witness, trace: Trace, states: Floats) -> str:
    """Line on how this agrees with what the audit saw."""
    if witness.plant != ON_SIMULATOR:
        return "The states are those that the adversary chose within f + gamma."
    recorded: Any = witness.states if witness.kind != STEP else witness.d
    now = states if witness.kind != STEP else trace.d[-2]
    off = float(np.abs(now - recorded).max()) if np.shape(now) == np.shape(recorded) else np.inf
    outside = int((~trace.safe).sum())
    return (
        f"Simulated again: {outside} step{'' if outside == 1 else 's'} outside gamma; the largest difference from what "
        f"the audit saw is {off:.3g}."
    )
