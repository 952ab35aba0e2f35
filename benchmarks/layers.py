"""Cells of several sizes on the pole on a cart: `python benchmarks/layers.py [CELLS ...]`, cells such as 40x60x40x60.

Prints, for the nominal model alone and, where a run of the case left its bound, with the gap: pairs of node and input
that were asked about, those of all layers and repeated ones included, CPU seconds with machine code there, and the peak
memory of the process, imports and tables included. `engine` is the solver of a case without `synthesis.layers`, which
counts no pairs; `1` is the layered one with one size of cells. Equal means the same cells and inputs, bit for bit.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).parents[1]
CASE = ROOT / "configs" / "cases" / "cart_pole.yaml"
WAYS = ("engine", "1", "2", "3", "4")
SMALL = (8, 8, 8, 8)  # compiles


def _one(cells: list[int], gap: str | None, way: str) -> dict[str, object]:
    from simgap.plants.context import Context
    from simgap.stages.synthesis import pose_problem
    from simgap.synthesis.games.invariance import invariance
    from simgap.synthesis.games.layered import layered_invariance

    problem = pose_problem(Context.load(CASE), None if gap is None else Path(gap))[0]

    def run(abstraction):
        if way == "engine":
            return invariance(abstraction), []
        return layered_invariance(abstraction, int(way))

    run(replace(problem, cells=SMALL).abstraction())
    abstraction = replace(problem, cells=tuple(cells)).abstraction()
    began = time.process_time()
    found, asked = run(abstraction)
    return {
        "model": "nominal" if gap is None else "with gap", "cells": "x".join(map(str, cells)), "layers": way,
        "winning": int(found.winning.sum()), "pairs": found.pairs, "asked": sum(asked), "by_layer": asked,
        "cpu_s": round(time.process_time() - began, 2),
        "peak_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "digest": sha256(found.winning.tobytes() + found.mask.tobytes()).hexdigest()[:12],
    }  # fmt: skip


def main() -> None:
    """All rows, each in a process of its own."""
    if len(sys.argv) > 1 and sys.argv[1].startswith("["):
        print(json.dumps(_one(*json.loads(sys.argv[1]))))
        return
    bounds = [None, *map(str, sorted((ROOT / "results" / "cart_pole" / "gap").glob("*/gap.json")))]
    for cells in sys.argv[1:] or ["40x60x40x60"]:
        for gap in bounds:
            first = None
            for way in WAYS:
                job = json.dumps([[int(c) for c in cells.split("x")], gap, way])
                done = subprocess.run([sys.executable, __file__, job], check=True, capture_output=True, text=True)
                row = json.loads(done.stdout)
                digest = row.pop("digest")
                first = first or digest
                print("  ".join(f"{k} {v}" for k, v in row.items()), f" equal {digest == first}", flush=True)


if __name__ == "__main__":
    main()
