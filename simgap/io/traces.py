"""Closed-loop traces as one finds them in `traces.parquet`: a run at a time, with states, inputs, gap and its bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.errors import UserError
from simgap.io.results import stack, table
from simgap.late import pyarrow as pa
from simgap.late import pyarrow_compute as pc

SIMULATOR, MODEL = "simulator", "nominal model"
GAP_AWARE, NOMINAL, BASELINE = "gap", "nominal", "baseline"  # the last: the fair baseline
TITLES = {NOMINAL: "nominal-only", GAP_AWARE: "gap-aware"}  # what people read
EVERY_TITLE = {**TITLES, BASELINE: "fair baseline"}


@dataclass(frozen=True, eq=False)
class Trace:
    """One run of one controller on one plant; row k is the sample at `t[k]`.

    Attributes:
        controller: "gap" or "nominal"; plant: "simulator" or "nominal model"; run: the number of its start.
        t: (n,) seconds; x: (n, nx); u: (n, nu) held from there on, NaN in the last row.
        d, lo, hi: (n, nx) gap of the step that starts there and its bound, NaN in the last row.
        safe: (n,) whether the state satisfies the safety part of the specification.
    """

    controller: str
    plant: str
    run: int
    t: Floats
    x: Floats
    u: Floats
    d: Floats
    lo: Floats
    hi: Floats
    safe: Bools

    @staticmethod
    def of(about: tuple[str, str, int], tau: float, x: Floats, steps: Sequence[Floats], safe: Bools) -> Trace:
        """A run of a controller on a plant from a start: samples x (k + 1, nx) and safe (k + 1,) every `tau` s.

        `steps` are u (k, nu), d, lo and hi (k, nx) of the steps between them.
        """

        def padded(values: Floats) -> Floats:
            return np.concatenate([values, np.full((1, values.shape[1]), np.nan)])

        t = np.asarray(tau * np.arange(len(x)), dtype=np.float64)
        u, d, lo, hi = map(padded, steps)
        return Trace(*about, t, x, u, d, lo, hi, safe)

    @property
    def violates(self) -> bool:
        """True if some sample is unsafe."""
        return not bool(self.safe.all())

    @property
    def duration(self) -> float:
        """Time of the last sample, s."""
        return float(self.t[-1])


def split(table: pa.Table, states: Sequence[str], inputs: Sequence[str]) -> list[Trace]:
    """All runs of a table of traces, in its order.

    Raises:
        UserError: a table that lacks columns of traces.
    """
    wanted = ["controller", "plant", "run", "step", "sim_time", *states, *inputs, "safe"]
    missing = [name for name in wanted if name not in table.column_names]
    if missing:
        raise UserError(f"not a table of traces: no column {missing[0]}", remedy="Run the validation stage again.")
    keys = table.select(["controller", "plant", "run"]).group_by(["controller", "plant", "run"], use_threads=False)
    return [_one(table, states, inputs, *row.values()) for row in keys.aggregate([]).to_pylist()]


def _one(table: pa.Table, states: Sequence[str], inputs: Sequence[str], controller: str, plant: str, run: int) -> Trace:
    chosen = pc.and_(pc.equal(table["controller"], controller), pc.equal(table["plant"], plant))
    rows = table.filter(pc.and_(chosen, pc.equal(table["run"], run))).sort_by("step")
    t, x, safe = rows["sim_time"].to_numpy(), stack(rows, states), rows["safe"].to_numpy()
    u = stack(rows, inputs) if inputs else np.empty((rows.num_rows, 0))
    d, lo, hi = (stack(rows, [f"{prefix}_{n}" for n in states]) for prefix in ("gap", "lo", "hi"))
    return Trace(controller, plant, run, t, x, u, d, lo, hi, safe)


def to_table(
    trace: Trace,
    states: Sequence[str],
    inputs: Sequence[str],
    units: Mapping[str, str],
    about: Mapping[str, str],
    record: Mapping[str, Any],
) -> pa.Table:
    """One run as a table, a row a sample; `split` reads it back.

    Args:
        trace: the run; states, inputs, units: names and units of its columns.
        about: the case, the controller and the plant; record: what made it.
    """
    n = len(trace.t)
    columns: dict[str, Any] = {"run": np.full(n, trace.run), "step": np.arange(n), "sim_time": trace.t}
    columns |= {name: trace.x[:, j] for j, name in enumerate(states)}
    columns |= {name: trace.u[:, j] for j, name in enumerate(inputs)}
    for prefix, values in (("gap", trace.d), ("lo", trace.lo), ("hi", trace.hi)):
        columns |= {f"{prefix}_{name}": values[:, j] for j, name in enumerate(states)}
    columns["safe"] = trace.safe
    units = {**units, "sim_time": "s"} | {f"{p}_{name}": units[name] for p in ("gap", "lo", "hi") for name in states}
    return table(columns, units, dict(about), dict(record))


def shown(traces: Sequence[Trace], controller: str) -> Trace:
    """The run of a controller in the simulator that the pictures show.

    Of the nominal-only controller the one that takes longest to violate if there are any that do, so that a reader sees
    how it comes about, and otherwise the one that is cut short most; of another the run from that start. One that
    violates is shown whatever its start, and where a controller has no run from that start, its first.

    Raises:
        UserError: no trace of this controller.
    """
    own = [t for t in traces if t.controller == controller and t.plant == SIMULATOR]
    if not own:
        remedy = "Run the validation stage again."
        raise UserError(f"there is no trace of the {controller} controller in the simulator", remedy=remedy)
    violating = [t for t in own if t.violates]
    if violating:
        return max(violating, key=lambda t: t.duration)
    beside = [t for t in traces if t.controller == NOMINAL and t.plant == SIMULATOR]
    if controller == NOMINAL or not beside:
        return max(own, key=lambda run: cut_short(traces, run))
    number = shown(traces, NOMINAL).run
    return next((t for t in own if t.run == number), own[0])


def first_seconds(chosen: Mapping[str, Trace]) -> float:
    """How much of the runs on display, by controller, is shown enlarged: enough to see the shortest one end, s."""
    durations = [t.duration for t in chosen.values()]
    return max(0.05 * max(durations), min(max(durations), 6.0 * min(durations)))


def cut_short(traces: Sequence[Trace], run: Trace) -> float:
    """Time by which a run ends before the same controller on the nominal model, s; 0 if that was not kept."""
    model = twin(traces, run)
    return 0.0 if model is None else model.duration - run.duration


def twin(traces: Sequence[Trace], of: Trace) -> Trace | None:
    """The run of the same controller from the same start on the nominal model."""
    return next((t for t in traces if (t.controller, t.plant, t.run) == (of.controller, MODEL, of.run)), None)
