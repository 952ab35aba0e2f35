"""Hostile and damaged inputs: each is made from its kind and number alone, and read as simgap reads it."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hostile.cases import ROOT, read_altered_case, read_case, read_expression, read_urdf
from hostile.commands import read_command
from hostile.recordings import CSV, read_csv, read_json, read_parquet
from hostile.results import read_controller, read_gap, read_result, read_table


def prepare(folder: Path) -> None:
    """The files that inputs stand beside."""
    from simgap.geometry import Box, Grid
    from simgap.io.controller_file import save_controller
    from simgap.specifications.solution import Solution
    from simgap.synthesis.controller import Controller

    (folder / "cases").mkdir(parents=True, exist_ok=True)
    (folder / "models").mkdir(exist_ok=True)
    for path in (ROOT / "configs/models").glob("*.urdf"):
        (folder / "models" / path.name).write_bytes(path.read_bytes())
    (folder / "broken.yaml").write_text("name: broken\nplant: {states: 3}\n")
    (folder / "run.csv").write_text(CSV)
    grid = Grid(Box(np.zeros(2), np.ones(2)), [4, 4], [])
    won = np.arange(16) % 3 > 0
    mask = np.where(won, 3, 0).astype(np.uint8)[:, None]
    solution = Solution(grid=grid, winning=won, mask=mask, free=np.ones(16, bool), statistics={"rounds": 1})
    law = Controller(np.array([[0.0], [1.0]]), ("x", "v"), ("u",), solution, "least_effort", {"case": "c"})
    save_controller(law, folder / "whole.npz")


KINDS: Mapping[str, tuple[int, Callable[[random.Random, Path], None]]] = {
    "case files, damaged": (20_000, read_case),
    "case files, altered values": (20_000, read_altered_case),
    "expressions": (60_000, read_expression),
    "URDFs": (20_000, read_urdf),
    "CSV recordings": (15_000, read_csv),
    "Parquet recordings": (15_000, read_parquet),
    "JSON recordings": (15_000, read_json),
    "JSON results": (20_000, read_result),
    "tables of results": (15_000, read_table),
    "gap bounds": (10_000, read_gap),
    "controllers": (10_000, read_controller),
    "command lines": (5_000, read_command),
}
"""For each kind how many inputs, and what makes one of a number and reads it."""
