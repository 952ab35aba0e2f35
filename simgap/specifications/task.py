"""Tasks over time: a formula of linear temporal logic over named regions, held at the sampling instants.

The controller reads the letter of the measured cell: a region counts as inside where the whole cell is, whatever the
measurement error, and as outside where none of it can be. In normal form a formula asks for both only positively. So
what holds of the letters holds of the run. Obstacles and walls are kept between samples, too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag

from simgap.arrays import Bools, Floats, Ints
from simgap.config.base import Interval
from simgap.errors import UserError, placed
from simgap.geometry import Box, Grid
from simgap.late import sympy as sp
from simgap.model.compile import compile_interval_kernel
from simgap.model.expressions import parse as parse_expression
from simgap.specifications.arena import Arena, Surroundings, until_touch
from simgap.specifications.base import (
    EARLY,
    STUCK,
    Game,
    Look,
    Monitor,
    Outcome,
    Run,
    Verdict,
    Words,
    projected,
    rectangle,
)
from simgap.specifications.formula import Automaton, Formula, Letter, automaton_of, literals, parse, regions
from simgap.specifications.product import solve
from simgap.specifications.solution import Solution
from simgap.specifications.space import (
    KEY,
    SHRINK,
    Space,
    cells_meeting,
    cells_within,
    grown,
    in_copies,
    known,
    partial_box,
)
from simgap.units import conversion

MOST_REGIONS = 8
"""In one formula: runs are judged by an automaton over all their combinations."""
Region = Annotated[
    Annotated[dict[str, Interval], Tag("box")] | Annotated[str, Tag("inequality")],
    Discriminator(lambda given: "inequality" if isinstance(given, str) else "box"),
]
READ = {"GF": "G F: again and again", "FG": "F G: for ever from some sample on", "U": "U: until"}
"""How what is not plain in a formula is read."""
ROUNDED_ZERO = 1e-300
"""A sum of squares that may be 0 is enclosed from a little below it: by less than this."""
LAST = 4
"""A run that is to stay somewhere in the end is there for its last quarter at least: judgement."""
DRAWN = 200
"""Points along each axis at which an inequality is drawn."""
DONE, BROKEN, KEPT, LATE = "done", "broke the task", "kept the task", "no progress in time"


def _listed(region: Any) -> Any:
    if region == []:
        raise ValueError("it is an empty list. Give a box or an inequality")
    return [region] if isinstance(region, str | dict) else region


class Task(Arena):
    """Keep a formula over regions."""

    kind: Literal["task"]
    """Keep a formula of temporal logic over named regions."""
    formula: str
    """Over names of regions, with ! & | -> X F G U W R and deadlines such as F[<= 40 s] a: co-safety, safety, G of
    co-safety (G F a), and F G of regions beside G of regions."""
    regions: dict[
        str, Annotated[tuple[Region, ...], BeforeValidator(_listed, json_schema_input_type=Region | tuple[Region, ...])]
    ] = Field(min_length=1)
    """By name a box (intervals of states; those not named are free), an inequality such as 'x^2 + y^2 <= 4', or a list
    of these: their union."""

    swept_boxes: ClassVar[bool] = True
    words: ClassVar[Words] = Words(
        runs="Runs of the task",
        caption="Runs of the controller made for the nominal model alone and of the gap-aware one in the simulator (in "
        "colour), and from the same starts on the nominal model (grey, dashed).",
        kept="as the task asks",
        promise="keeps the task",
        violated="breaks the task or touches something",
        failed="broke the task",
        goal="progress of the task",
        between="Obstacles and walls are kept",
        limits="arena",
    )

    def region(self, space: Space) -> Box:
        """The arena; the formula and its regions must be about it."""
        self._automaton(space, exact_letters(regions(self._read(space))))
        for name, region in self.regions.items():
            for part in region:
                if isinstance(part, dict):
                    known(part, space.states, f"regions.{name}")
                else:
                    inequality(part, space, name)
        return super().region(space)

    def _read(self, space: Space) -> Formula:
        with placed(key=f"{KEY}.formula"):
            return formula_of(self.formula, space.tau, tuple(self.regions))

    def _automaton(self, space: Space, letters: tuple[Letter, ...]) -> Automaton:
        with placed(key=f"{KEY}.formula"):
            return automaton_of(self._read(space), letters)

    def memory_states(self, space: Space) -> int:
        """States of the formula's automaton."""
        return len(self._automaton(space, exact_letters(regions(self._read(space)))).step)

    def solve(self, game: Game) -> Solution:
        """The product of the game with the automaton of the formula."""
        automaton, letters = self.watch(game.space, game.grid, game.error)
        return solve(game, automaton, letters, self.free(game.space, game.grid, game.stray + game.error))

    def fit(self, space: Space, grid: Grid, error: Floats) -> Bools:
        """Cells whose letter the formula allows at first; regions must hold a cell, and some way keep the formula."""
        automaton, letters = self.watch(space, grid, error)
        return np.asarray(automaton.step[0, letters] >= 0)

    def watch(self, space: Space, grid: Grid, error: Floats) -> tuple[Automaton, Ints]:
        """The formula's automaton over the letters that cells have, and the number of each cell's, (cells,)."""
        sure, formula = {}, self._read(space)
        for name in sorted(regions(formula)):
            inside, meeting = zip(
                *(self._cells(space, grid, error, name, part) for part in self.regions[name]), strict=True
            )
            sure[name, True] = np.any(inside, axis=0)
            sure[name, False] = ~np.any(meeting, axis=0)
            if not sure[name, True].any() and ("in", name, True) in literals(formula):
                widths = ", ".join(f"{s} {2.0 * h:.4g}" for s, h in zip(space.states, grid.h, strict=True))
                less = "; the measurement error is taken off it" if error.any() else ""
                raise UserError(
                    f"no cell fits into the region (they are wide: {widths})", key=f"{KEY}.regions.{name}",
                    remedy=f"Move it into the arena, use finer cells (synthesis.cells) or a larger region{less}.",
                )  # fmt: skip
        codes = sum((flags.astype(np.int64) << k for k, flags in enumerate(sure.values())), np.zeros(grid.size, int))
        present, letters = np.unique(codes, return_inverse=True)
        words = (frozenset(itertools.compress(sure, (code >> k & 1 for k in range(len(sure))))) for code in present)
        automaton = self._automaton(space, tuple(words))
        if not automaton.possible:
            raise UserError(
                "no way through the regions keeps the formula, whatever the plant does", key=f"{KEY}.formula",
                remedy="Regions that nowhere overlap cannot be asked for at once, nor one and its complement.",
            )  # fmt: skip
        return automaton, letters.reshape(-1)

    def _cells(self, space: Space, grid: Grid, error: Floats, name: str, part: Region) -> tuple[Bools, Bools]:
        """Cells that lie in a region for sure, and cells that may meet it, whatever the measurement error."""
        if isinstance(part, str):
            lo, hi = enclosed(inequality(part, space, name), space, grid, error)
            return hi <= 0.0, lo <= 0.0
        box = partial_box(part, space.states)
        lo, hi = box.lo + error, box.hi - error
        none = np.zeros(grid.size, np.bool_)
        within = cells_within(grid, Box(lo, hi)) if np.all(lo < hi) else none
        touching = 2.0 * SHRINK * 2.0 * grid.h  # a face that lies on the region's is met: both hold it
        return within, cells_meeting(grid, grown(box, error + touching))

    def recognise(self, space: Space, solution: Solution, error: Floats) -> None:
        """See `Specification`: its states and its good moves have to be those of the formula, in every cell."""
        own, (automaton, letters) = solution.progress, self.watch(space, solution.grid, error)
        following, good = automaton.step[:, letters].T, automaton.good[:, letters].T
        if own is not None and own.after.shape == following.shape and solution.value is not None:
            going = solution.free[:, None] & (following >= 0)
            won = solution.value.reshape(*following.shape, own.base) >= 0
            goal = np.asarray(solution.target).reshape(won.shape)
            ends = good | (following == automaton.done)
            if (
                own.persists == automaton.persists
                and np.array_equal(own.after[going], following[going])
                and np.array_equal(goal, won & ends[..., None])
                and not (won & ~going[..., None]).any()
                and (own.persists or np.array_equal(goal, solution.value.reshape(won.shape) == 0))
            ):
                return
        raise UserError("what the controller says its task has come to is not what the formula says")

    def monitor(self, space: Space, solution: Solution) -> Monitor:
        """Monitor of the formula on the true states, and of touching nothing."""
        names = sorted(regions(self._read(space)))
        places = {name: Place(space, name, self.regions[name]) for name in names}
        return Watching(places, self._automaton(space, exact_letters(names)), self.surroundings(space), solution)

    def sentence(self, space: Space) -> str:
        """'keep "G F a" (G F: again and again; a: x in [0, 1] m)'."""
        named = "; ".join(f"{name}: {self._told(space, name)}" for name in sorted(regions(self._read(space))))
        squeezed = self.formula.replace(" ", "").replace("(", "")
        read = "; ".join(text for sign, text in READ.items() if sign in squeezed)
        return f"keep '{self.formula}' ({read}{'; ' if read else ''}{named}){self.avoiding()}{self.clear_of(space)}"

    def _told(self, space: Space, name: str) -> str:
        return " or ".join(
            part if isinstance(part, str) else ", ".join(space.interval(state, ends) for state, ends in part.items())
            for part in self.regions[name]
        )

    def bands(self, space: Space) -> Sequence[Sequence[tuple[str, float, float]]]:
        """Sides of the regions that are boxes, also a turn on and back where a state is an angle."""
        found: list[list[tuple[str, float, float]]] = [[] for _ in space.states]
        for name in sorted(regions(self._read(space))):
            for part in self.regions[name]:
                for state, (lo, hi) in part.items() if isinstance(part, dict) else ():
                    j = space.states.index(state)
                    turn = float(space.box.hi[j] - space.box.lo[j])
                    around = (-turn, 0.0, turn) if j in space.periodic else (0.0,)
                    found[j] += [(name, lo + by, hi + by) for by in around]
        return found

    def draw(self, axes: Any, space: Space, shown: tuple[int, int], look: Look) -> None:
        """Regions that are boxes, with their names, obstacles and the border of the arena."""
        arena, (face, edge) = self.region(space), look.target
        for name in sorted(regions(self._read(space))):
            for part in self.regions[name]:
                if isinstance(part, dict) and any(space.states[j] in part for j in shown):
                    box = projected(partial_box(part, space.states), arena, shown)
                    rectangle(axes, box, facecolor=face, edgecolor=edge, lw=1.0, alpha=0.5)
                    axes.text(box.lo[0], box.hi[1], f" {name}", ha="left", va="top", fontsize="small")
                elif isinstance(part, str):
                    self._draw_inequality(axes, space, name, part, shown, look)
        super().draw(axes, space, shown, look)

    def _draw_inequality(
        self, axes: Any, space: Space, name: str, text: str, shown: tuple[int, int], look: Look
    ) -> None:
        """The region of an inequality that is about the two shown states alone."""
        arena, names = self.region(space), [space.states[j] for j in shown]
        value = inequality(text, space, name)
        if {s.name for s in value.free_symbols} <= {*names}:
            ends = [np.linspace(arena.lo[j], arena.hi[j], DRAWN) for j in shown]
            x, y = np.meshgrid(*ends)
            field = sp.lambdify([sp.Symbol(n) for n in names], value, modules="numpy")
            with np.errstate(invalid="ignore", divide="ignore"):
                inside = np.asarray(np.broadcast_to(field(x, y), x.shape) <= 0.0)
            face, _ = look.target
            if inside.any():
                axes.contourf(x, y, inside, levels=[0.5, 1.5], colors=[face], alpha=0.5)
                k = int(np.argmax(np.where(inside, y, -np.inf)))
                axes.text(x.flat[k], y.flat[k], f" {name}", ha="left", va="top", fontsize="small")


@lru_cache(64)
def formula_of(text: str, tau: float, names: tuple[str, ...]) -> Formula:
    """A formula over named regions, its deadlines in samples of tau seconds.

    Raises:
        UserError: what is no formula, no deadline, no name, or about too many regions.
    """

    def samples(bound: str) -> int:
        number, _, unit = bound.strip().partition(" ")
        try:
            count = math.floor(float(number) * (conversion(unit, "s").factor if unit else 1.0) / tau + 1e-9)
            if count < 0 or (count == 0 and float(number) > 0.0):
                raise ValueError
            return count
        except (ValueError, OverflowError, UserError):
            remedy = f"Write it like F[<= 40 s] a; a sample takes {tau:g} s."
            raise UserError(f"'{bound.strip()}' is no deadline", remedy=remedy) from None

    formula = parse(text, samples)
    unknown = sorted(regions(formula) - set(names))
    if unknown:
        raise UserError(f"no region '{unknown[0]}'", remedy=f"The regions are {', '.join(names)}.")
    if len(regions(formula)) > MOST_REGIONS:
        raise UserError(f"the formula is about more than {MOST_REGIONS} regions", remedy="Join some of them.")
    return formula


def exact_letters(names: Iterable[str]) -> tuple[Letter, ...]:
    """Letters of states that are known: all combinations of regions, sorted, the last one running fastest."""
    ordered = sorted(names)
    inside = itertools.product((False, True), repeat=len(ordered))
    return tuple(frozenset(zip(ordered, own, strict=True)) for own in inside)


def inequality(text: str, space: Space, name: str) -> sp.Expr:
    """The expression that is not positive exactly where an inequality holds.

    Raises:
        UserError: what is no inequality between expressions of the states.
    """
    with placed(key=f"{KEY}.regions.{name}"):
        for sign in ("<=", ">="):
            left, found, right = text.partition(sign)
            if found:
                small, large = (left, right) if sign == "<=" else (right, left)
                difference = parse_expression(small, space.states) - parse_expression(large, space.states)
                if difference.is_number:
                    raise UserError(f"'{text}' holds everywhere or nowhere", remedy="Let it depend on a state.")
                return difference
        raise UserError(f"'{text}' is no inequality", remedy="Write it like 'x^2 + y^2 <= 4', with <= or >=.")


def enclosed(expression: sp.Expr, space: Space, grid: Grid, error: Floats) -> tuple[Floats, Floats]:
    """Least and largest values of an expression over the cells, grown by the error: (cells,) each, rounded outward.

    Where a root or logarithm of a negative number is possible, nothing is known of the value: -inf and inf. Where it is
    sure, no inequality holds: inf and inf.
    """
    symbols = {s.name: s for s in expression.free_symbols}
    axes = [j for j, name in enumerate(space.states) if name in symbols]
    roots = [power.base for power in expression.atoms(sp.Pow) if not power.exp.is_integer]
    defined = [*roots, *(log.args[0] for log in expression.atoms(sp.log))]
    kernel = compile_interval_kernel([expression, *defined], [[symbols[space.states[j]] for j in axes]])
    centres = np.stack(np.meshgrid(*(grid.axis(j) for j in axes), indexing="ij"), axis=-1).reshape(-1, len(axes))
    reach = (grid.h + error)[axes] * (1.0 + 1e-9)  # as much wider as rounding may have moved a face
    pairs = np.array([kernel(c - reach, c + reach) for c in centres])
    pairs[(pairs[:, 1:, 0] < -ROUNDED_ZERO).any(axis=1), 0] = -np.inf, np.inf
    pairs[(pairs[:, 1:, 1] < 0.0).any(axis=1), 0] = np.inf
    shape = [grid.cells[j] if j in axes else 1 for j in range(space.size)]
    lo, hi = (np.broadcast_to(side.reshape(shape), grid.cells).reshape(-1) for side in pairs[:, 0].T)
    return lo, hi


@dataclass(frozen=True, eq=False)
class Place:
    """A region: the union of boxes and inequalities."""

    space: Space
    name: str
    parts: tuple[Region, ...]

    def contains(self, x: Floats) -> Bools:
        """True where states are in it: (n, nx) -> (n,)."""
        return reduce(np.logical_or, (test(x) for test in self._tests))

    @cached_property
    def _tests(self) -> list[Any]:
        return [self._test(part) for part in self.parts]

    def _test(self, part: Region) -> Any:
        space = self.space
        if isinstance(part, dict):
            box = partial_box(part, space.states)
            return lambda x: in_copies(space, box, x)
        value = sp.lambdify([sp.Symbol(s) for s in space.states], inequality(part, space, self.name), modules="numpy")

        def holds(x: Floats) -> Bools:
            within = np.all((x >= space.box.lo) & (x <= space.box.hi), axis=1, keepdims=True)
            at = np.where(within, x, space.wrapped(x))  # the upper end of a periodic axis is of its last cell
            with np.errstate(invalid="ignore", divide="ignore"):  # where it has no value it does not hold
                return np.asarray(np.broadcast_to(value(*at.T), len(x)) <= 0.0)

        return holds


@dataclass(frozen=True, eq=False)
class Watching(Monitor):
    """Judges runs by the formula's automaton, read at the true states.

    Attributes:
        places: the formula's regions, sorted; automaton: over all combinations of them, the last one running fastest.
        surroundings: what must not be touched; solution: of the controller, whose value says how long progress takes.
    """

    places: dict[str, Place]
    automaton: Automaton
    surroundings: Surroundings
    solution: Solution

    measures_clearance = True

    def over_each(self, x: Floats, measured: Floats) -> Bools:
        """Runs end where the controller has nothing more to do: (n, nx), (n, nx) -> (n,), all False."""
        return np.zeros(len(x), np.bool_)

    def clearance(self, path: Floats) -> float:
        """Least distance to obstacles and walls along a path (k, nx)."""
        return self.surroundings.least(path)

    def letters(self, x: Floats) -> Ints:
        """Number of the letter at each state: (n, nx) -> (n,)."""
        return reduce(
            lambda code, place: 2 * code + place.contains(x), self.places.values(), np.zeros(len(x), np.int64)
        )

    def judge(self, run: Run, steps: int) -> Verdict:
        """Cut the run where it touches something, breaks the task or has done it, or ask how it went on."""
        run, hit = until_touch(run, self.surroundings)
        states, good = self.automaton.read(self.letters(run.x))
        over = np.flatnonzero(
            (states < 0) | (states == self.automaton.done) if self.automaton.done >= 0 else states < 0
        )
        if len(over) and over[0] < len(run.x) - hit:
            last, broken = int(over[0]), bool(states[over[0]] < 0)
            run, hit, good = run.until(last), False, good[: last + 1]
            end, kept = (BROKEN, False) if broken else (DONE, True)
        elif hit:
            end, kept, broken = self.surroundings.touched, False, False
        else:
            broken = False
            end, kept = self._went_on(run, good, steps)
        unbroken = np.arange(len(run.x)) < len(run.x) - (hit or broken)
        near = run.clearance if run.clearance is not None else np.array([np.inf])
        return Verdict(Outcome(end, kept, len(run.inputs), self._figures(good, near, end)), run, unbroken)

    def _went_on(self, run: Run, good: Bools, steps: int) -> tuple[str, bool]:
        """End of a run that broke nothing and has not done everything."""
        if run.stuck:
            return STUCK, False
        if len(run.inputs) < steps:
            return EARLY, False
        if self.automaton.done >= 0:
            return LATE, False
        assert self.solution.value is not None
        # Letters that are sure come later than the true ones, so that this automaton may be ahead by whole rounds.
        if self.automaton.persists:
            stays = good[-max(1, len(good) // LAST) :].all()
            return (KEPT, True) if stays else (LATE, False)
        waiting = len(good) - 1 - int(np.flatnonzero(good).max(initial=0))
        bound = 2 * len(self.automaton.step) * int(self.solution.value.max())
        return (KEPT, True) if good.any() and waiting <= bound else (LATE, False)

    def _figures(self, good: Bools, near: Floats, end: str) -> dict[str, float]:
        return {"rounds": float(good.sum()), "clearance": float(near.min()), "done": float(end == DONE)}

    def summary(self, outcomes: Sequence[Outcome]) -> dict[str, Any]:
        """How often runs made progress, and the worst clearance over all of them."""
        near = min((o.figures["clearance"] for o in outcomes), default=np.inf)
        key = "least_clearance" if self.surroundings.round else "least_clearance_in_widths_of_X"
        kept = [o for o in outcomes if o.kept]
        again = self.automaton.done < 0 and not self.automaton.persists
        counted = {"rounds": [int(o.figures["rounds"]) for o in kept]} if again else {}
        return {"steps_to_target": [o.steps for o in kept if o.figures["done"]], **counted, key: near}
