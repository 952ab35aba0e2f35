"""Time and memory of synthesis: `python benchmarks/synthesis.py` prints a table and writes results/synthesis.json.

Every row runs in two processes of its own, in each of them twice: the first process finds no machine code of another
(`cold_process_s`, imports and both runs), the other does (`process_s`). `cpu_s` and `wall_s` are those of the second
run in it. Memory is the peak of that process above what it held after importing the package. Where a goal is set, it
stands beside. The robot's rows need the bound of a run, `results/turtlebot/gap/hidden-state/gap.json`.
"""

from __future__ import annotations

import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "benchmarks" / "results" / "synthesis.json"
GAP = ROOT / "results" / "turtlebot" / "gap" / "hidden-state" / "gap.json"
GOALS = {  # CPU s of a warm run
    "(a) pendulum 1600 x 800 x 25": 0.12,
    "(b) unicycle 0.1, 441 inputs, bit_rows": 0.8,
    "robot, with the gap, 9 classes": 10.0,
}

SCOTS_SECONDS = {  # whole process of SCOTS v0.2, -O3, measured on such a machine
    "SCOTS's dcdc": 0.25,
    "SCOTS's vehicle": 2.2,
    "(a) pendulum 1600 x 800 x 25": 5.5,
    "(b) unicycle 0.1, 121 inputs, bit_rows": 30.7,
}
SCOTS_CONVERTER = 593_089, 893_803  # winning cells and pairs that it finds; of the vehicle 48,018 without the target
CONVERTER = {  # the same grid as a case; what a box of cells may reach is then found by simgap, rounded outward
    "name": "converter",
    "plant": {
        "symbolic": {
            "parameters": {name: {"value": value} for name, value in (
                ("vs", 1.0), ("rl", 0.05), ("rc", 0.005), ("ro", 1.0), ("xl", 3.0), ("xc", 70.0))},
            "dynamics": {
                "i": "(vs - (rl + s*ro*rc/(ro + rc))*i - s*ro/(ro + rc)*v/5)/xl",
                "v": "(5*s*ro/(ro + rc)*i - v/(ro + rc))/xc",
            },
        },
        "states": {"i": {"unit": "1"}, "v": {"unit": "1"}},
        "inputs": {"s": {"unit": "1"}},
        "integrator": "rk4",
    },
    "domain": {"tau": 0.5, "X": {"i": [1.14975, 1.55025], "v": [5.44975, 5.85025]}, "U": {"s": {"values": [0, 1]}}},
    "synthesis": {"cells": [801, 801], "specification": {
        "kind": "invariance", "safe": {"i": [1.15, 1.55], "v": [5.45, 5.85]}}},
}  # fmt: skip


def _status(key: str) -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(key):
            return int(line.split()[1]) / 1024
    raise KeyError(key)


def _timed(name: str, run) -> dict[str, object]:
    before = _status("VmRSS")
    run()
    cpu, wall = time.process_time(), time.perf_counter()
    facts = run()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    memory = _status("VmHWM") - before
    goal = {"goal_s": GOALS[name]} if name in GOALS else {}
    goal |= {"scots_process_s": SCOTS_SECONDS[name]} if name in SCOTS_SECONDS else {}
    timed = {"cpu_s": round(cpu, 3), **goal, "wall_s": round(wall, 3), "peak_MiB": round(memory)}
    return {"problem": name, **facts, **timed}


def _pinned_pendulum(number: int) -> dict[str, object]:
    from pinned_problems import PENDULUM, pendulum

    from simgap.synthesis.games.invariance import invariance

    cells = list(PENDULUM)[number]

    def run() -> dict[str, object]:
        found = invariance(pendulum(cells))
        counts = int(found.winning.sum()), found.pairs
        return {"winning": counts[0], "pairs": counts[1], "exact": counts == PENDULUM[cells]}

    return _timed(f"(a) pendulum {cells[0]} x {cells[1]} x 25", run)


def _pinned_unicycle(number: int, backend: str) -> dict[str, object]:
    from pinned_problems import UNICYCLE, unicycle

    from simgap.synthesis.games.reach import reach_avoid

    row = list(UNICYCLE)[number]

    def run() -> dict[str, object]:
        found = reach_avoid(*unicycle(*row), by_rows=backend == "bit_rows")
        counts = int(found.winning.sum()), found.steps
        return {"winning": counts[0], "steps": counts[1], "exact": counts == UNICYCLE[row]}

    return _timed(f"(b) unicycle {row[0]}, {row[1] ** 2} inputs, {backend}", run)


def _hundred_million() -> dict[str, object]:
    from pinned_problems import LAYERS, unicycle

    from simgap.synthesis.controller import least_effort
    from simgap.synthesis.games.reach import reach_avoid

    LAYERS[0.019] = 375
    problem = unicycle(0.019, 21, (9.0, 9.5))
    order = least_effort(problem[0].inputs)

    def run() -> dict[str, object]:
        found = reach_avoid(*problem, order=order)
        winning, chosen = int(found.winning.sum()), int((found.chosen >= 0).sum())
        return {"cells": problem[0].grid.size, "winning": winning, "steps": found.steps, "with_input": chosen}

    return _timed("unicycle 0.019, 441 inputs, bit_rows, one input", run)


def _scots(name: str) -> dict[str, object]:
    import scots_examples

    from simgap.synthesis.games.invariance import invariance
    from simgap.synthesis.games.reach import reach_avoid

    def run() -> dict[str, object]:
        if name == "dcdc":
            safe = invariance(*scots_examples.converter())
            counts = int(safe.winning.sum()), safe.pairs
            return {"winning": counts[0], "pairs": counts[1], "exact": counts == SCOTS_CONVERTER}
        problem = getattr(scots_examples, name)()
        found = reach_avoid(*problem)
        winning = int(found.winning.sum())
        return {"winning": winning, "without_target": winning - int(problem[1].sum()), "steps": found.steps}

    return _timed(f"SCOTS's {name}", run)


def _command() -> dict[str, object]:
    """`simgap synthesis` of the converter, in this process and once."""
    import yaml

    from simgap.cli import main as simgap

    before = _status("VmRSS")
    with tempfile.TemporaryDirectory() as folder:
        case, summary = Path(folder, "converter.yaml"), Path(folder, "summary.json")
        case.write_text(yaml.safe_dump(CONVERTER))
        cpu, wall = time.process_time(), time.perf_counter()
        files = ["--out", f"{folder}/c.npz", "--summary", str(summary), "--log", f"{folder}/log"]
        with suppress(SystemExit):
            simgap(["synthesis", str(case), *files])
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        found = json.loads(summary.read_text())
    facts = {"winning": found["winning_cells"], "pairs": found["statistics"]["pairs"]}
    timed = {"cpu_s": round(cpu, 3), "wall_s": round(wall, 3), "peak_MiB": round(_status("VmHWM") - before)}
    return {"problem": "SCOTS's dcdc as a case, the command", **facts, **timed, "runs": 1}


def _product(gap_kind: str, threads: int) -> dict[str, object]:
    import numpy as np
    import sympy as sp
    from numba import njit

    from simgap.geometry import Box, Grid
    from simgap.model.sampled import NominalModel
    from simgap.synthesis.abstraction.cells import nominal_abstraction
    from simgap.synthesis.games.invariance import invariance

    a, b, u = sp.symbols("x1 x2 u", real=True)
    tau = 0.005
    model = NominalModel((a, b), (u,), (a + tau * b, b - 1.5 * 9.81 * tau * sp.sin(a) + 3 * tau * u), tau)
    inputs = np.round(np.linspace(-1.2, 1.2, 25), 12)[:, None]
    grid = Grid(Box([0, -0.5], [0.2, 0.5]), (800, 800))

    @njit
    def constant(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
        lo[0], lo[1], hi[0], hi[1] = -1.6e-4, -1.3e-4, 1.6e-4, 1.3e-4

    @njit
    def sloped(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
        for i in range(2):
            low = high = 0.0
            for j in range(2):
                c, r = 0.5 * (xlo[j] + xhi[j]), 0.5 * (xhi[j] - xlo[j])
                slope = 0.02 * c + 0.01 * u[0]
                value, spread = 0.01 * c * c + 0.01 * c * u[0], abs(slope) * r + 0.01 * r * r
                low, high = low + value - spread, high + value + spread
            lo[i], hi[i] = 0.01 * low - 1e-5, 0.01 * high + 1e-5

    gaps = {"nominal": (None, None), "constant gap": (constant, ()), "gap in x and u": (sloped, None)}

    def run() -> dict[str, object]:
        found = invariance(nominal_abstraction(model, grid, inputs, *gaps[gap_kind]), threads=threads)
        return {"winning": int(found.winning.sum()), "pairs": found.pairs}

    return _timed(f"pendulum 800 x 800 x 25, {gap_kind}, {threads} threads", run)


def _many_inputs() -> dict[str, object]:
    from pinned_problems import unicycle

    from simgap.synthesis.games.reach import reach_avoid

    problem = unicycle(0.1, 84, (9.0, 9.5))

    def run() -> dict[str, object]:
        found = reach_avoid(*problem)
        return {"winning": int(found.winning.sum()), "steps": found.steps}

    return _timed("(b) unicycle 0.1, 7056 inputs, bit_rows", run)


def _robot(gap: bool) -> dict[str, object]:
    import numpy as np

    from simgap.plants.context import Context
    from simgap.stages.synthesis import pose_problem
    from simgap.synthesis.synthesise import synthesise

    problem, _ = pose_problem(Context.load(ROOT / "configs" / "cases" / "turtlebot.yaml"), GAP if gap else None)

    def run() -> dict[str, object]:
        found = synthesise(problem)
        pairs = int(np.bitwise_count(found.mask).sum())
        return {"winning": int(found.winning.sum()), "steps": found.statistics["steps"], "pairs": pairs}

    return _timed(f"robot, {'with the gap, 9 classes' if gap else 'the nominal model'}", run)


JOBS = [
    *([("_robot", False), ("_robot", True)] if GAP.is_file() else []),
    ("_many_inputs",),
    *[("_pinned_pendulum", k) for k in range(4)],
    *[("_pinned_unicycle", k, "bit_rows") for k in range(4)],
    *[("_pinned_unicycle", k, "table") for k in (0, 1)],
    ("_hundred_million",),
    *[("_scots", name) for name in ("dcdc", "vehicle", "aircraft")],
    ("_command",),
    *[("_product", gap, threads) for gap in ("nominal", "constant gap", "gap in x and u") for threads in (1, 2)],
]


def main() -> None:
    """Run all jobs, those of a name (other rows stay), or one given as JSON: how rows get a process of their own."""
    if len(sys.argv) > 1 and sys.argv[1].startswith("["):
        name, *arguments = json.loads(sys.argv[1])
        print(json.dumps(globals()[name](*arguments)))
        return
    rows = []
    for job in (j for j in JOBS if len(sys.argv) < 2 or j[0] == sys.argv[1]):
        command = [sys.executable, __file__, json.dumps(job)]
        spent = []
        with tempfile.TemporaryDirectory() as empty:  # the first process fills the caches of compiled kernels
            places = {"NUMBA_CACHE_DIR": f"{empty}/code", "XDG_CACHE_HOME": empty}
            for _ in range(2):
                before = resource.getrusage(resource.RUSAGE_CHILDREN)
                done = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ | places)
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                spent.append(round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 2))
        rows.append(json.loads(done.stdout) | {"process_s": spent[1], "cold_process_s": spent[0]})
        print("  ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    machine = {"cores": os.cpu_count(), "platform": platform.platform(), "python": platform.python_version()}
    if len(sys.argv) > 1:
        new = {row["problem"]: row for row in rows}
        kept = [new.pop(row["problem"], row) for row in json.loads(RESULT.read_text())["rows"]]
        rows = [*kept, *new.values()]
    RESULT.write_text(json.dumps({"machine": machine, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
