"""Roll-outs of one sampling time; each function runs in the engine's own process."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case

Range = tuple[Floats, Floats]


def roll_out(case: Case, folder: Path, x: Floats, u: Floats) -> tuple[Floats, str]:
    """Successors of states (n, nx) under inputs (n, nu), and the engine's name."""
    from simgap.simulators.build import make_simulator

    simulator = make_simulator(case, folder)
    try:
        return simulator.rollouts(x, u), simulator.engine
    finally:
        simulator.close()


def roll_out_range(case: Case, folder: Path, x: Floats, u: Floats) -> tuple[Floats, Range | None, str]:
    """`roll_out`, and where delayed or lagged inputs spread the successors their range, two (n, nx)."""
    from simgap.simulators.build import make_simulator

    simulator = make_simulator(case, folder)
    try:
        spread = simulator.spread(x, u) if simulator.remembers else None
        return simulator.rollouts(x, u), spread, simulator.engine
    finally:
        simulator.close()


def follow(jobs: Sequence[tuple[Case, Sequence[Floats], Sequence[Floats]]], folder: Path) -> list[list[Floats]]:
    """For each case the paths (k + 1, nx) from its starts (nx,) under its inputs (k, nu)."""
    from simgap.simulators.build import make_simulator

    every = []
    for case, starts, inputs in jobs:
        simulator = make_simulator(case, folder)
        try:
            paths = []
            for start, u in zip(starts, inputs, strict=True):
                simulator.reset(start)
                paths.append(np.stack([start, *(simulator.advance(row) for row in u)]))
            every.append(paths)
        finally:
            simulator.close()
    return every
