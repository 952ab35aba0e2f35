"""Queries of `check` to the engine, in a process of its own: what it made of the file, how fast it steps."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simgap import plugins, reading
from simgap.config.case import Case
from simgap.config.model_files import places_of
from simgap.errors import Finding, UserError
from simgap.lint.wheels import Drive, driven_as_told, drives
from simgap.plants.context import Context
from simgap.plants.model_file import Link, ModelFile, read_model_file
from simgap.simulators.base import Engine
from simgap.simulators.findings import model_file_findings
from simgap.simulators.process import run_in_processes

TRIED, FEWEST, TOGETHER = 0.2, 15, 10_000
"""Seconds for which the engine is timed, how many roll-outs it makes, unless they take ten times as long, and how many
of them it is asked for at once, as the stages ask."""


def of_engine(
    context: Context, file: ModelFile | None, engine_log: Path | None = None
) -> tuple[list[Finding] | None, float | None]:
    """Findings about the model file, None where no engine loads one, and the seconds of a roll-out."""
    case = context.case
    if case.simulator is None or case.domain is None:
        return None, None
    kind = plugins.find("engines", case.simulator.engine, context.folder)
    rng = np.random.default_rng(0)
    x = context.box.sample(rng, 100)
    values = [case.domain.U[name].list() for name in context.inputs]
    u = np.stack([rng.choice(own, len(x)) for own in values], axis=1) if values else np.zeros((len(x), 0))
    ((loaded, seconds, own, driven),) = run_in_processes(_query_engine, [(case, context.folder, x, u)], log=engine_log)
    if own is not None:
        return own, seconds
    traits = kind.file_traits if issubclass(kind, Engine) else None
    if file is None or traits is None:
        return None, seconds
    return [*model_file_findings(case, traits, file, loaded), *driven_as_told(context, driven)], seconds


def _query_engine(
    case: Case, folder: Path, x: Any, u: Any
) -> tuple[Mapping[str, Link], float, list[Finding] | None, list[Drive]]:
    """As `ask_engine`, what the engine says of a file in its own format, and how a wheeled robot drives."""
    from simgap.simulators.rollouts import findings

    return *ask_engine(case, folder, x, u), findings(case, folder), drives(case, folder)


def ask_engine(case: Case, folder: Path, x: Any, u: Any) -> tuple[Mapping[str, Link], float]:
    """In the engine's process: its links, and the seconds of a roll-out from states (n, nx) under inputs (n, nu)."""
    from simgap.simulators.rollouts import make_simulator

    with make_simulator(case, folder) as simulator:
        simulator.rollouts(x[:1], u[:1])  # at the first of them a person's code is tried, which takes longer
        count, size, passed, used, least = 0, 1, 0.0, 0.0, math.inf
        while passed < TRIED or (count < FEWEST and passed < 10 * TRIED):
            rows = np.arange(count, count + size) % len(x)
            own, began, cpu = (x[rows], u[rows]), time.perf_counter(), time.process_time()
            simulator.rollouts(*own)
            cpu, took = time.process_time() - cpu, time.perf_counter() - began
            count, passed, used, least = count + size, passed + took, used + cpu, min(least, took / size)
            size = min(2 * size, TOGETHER) if took < TRIED / 10 else size
        # CPU time on a busy machine is much less than the time that passes; an engine may also wait for something.
        return simulator.loaded(), max(used / count, least)


def model_file(context: Context) -> ModelFile | None:
    """The file that the simulator loads, its meshes there; the nominal model's where there is no simulator."""
    section, own = context.case.simulator, context.case.plant.urdf
    files = [name for name in (own, section.urdf if section is not None else None) if name is not None]
    read = [read_model_file(context.folder / name) for name in files]
    for file in read:
        for mesh in file.meshes:
            if mesh.startswith("package://"):
                continue  # found through the paths of a ROS installation, if at all
            if not any(map(reading.is_file, places_of(file.path, mesh))):
                raise UserError(
                    "the mesh does not exist", file=file.path, key=f"mesh '{mesh}'", remedy="Correct its path."
                )
    return read[-1] if read else None
