"""A certificate: what a controller promises and why, in plain files that `checker/` verifies without this package.

Its expressions are lists [operation, argument, ...] that any program can read, a number the hexadecimal form of a
double ('0x1.8p+0') or a fraction of integers ('1/3'); `docs/how-to/certificate.md` describes the form.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap import reading
from simgap.arrays import Floats, Ints
from simgap.errors import UserError, placed
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.enclosures import ClosedFormGap
from simgap.gap.bounds.function import GapFunction
from simgap.gap.bounds.linear import Form, LinearGap
from simgap.gap.sampling.points import own_point, remembers
from simgap.gap.sampling.samples import known_gap
from simgap.geometry import Box
from simgap.io.atomic import atomic
from simgap.io.controller_file import load_controller_of
from simgap.io.gap_file import SavedGap, load_gap
from simgap.late import sympy as sp
from simgap.model.sampled import NominalModel
from simgap.plants.context import Context
from simgap.specifications.base import specification_of
from simgap.specifications.formula import Automaton, parse, regions
from simgap.specifications.invariance import Invariance
from simgap.specifications.reaching import ReachAvoid
from simgap.specifications.solution import Solution
from simgap.specifications.space import KEY, Space, partial_box
from simgap.specifications.task import Task, inequality
from simgap.stages import log
from simgap.stages.synthesis import pose_problem

FORMAT, VERSION = "simgap certificate", 1
HEADER, INPUTS, WINNING, LEVELS = "certificate.json", "inputs.npy", "winning.npy", "levels.npy"
LETTERS, BOUND, SWEPT = "letters.npy", "bound.npy", "swept.npy"
BETWEEN = "What happens between two sampling instants: a certificate is about the states at them."
BLACK_BOX = (
    "That the bound of the gap holds for the simulator, which is a black box: the certificate takes it as stated, with "
    "the guarantee that stands in its header."
)
PATH = (
    "That the path of each step stays in the stated box, seen from the body: it is measured in the simulator, like the "
    "bound of the gap."
)
STRAY = "That a path strays from its samples by no more than the stated distances."
CLOCK = "That samples are the stated time apart, in which deadlines are counted."
HARDWARE = "That the simulator, or its equations, describe the real plant."


@dataclass(frozen=True, eq=False)
class Watched:
    """A formula over regions, and the automaton with which a controller watches over it.

    Attributes:
        formula: as the case has it; tau: the sampling time, s.
        regions: by name boxes, infinite along states that do not matter, and expressions, not positive inside.
        automaton: over the letters whose numbers are `letters` (cells,).
    """

    formula: str
    tau: float
    regions: Mapping[str, Sequence[Box | sp.Expr]]
    automaton: Automaton
    letters: Ints


@dataclass(frozen=True, eq=False)
class Reached:
    """Target that is to be reached, or task that is to be kept, and obstacles that are to be avoided.

    Attributes:
        target, obstacles: boxes over all states, infinite along those that they do not bound.
        clearance: what to keep from obstacles and walls, (nx,); between: how far a path may stray from its samples
            where there are no swept boxes, (nx,), or (2, nx): from obstacles, and from walls.
        pose: axes of x, y and heading of a body in the plane.
        swept: lower and upper ends of the box in which each path lies, by class of the previous input, (C, M, 2) each.
    """

    target: Box | Watched
    obstacles: Sequence[Box]
    clearance: Floats
    between: Floats
    pose: tuple[int, int, int] | None = None
    swept: tuple[Floats, Floats] | None = None


@dataclass(frozen=True, eq=False)
class Certified:
    """Content of a certificate.

    Attributes:
        case: its name. units: by state and input.
        model: the nominal map; bound: of its gap; known: the gap in closed form, None for a black box.
        solution: cells, winning domain, admissible inputs; input_set: U, (M, nu); input_names: in order.
        task: the box in which an invariance stays, or what is to be reached.
    """

    case: str
    units: Mapping[str, str]
    model: NominalModel
    bound: GapFunction
    known: ClosedFormGap | None
    solution: Solution
    input_set: Floats
    input_names: Sequence[str]
    task: Box | Reached


def write_certificate(folder: Path, what: Certified, record: Mapping[str, Any]) -> dict[str, Any]:
    """Write header and tables; `record` says what made them. Returns the header.

    Raises:
        UserError: what this version of the form does not cover.
    """
    with placed(key="plant"):
        head = header(what)
    folder.mkdir(parents=True, exist_ok=True)
    files = {name: _write_table(folder / name, table) for name, table in tables(what).items()}
    head |= {"files": files, "provenance": dict(record)}
    head["digest"] = digest(head)
    with atomic(folder / HEADER) as temporary:
        Path(temporary).write_text(json.dumps(head, indent=1) + "\n")
    return head


def tables(what: Certified) -> dict[str, NDArray[Any]]:
    """Arrays by file name."""
    s = what.solution
    found: dict[str, NDArray[Any]] = {INPUTS: s.admitted(len(what.input_set)), WINNING: s.winning.astype(np.uint8)}
    if s.value is not None:
        found[LEVELS] = s.value.reshape(-1, s.memory)
    if isinstance(what.task, Reached) and isinstance(what.task.target, Watched):
        found[LETTERS] = what.task.target.letters.astype(np.int32)
    if isinstance(what.bound, BodyFrameGap):
        found[BOUND] = np.stack([what.bound.class_lower, what.bound.class_upper])
    if isinstance(what.task, Reached) and what.task.swept is not None:
        found[SWEPT] = np.stack(what.task.swept)
    return found


def header(what: Certified) -> dict[str, Any]:
    """Everything but the tables.

    Raises:
        UserError: a bound, a memory or an expression that the form does not cover.
    """
    solution, model, bound, task = what.solution, what.model, what.bound, what.task
    reached = task if isinstance(task, Reached) else None
    if (solution.value is None) != (reached is None) or solution.late or (reached is None and solution.memory != 1):
        raise UserError(
            "a certificate covers invariance, reach-while-avoid and tasks without latency, and this controller is "
            "for something else",
            key="synthesis.specification",
            remedy="The closed loop and the audit are what checks it.",
        )
    if not isinstance(bound, LinearGap) and (reached is None or not isinstance(bound, BodyFrameGap)):
        problem = "a certificate covers bounds that are linear in a basis, and this one is not"
        raise UserError(problem, key="gap.basis", remedy="Use a basis of terms.")
    states, grid, known = bound.domain.states, solution.grid, what.known
    not_covered = [HARDWARE] if known is not None else [BLACK_BOX, HARDWARE]
    watched = reached.target if reached is not None and isinstance(reached.target, Watched) else None
    if watched is not None and "[" in watched.formula:
        not_covered.append(CLOCK)
    for j in sorted(grid.periodic):
        same = f"That states {grid.box.hi[j] - grid.box.lo[j]:g} apart along {states[j]} are one and the same"
        not_covered.append(same + (", and the black box repeats itself so." if known is None else "."))
    return {
        "format": FORMAT,
        "version": VERSION,
        "kind": "invariance" if reached is None else "reach_avoid" if watched is None else "task",
        "case": what.case,
        "states": [{"name": s, "unit": what.units[s]} for s in states],
        "inputs": [{"name": u, "unit": what.units[u]} for u in what.input_names],
        "grid": {
            "lo": _hex(grid.box.lo),
            "hi": _hex(grid.box.hi),
            "cells": list(grid.cells),
            "periodic": [j in grid.periodic for j in range(grid.box.size)],
        },
        "input_set": [_hex(row) for row in what.input_set],
        "domain": _named(states, bound.domain.box),
        "nominal": dict(zip(states, map(prefix, model.f), strict=True)),
        "gap": _sides(bound) if isinstance(bound, LinearGap) else None,
        "simulator": dict(zip(states, map(prefix, known.simulator), strict=True)) if known else None,
        "guarantee": [tier.text for tier in bound.tiers],
        "not_covered": [_between(reached), *not_covered],
    } | ({"safe": _named(states, task)} if isinstance(task, Box) else _reached(states, task, what))


def _between(reached: Reached | None) -> str:
    if reached is None:
        return BETWEEN
    return STRAY if reached.swept is None else PATH


def _reached(states: Sequence[str], task: Reached, what: Certified) -> dict[str, Any]:
    """Target, obstacles, and what the controller remembers."""
    kind, first = what.solution.kind, what.solution.first
    of_input = np.zeros(len(what.input_set), np.int64) if kind is None else kind
    obstacles, walls = np.broadcast_to(task.between, (2, len(states)))
    return {
        **(
            _watched(states, task.target)
            if isinstance(task.target, Watched)
            else {"target": _named(states, task.target)}
        ),
        "obstacles": [_named(states, box) for box in task.obstacles],
        "clearance": dict(zip(states, _hex(task.clearance), strict=True)),
        "between": dict(zip(states, _hex(obstacles), strict=True)),
        "between_walls": dict(zip(states, _hex(walls), strict=True)),
        "pose": None if task.pose is None else [states[j] for j in task.pose],
        "classes": {"of_input": of_input.tolist(), "at_rest": first},
    }


def _watched(states: Sequence[str], task: Watched) -> dict[str, Any]:
    """Formula, regions and automaton.

    Raises:
        UserError: a deadline or an inequality that the form does not have.
    """
    for bound in re.findall(r"\[\s*<=\s*([^\]]*?)\s*\]", task.formula):
        if not re.fullmatch(r"(\d{1,9}(\.\d{0,9})?|\.\d{1,9})( +(s|ms|min|h))?", bound, re.ASCII):
            remedy = "Write digits, at most nine of them, and s, ms, min or h."
            raise UserError(f"a certificate has no deadline '{bound}'", key=f"{KEY}.formula", remedy=remedy)
    odd = [name for name in task.regions if not name.isascii()]
    if odd:
        remedy = "Use the letters a to z."
        raise UserError(f"a certificate has no region '{odd[0]}'", key=f"{KEY}.regions", remedy=remedy)
    parts = {}
    for name, region in task.regions.items():
        with placed(key=f"{KEY}.regions.{name}"):
            parts[name] = [_named(states, part) if isinstance(part, Box) else prefix(part) for part in region]
    watch = task.automaton
    return {
        "formula": task.formula,
        "sampling_time": fraction(Fraction(repr(task.tau))),
        "regions": parts,
        "automaton": {
            "letters": [sorted(map(list, letter)) for letter in watch.letters],
            "step": watch.step.tolist(),
            "good": watch.good.tolist(),
            "done": watch.done,
            "persists": watch.persists,
        },
    }


def _named(states: Sequence[str], box: Box) -> dict[str, list[str]]:
    """Ends along the states that a box bounds."""
    ends = zip(states, np.stack([box.lo, box.hi], axis=1), strict=True)
    named = {s: own for s, own in ends if np.isfinite(own).any()}
    for s, own in named.items():
        if not np.isfinite(own).all():
            raise UserError(f"a box that is open to one side only along {s} has no place in a certificate")
    return {s: _hex(own) for s, own in named.items()}


def _sides(bound: LinearGap) -> dict[str, Any]:
    sides = zip(bound.domain.states, bound.lower, bound.upper, strict=True)
    return {s: {"lower": _form(lo), "upper": _form(hi)} for s, lo, hi in sides}


def digest(head: Mapping[str, Any]) -> str:
    """SHA-256 of the header without the key `digest`, as compact JSON with sorted keys."""
    rest = {key: value for key, value in head.items() if key != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _form(form: Form) -> Any:
    """q.p + offset with the coefficients that the bound has."""
    terms = [
        ["*", float(q).hex(), prefix(e)] for q, e in zip(form.coefficients, form.basis.exprs, strict=True) if q != 0.0
    ]
    return ["+", float(form.offset).hex(), *terms]


def _hex(values: Floats) -> list[str]:
    return [float(v).hex() for v in values]


def _write_table(path: Path, table: NDArray[Any]) -> str:
    """Write an array as .npy: -> SHA-256 of the file."""
    with atomic(path) as temporary:
        with Path(temporary).open("wb") as stream:
            np.lib.format.write_array(stream, np.ascontiguousarray(table), allow_pickle=False)
        return reading.sha256(temporary)


def run(case_path: Path, gap: Path, controller_path: Path, out: Path) -> None:
    """Export cells, admissible inputs, nominal map and bound; towards a target levels, obstacles and paths as well.

    Raises:
        UserError: results of another case, or what a certificate does not cover, in one line.
    """
    context = Context.load(case_path)
    with context.blame():
        if context.case.is_random:
            raise UserError(
                "a certificate covers every gap within a bound, and a simulator with noise may leave it",
                key="simulator.noise", remedy="The closed loop and the audit are what checks this case.",
            )  # fmt: skip
        sensing = context.case.sensing
        if sensing is not None and (sensing.latency > 0 or any(sensing.error.values())):
            raise _refused("exact sensing")
        controller, bound = load_controller_of(controller_path, context), load_gap(gap, context)
        what = Certified(
            context.case.name, context.units, context.plant.sampled, bound.function, known_gap(context),
            controller.solution, controller.input_set, controller.input_names,
            _task(context, bound, gap, controller.solution),
        )  # fmt: skip
        head = write_certificate(out, what, context.record("certify"))
    won = int(controller.solution.winning.sum())
    pairs = int(np.bitwise_count(controller.solution.admitted(len(controller.input_set))).sum())
    log.info("certificate of %d cells and %d pairs in %s (digest %s)", won, pairs, out, head["digest"][:16])


def _task(context: Context, bound: SavedGap, gap: Path, solution: Solution) -> Box | Reached:
    """The safe box, or target, obstacles and what is known of the path between samples.

    Raises:
        UserError: a specification of another kind, or a simulator whose hidden state the controller does not see.
    """
    specification, space = specification_of(context.case), Space.of(context.case)
    framed = isinstance(bound.function, BodyFrameGap)
    if remembers(context.case) and not framed:
        raise _refused("no hidden state but that of a robot in the plane")
    if isinstance(specification, Invariance) and not framed:
        return specification.region(space)
    if not isinstance(specification, ReachAvoid | Task):
        raise _refused("invariance, reach-while-avoid that ends in its target, or tasks")
    problem, _ = pose_problem(context, gap)
    swept = None
    if problem.swept is not None and bound.swept is not None:
        swept = bound.swept_by_class or (bound.swept[0][None], bound.swept[1][None])
    return Reached(
        target_of(specification, space, solution), specification.boxes(space), space.vector(specification.clearance),
        np.zeros(space.size) if problem.stray is None else problem.stray, space.pose if framed else None, swept,
    )  # fmt: skip


def target_of(task: ReachAvoid | Task, space: Space, solution: Solution) -> Box | Watched:
    """The box to reach, or what a controller watches over.

    Raises:
        UserError: a controller that moves another automaton on.
    """
    if isinstance(task, ReachAvoid):
        return task.goal_box(space)
    automaton, letters = task.watch(space, solution.grid, np.zeros(space.size))
    after = np.where(solution.free, automaton.step[:, letters], 0)
    if solution.progress is None or not np.array_equal(np.maximum(after, 0).T, solution.progress.after):
        raise UserError("the controller watches over another task", key=f"{KEY}.formula", remedy="Run the case again.")
    named = sorted(regions(parse(task.formula, lambda bound: 0)))
    parts = {
        name: [inequality(p, space, name) if isinstance(p, str) else partial_box(p, space.states) for p in own]
        for name, own in ((name, task.regions[name]) for name in named)
    }
    return Watched(" ".join(task.formula.split()), space.tau, parts, automaton, letters)


def _refused(what: str) -> UserError:
    remedy = "The closed loop and the audit are what checks this case."
    return UserError(f"a certificate covers {what}", key="synthesis.specification", remedy=remedy)


def results_of(folder: Path) -> tuple[Path, Path, Path]:
    """Case, bound and controller of a results folder `results/<case>`, as a run leaves them.

    Raises:
        UserError: a folder without results, or whose case is not at its place.
    """
    for case in (Path(f"{folder.name}.yaml"), Path("configs/cases") / f"{folder.name}.yaml"):
        if reading.is_file(case):
            return of_case(case, folder)
    raise UserError("no case of that name here or in configs/cases", file=folder, remedy="Give the case file.")


def of_case(case: Path, folder: Path | None = None) -> tuple[Path, Path, Path]:
    """Case, bound and controller where a run leaves them.

    Raises:
        UserError: results that are not there.
    """
    own = Context.load(case).case
    results = folder if folder is not None else Path("results") / own.name
    gap, controller = results / "gap" / own_point(own) / "gap.json", results / "synthesis/gap/controller.npz"
    for path in (gap, controller):
        if not reading.is_file(path):
            raise UserError("there is no such result", file=path, remedy="Run the case first.")
    return case, gap, controller


_OPERATIONS = {"Add": "+", "Mul": "*", "sin": "sin", "cos": "cos", "Abs": "abs", "Min": "min", "Max": "max"}


def prefix(e: Any) -> Any:
    """The expression as nested lists.

    Raises:
        UserError: for what the form does not have; it would need an enclosure in whatever reads it.
    """
    e = sp.sympify(e)
    if e.is_Symbol:
        return str(e.name)
    if e.is_Float:
        return float(e).hex()
    if e.is_Rational:
        return fraction(Fraction(int(e.p), int(e.q)))
    operation = type(e).__name__
    if operation in _OPERATIONS and type(e) is getattr(sp, operation):
        return [_OPERATIONS[operation], *(prefix(part) for part in e.args)]
    if e.is_Pow:
        return _prefix_power(e)
    remedy = f"It has numbers, powers with integers, {', '.join(_OPERATIONS.values())}."
    raise UserError(f"a certificate has no form for '{type(e).__name__}'", remedy=remedy)


def fraction(value: Fraction) -> str:
    """A number as a double where it is one, else as 'p/q'."""
    nearest = float(value)
    return nearest.hex() if Fraction(nearest) == value else f"{value.numerator}/{value.denominator}"


def _prefix_power(e: sp.Pow) -> Any:
    n = e.exp
    if n.is_number and n == int(n) and n != 0:
        base = prefix(e.base) if abs(int(n)) == 1 else ["^", prefix(e.base), abs(int(n))]
        return base if n > 0 else ["/", base]
    raise UserError(f"a certificate has no form for '{e}'", remedy="Use powers with integers.")
