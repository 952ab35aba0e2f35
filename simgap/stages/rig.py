"""Stage `rig`: recordings of a stand-in for hardware; no file that a diagnosis reads tells what the rig is made of."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np

from simgap.arrays import Floats
from simgap.config.run import Rig, case_of_rig, load_rig
from simgap.errors import UserError
from simgap.io.results import table, write_parquet
from simgap.late import pyarrow as pa
from simgap.plants.context import Context
from simgap.signals import multisine
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import follow
from simgap.stages import Argument, Out, log


def run(
    rig_path: Annotated[Path, Argument("Rig file (YAML).", "file")], out: Out, engine_log: Path | None = None
) -> None:
    """Move the rig and write what its sensors and its drive recorded.

    Raises:
        UserError: a rig that names states which the case does not have.
    """
    rig = load_rig(rig_path)
    context = Context.load(case_of_rig(rig_path))
    unknown = [name for name in rig.noise if name not in context.states]
    if unknown:
        raise UserError(f"{unknown} are not states", file=rig_path, key="noise", remedy=f"States: {context.states}.")
    case = context.case
    if rig.substeps is not None and case.simulator is not None:
        case = case.model_copy(update={"simulator": case.simulator.model_copy(update={"substeps": rig.substeps})})
    tau = context.domain.tau
    rng = np.random.default_rng(rig.seed)
    t: Floats = np.asarray(tau * np.arange(round(rig.seconds / tau)), dtype=np.float64)
    band = rig.excitation
    commands = [
        np.stack([multisine(t, band.amplitude, band.low, band.high, rng) for _ in context.inputs], axis=1)
        for _ in range(rig.traces)
    ]
    jobs = [(case, [np.zeros(len(context.states))], [u[:-1]]) for u in commands]  # each from rest at the origin
    (paths,) = run_in_processes(follow, [(jobs, context.folder)], log=engine_log)
    parts = [recording(context, rig, k, t, x, u, rng) for k, ((x,), u) in enumerate(zip(paths, commands, strict=True))]
    write_parquet(out, pa.concat_tables(parts))
    log.info("recorded %d traces of %g s", rig.traces, rig.seconds)


def recording(
    context: Context, rig: Rig, number: int, t: Floats, x: Floats, u: Floats, rng: np.random.Generator
) -> pa.Table:
    """One trace: time (n,) s, the measured states with noise, from x (n, nx), the inputs (n, nu)."""
    columns: dict[str, Floats] = {"t": t}
    for name, sigma in rig.noise.items():
        columns[name] = x[:, context.states.index(name)] + rng.normal(0.0, sigma, len(t))
    columns |= {name: u[:, j] for j, name in enumerate(context.inputs)}
    reads = context.record("rig")["reads"]  # hashes alone, and nothing of what it is made of
    record = {"recorded": "rig", "stage": "rig", "reads": reads}
    return table(columns, context.units | {"t": "s"}, {"trace": number}, record)
