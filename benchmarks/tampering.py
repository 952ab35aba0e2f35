"""Certificates that somebody changed, with every sum made anew: whether the checker accepts one that is false.

    python benchmarks/tampering.py [--count 300] [--first 0]

Change number n of a kind of certificate is made from these two alone: one or two of `CHANGES`, of the tables, of the
grid, of the equations or of what is promised, of a task also of its formula, regions, letters and automaton. Eight
kinds: an invariance with its equations, a robot that remembers inputs with boxes of its paths, one without either, a
cart that is to reach a place, with its bound as expressions, and tasks: of the cart to visit two places for ever, to
settle, and to run an errand in time, and of the robot that remembers to visit two places for ever.
The checker reads each whole; `tampering_oracle.py` looks for a point at which it is false. A finding is a certificate
that is accepted and false. What is true after a change (an obstacle taken away) may be accepted.
Results: benchmarks/results/tampering.json.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from tampering_oracle import Oracle

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "benchmarks" / "results" / "tampering.json"
sys.path[:0] = [str(ROOT), str(ROOT / "checker"), str(ROOT / "tests" / "checker")]
DRAWN = 4000  # nodes at which a certificate is tried, beside those whose tables were changed

Head = dict[str, Any]
Tables = dict[str, Any]
Rng = np.random.Generator


def _hex(text: str, factor: float = 1.0, more: float = 0.0) -> str:
    return (float.fromhex(text) * factor + more).hex()


def _some_box(head: Head, rng: Rng) -> dict[str, list[str]]:
    """A target, an obstacle, the safe set, a region or the domain."""
    regions = [part for parts in head.get("regions", {}).values() for part in parts if isinstance(part, dict)]
    every = [*(head[key] for key in ("safe", "domain", "target") if key in head), *head.get("obstacles", []), *regions]
    return every[int(rng.integers(len(every)))]


def _box_moved(head: Head, tables: Tables, rng: Rng) -> None:
    box = _some_box(head, rng)
    name, end = list(box)[int(rng.integers(len(box)))], int(rng.integers(2))
    box[name][end] = _hex(box[name][end], more=float(rng.normal(0, 0.1)))


def _obstacle(head: Head, tables: Tables, rng: Rng) -> None:
    """One more, one less, or other distances."""
    if "obstacles" not in head:
        return _box_moved(head, tables, rng)
    which = int(rng.integers(3))
    if which == 0 and head["obstacles"]:
        head["obstacles"].pop()
    elif which == 1:
        at, name = rng.uniform(0.2, 0.8), head["states"][0]["name"]
        lo, hi = (float.fromhex(head["grid"][end][0]) for end in ("lo", "hi"))
        head["obstacles"].append({name: [(lo + at * (hi - lo)).hex(), (lo + (at + 0.05) * (hi - lo)).hex()]})
    else:
        key = ("clearance", "between", "between_walls")[int(rng.integers(3))]
        name = list(head[key])[int(rng.integers(len(head[key])))]
        head[key][name] = _hex(head[key][name], more=float(abs(rng.normal(0, 0.05))))
    return None


def _grid(head: Head, tables: Tables, rng: Rng) -> None:
    """An end moved, cells exchanged, or an axis that wraps around, the domain with it."""
    grid, j = head["grid"], int(rng.integers(len(head["states"])))
    name, which = head["states"][j]["name"], int(rng.integers(4))
    if which == 0:
        end = ("lo", "hi")[int(rng.integers(2))]
        grid[end][j] = _hex(grid[end][j], more=float(rng.normal(0, 0.05)))
    elif which == 1:
        grid["cells"] = grid["cells"][::-1]
    else:
        grid["periodic"][j] = not grid["periodic"][j]
    head["domain"][name] = [grid["lo"][j], grid["hi"][j]]


def _wrapped(head: Head, tables: Tables, rng: Rng) -> None:
    """An axis wraps around, its domain all of it; where a set is to be kept it is all, and kept with any input."""
    grid, states = head["grid"], [s["name"] for s in head["states"]]
    grid["periodic"][int(rng.integers(len(states)))] = True
    grid["periodic"] = [wraps or bool(rng.integers(2)) for wraps in grid["periodic"]]
    head["domain"] = {s: [a, b] for s, a, b in zip(states, grid["lo"], grid["hi"], strict=True)}
    if "safe" in head:
        head["safe"] = dict(head["domain"])
        tables["winning"][:] = 1
        every = np.ones((len(tables["inputs"]), len(head["input_set"])), bool)
        tables["inputs"][:] = np.packbits(every, axis=1, bitorder="little")


def _place(e: Any, rng: Rng) -> tuple[list[Any], int]:
    """A place within an expression."""
    k = int(rng.integers(1, len(e)))
    return _place(e[k], rng) if isinstance(e[k], list) and rng.random() < 0.8 else (e, k)


def _equations(head: Head, tables: Tables, rng: Rng) -> None:
    """A number, a name or an operation of the map, the bound or the equations."""
    parts = [head[key] for key in ("nominal", "simulator") if head[key]]
    if head["gap"]:
        parts += [head["gap"][s["name"]] for s in head["states"]]
    own = parts[int(rng.integers(len(parts)))]
    name = list(own)[int(rng.integers(len(own)))]
    if not isinstance(own[name], list):
        own[name] = ["+", own[name], float(rng.normal(0, 0.01)).hex()]
        return
    place, k = _place(own[name], rng)
    old = place[k]
    if isinstance(old, str) and old.removeprefix("-").startswith("0x"):
        place[k] = _hex(old, factor=float(rng.choice([0.0, 0.5, 0.9, 1.1, 2.0, -1.0])))
    elif isinstance(old, str):
        names = [v["name"] for v in (*head["states"], *head["inputs"])]
        place[k] = names[int(rng.integers(len(names)))]
    elif place[0] in ("sin", "cos"):
        place[0] = {"sin": "cos", "cos": "sin"}[place[0]]
    else:
        place[k] = ["*", float(rng.choice([0.9, 1.1, -1.0])).hex(), old]


def _inputs(head: Head, tables: Tables, rng: Rng) -> None:
    """Another value of an input, two exchanged, or their bits elsewhere."""
    rows, which = head["input_set"], int(rng.integers(3))
    a, b = (int(v) for v in rng.choice(len(rows), 2, replace=False))
    if which == 0:
        rows[a] = [_hex(v, factor=float(rng.choice([-1.0, 0.8, 1.3])), more=0.02) for v in rows[a]]
    elif which == 1:
        rows[a], rows[b] = rows[b], rows[a]
    else:
        bits = np.unpackbits(tables["inputs"], axis=1, count=len(rows), bitorder="little")
        bits[:, [a, b]] = bits[:, [b, a]]
        tables["inputs"][:] = np.packbits(bits, axis=1, bitorder="little")


def _nodes(head: Head, tables: Tables, rng: Rng) -> None:
    """An input more, no input, or the promise of a cell, at some nodes."""
    count, many = len(head["input_set"]), int(rng.choice([1, 1, 20]))
    rows = rng.choice(len(tables["inputs"]), many, replace=False)
    own = tables.get("levels", tables["winning"]).reshape(-1)
    alive = np.flatnonzero(own > 0)
    which = int(rng.integers(4))
    if which == 0:
        rows = rng.choice(alive, many)
        for node in rows:
            m = int(rng.integers(count))
            tables["inputs"][node, m // 8] |= 1 << (m % 8)
    elif which == 1:
        tables["inputs"][rng.choice(alive, many)] = 0
    elif which == 2:
        own[rows] = 1
        tables["inputs"][rows] = np.packbits(np.ones((many, count), bool), axis=1, bitorder="little")
    else:
        rows = rng.choice(alive, many)
        own[rows], tables["inputs"][rows] = (-1 if "levels" in tables else 0), 0
    if "levels" in tables:
        rest = head["classes"]["at_rest"]
        tables["winning"][:] = tables["levels"][:, rest] >= 0


def _levels(head: Head, tables: Tables, rng: Rng) -> None:
    """Levels of some nodes or of all, or the target's."""
    if "levels" not in tables:
        return _nodes(head, tables, rng)
    level, which = tables["levels"], int(rng.integers(4))
    some = rng.choice(np.flatnonzero(level.reshape(-1) > 0), int(rng.choice([1, 30])))
    if which == 0:
        level.reshape(-1)[some] = np.maximum(1, level.reshape(-1)[some] - rng.integers(1, 4))
    elif which == 1:
        level[level > 1] -= 1
    elif which == 2:
        cells = some // level.shape[1]
        level[cells] = 0
        tables["inputs"].reshape(*level.shape, -1)[cells] = 0
    else:
        level[:] = np.roll(level, 1, axis=0)
    tables["winning"][:] = level[:, head["classes"]["at_rest"]] >= 0
    return None


def _shifted(head: Head, tables: Tables, rng: Rng) -> None:
    """Tables moved by a cell together."""
    by = int(rng.choice([-1, 1, head["grid"]["cells"][-1]]))
    for name, table in tables.items():
        if name in ("winning", "levels", "inputs", "letters"):
            rows = len(table) // len(tables["winning"])
            table[:] = np.roll(table, by * rows, axis=0)


def _memory(head: Head, tables: Tables, rng: Rng) -> None:
    """Classes exchanged or joined, another class at rest, another pose, another bound or path of one class."""
    if "bound" not in tables:
        return _equations(head, tables, rng)
    which, classes = int(rng.integers(6)), head["classes"]
    last = max(classes["of_input"])
    if which == 0 and last:
        classes["of_input"] = [{0: last, last: 0}.get(c, c) for c in classes["of_input"]]
    elif which == 1 and last:
        classes["at_rest"] = (classes["at_rest"] + 1) % (last + 1)
        tables["winning"][:] = tables["levels"][:, classes["at_rest"]] >= 0
    elif which == 2:
        head["pose"] = [head["pose"][k] for k in rng.permutation(3)]
    else:
        name = "swept" if which == 3 and "swept" in tables else "bound"
        own = tables[name][:, int(rng.integers(tables[name].shape[1]))]
        wider = float(rng.choice([0.02, 0.1])) * np.array([-1.0, 1.0])[:, None, None]
        own += wider if which < 5 else float(rng.normal(0, 0.05))
    return None


FORMULAS = (
    "G F right",
    "F G left",
    "G F left & G F right & G slow",
    "F[<= 3 s] right",
    "G !slow",
    "F left",
    "right U left",
)


def _watched(head: Head, tables: Tables, rng: Rng) -> None:
    """An edge, a good move, the state that is done or the letters of the automaton; the formula or what it is about."""
    if "formula" not in head:
        return _levels(head, tables, rng)
    own, which = head["automaton"], int(rng.integers(8))
    q, k = (int(rng.integers(n)) for n in (len(own["step"]), len(own["letters"])))
    if which == 0:
        own["step"][q][k] = int(rng.integers(-1, len(own["step"])))
    elif which == 1:
        own["good"][q][k] = not own["good"][q][k]
    elif which == 2:
        own[("done", "persists")[int(rng.integers(2))]] = int(rng.integers(len(own["step"])))
        own["persists"] = bool(own["persists"])
    elif which == 3:
        region = list(head["regions"])[int(rng.integers(len(head["regions"])))]
        own["letters"][k] = own["letters"][k][1:] if rng.random() < 0.5 else [*own["letters"][k], [region, True]]
    elif which == 4:
        cells = rng.choice(len(tables["letters"]), int(rng.choice([1, 30])))
        tables["letters"][cells] = k
    elif which == 5:
        head["formula"] = FORMULAS[int(rng.integers(len(FORMULAS)))]
    elif which == 6 or len(head["regions"]) == 1:
        head["sampling_time"] = f"{int(rng.integers(1, 9))}/10"
    else:
        a, b = (list(head["regions"])[j] for j in rng.choice(len(head["regions"]), 2, replace=False))
        head["regions"][a], head["regions"][b] = head["regions"][b], head["regions"][a]
    return None


Change = Callable[[Head, Tables, Rng], None]
CHANGES: tuple[Change, ...] = (
    _box_moved, _obstacle, _grid, _wrapped, _equations, _equations, _inputs, _nodes, _nodes, _levels, _levels,
    _shifted, _memory, _memory, _watched, _watched, _watched,
)  # fmt: skip


CART = {
    "cart": {"kind": "reach_avoid", "target": {"x": (1.5, 1.9), "v": (-0.3, 0.3)}},
    "rounds": {"formula": "G F left & G F right & G slow"},
    "settling": {"formula": "F G right"},
    "errand": {"formula": "F[<= 4 s] right & F left"},
}
"""What the cart is asked for."""
PUSHES = np.linspace(-1, 1, 5)[:, None]
REGIONS = {
    "left": {"x": (0.3, 0.6)},
    "right": ({"x": (1.4, 1.5)}, {"x": (1.5, 1.9), "v": (-0.3, 0.3)}),
    "slow": "v^2 <= 0.2",
}


@functools.cache
def _cart() -> tuple[Any, Any, Any]:
    """A cart with drag on a rail: its model, its gap in closed form, and the gap's bound."""
    from simgap.config.gap import GapSection, LipschitzSection
    from simgap.gap.bases import Expressions
    from simgap.gap.bounds.enclosures import ClosedFormGap
    from simgap.geometry import Grid
    from simgap.model.expressions import parse
    from simgap.model.sampled import NominalModel
    from simgap.model.symbolic import symbol
    from tests.gap.fit_in_memory import GapSamples, fit_gap

    names, x, u, grid = ["x", "v", "u"], (symbol("x"), symbol("v")), (symbol("u"),), Grid(_rail(), [20, 12])
    model = NominalModel(x, u, tuple(parse(t, names) for t in ("x + 0.2*v + 0.02*u", "v + 0.2*u")), 0.2)
    equations = [parse(t, names) for t in ("x + 0.2*v + 0.021*u", "v + 0.2*u - 0.03*v*abs(v)")]
    simulator, known = NominalModel(x, u, tuple(equations), 0.2), ClosedFormGap.of(equations, model)
    at, chosen = np.repeat(grid.centres(), 5, axis=0), np.tile(PUSHES, (grid.size, 1))
    d = (simulator.step(at, chosen) - model.step(at, chosen)).reshape(grid.size, 5, 2)
    samples = GapSamples(grid, PUSHES, d, ("x", "v"), ("u",), known=known)
    basis = Expressions(terms=("v", "u", "1"))
    bound = fit_gap(samples, GapSection(basis=basis, lipschitz=LipschitzSection(extreme_value=False))).function
    return model, known, bound


def _rail() -> Any:
    from simgap.geometry import Box

    return Box([0.0, -0.6], [2.0, 0.6])


def cart(asked: dict[str, Any], cells: tuple[int, int] = (60, 36), tau: float = 0.2) -> Any:
    """The cart with a post at the left of its rail, and what it is asked for; deadlines count in `tau`."""
    from simgap.extras.certify import Certified, Reached, target_of
    from simgap.specifications.reaching import ReachAvoid
    from simgap.specifications.space import Space
    from simgap.specifications.task import Task
    from simgap.synthesis.synthesise import SynthesisProblem, synthesise

    model, known, bound = _cart()
    space, around = Space(("x", "v"), _rail(), tau=tau), {"obstacles": ({"x": (0.1, 0.2)},), "clearance": {"x": 0.02}}
    if "formula" in asked:
        task: Any = Task(**{"kind": "task", "regions": REGIONS, **around, **asked})
    else:
        task = ReachAvoid(**asked, **around)
    solution = synthesise(SynthesisProblem(model, task, space, cells, PUSHES, bound.kernel()))
    target = target_of(task, space, solution)
    reached = Reached(target, task.boxes(space), space.vector(task.clearance), np.zeros(2))
    units = {"x": "m", "v": "m/s", "u": "N"}
    return Certified("cart", units, model, bound, known, solution, PUSHES, ["u"], reached)


KINDS = ("invariance", "cart", "robot", "plain robot", "rounds", "settling", "errand", "robot rounds")


def originals(folder: Path, kinds: tuple[str, ...] = KINDS) -> dict[str, Path]:
    """True certificates, small enough to be checked whole."""
    from test_checker import pendulum
    from test_reach import ARENA, ROUNDS, made_of

    from simgap.extras.certify import write_certificate

    make = {
        "invariance": lambda: pendulum(safe={"x1": (-0.1, 0.2)}),
        "robot": lambda: made_of((3, 1), ARENA), "plain robot": lambda: made_of((1, 1), ARENA, swept=False),
        "robot rounds": lambda: made_of((3, 1), ROUNDS),
    } | {kind: functools.partial(cart, asked) for kind, asked in CART.items()}  # fmt: skip
    for kind in kinds:
        write_certificate(folder / kind, make[kind](), {})
    return {kind: folder / kind for kind in kinds}


def tampered(original: Path, folder: Path, rng: Rng) -> tuple[str, np.ndarray]:
    """A changed copy: -> the changes, and the nodes whose tables they changed."""
    from checker_runs import change

    shutil.copytree(original, folder)
    head = json.loads((folder / "certificate.json").read_text())
    before = {Path(name).stem: np.load(folder / name) for name in head["files"]}
    tables, names = {name: table.copy() for name, table in before.items()}, []
    for k in rng.choice(len(CHANGES), int(rng.choice([1, 1, 2]))):
        CHANGES[k](head, tables, rng)
        names.append(CHANGES[k].__name__.strip("_"))
    change(folder, lambda own: own.update({k: v for k, v in head.items() if k not in ("files", "digest")}), **tables)
    classes = len(tables["inputs"]) // len(tables["winning"])
    rows = np.flatnonzero((tables["inputs"] != before["inputs"]).any(axis=1))
    for name in tables.keys() & {"levels", "winning", "letters"}:
        rest = np.flatnonzero((tables[name] != before[name]).reshape(-1))
        rows = np.concatenate([rows, rest if name == "levels" else rest * classes])
    return " and ".join(names), rows


def judged(folder: Path, changed: np.ndarray, rng: Rng) -> tuple[int, str | None, str]:
    """Exit status of the checker, what the oracle finds false, and what the checker said."""
    import check

    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        status = check.main([str(folder), "--exact", "20"])
    if status == 2:
        return status, None, said.getvalue()
    with np.errstate(all="ignore"):
        oracle = Oracle(folder)
        some = rng.integers(oracle.level.size, size=DRAWN)
        return status, oracle.refuted(rng, np.concatenate([some, changed[:DRAWN]])), said.getvalue()


def attack(kinds: dict[str, Path], numbers: range, say: Callable[[str], None] = print) -> list[dict[str, Any]]:
    """Every change of these numbers, the kinds in turn: -> a row each."""
    rows = []
    for n in numbers:
        kind = list(kinds)[n % len(kinds)]
        rng = np.random.default_rng([n, list(kinds).index(kind)])
        with tempfile.TemporaryDirectory() as name:
            changes, nodes = tampered(kinds[kind], Path(name) / "copy", rng)
            status, false, _ = judged(Path(name) / "copy", nodes, rng)
        word = ("accepted", "rejected", "unreadable")[status]
        rows.append({"number": n, "kind": kind, "changes": changes, "checker": word, "false": false})
        say(f"{n:4d} {kind:12s} {word:10s} {changes}: {false or '-'}")
    return rows


def main() -> None:
    """Attack, count, and end with status 1 after a finding."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--count", type=int, default=300)
    asked.add_argument("--first", type=int, default=0)
    given = asked.parse_args()
    began = time.process_time()
    with tempfile.TemporaryDirectory() as name:
        kinds = originals(Path(name))
        for kind, folder in kinds.items():
            status, false, said = judged(folder, np.arange(0), np.random.default_rng(0))
            if status or false:
                sys.exit(f"{kind}: the true certificate is not accepted, or is false: {false}\n{said}")
        rows = attack(kinds, range(given.first, given.first + given.count), lambda text: print(text, flush=True))
    findings = [row for row in rows if row["checker"] == "accepted" and row["false"]]
    counts = Counter((row["kind"], row["checker"], "false" if row["false"] else "not refuted") for row in rows)
    for row in findings:
        print("FINDING", row)
    content = {
        "changes": len(rows), "findings": findings, "cpu_s": round(time.process_time() - began),
        "counts": {" / ".join(key): counts[key] for key in sorted(counts)},
    }  # fmt: skip
    print(json.dumps(content, indent=1))
    if given.first == 0 and given.count >= 300:
        RESULT.write_text(json.dumps(content, indent=1) + "\n")
    sys.exit(1 if findings else 0)


if __name__ == "__main__":
    main()
