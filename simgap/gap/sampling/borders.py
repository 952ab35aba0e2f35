"""States at which a gap may jump though no cell centre sees it: the border of X, and both sides of switching surfaces.

Cell centres lie inside X and, as a rule, beside every surface; random states hit neither. So the faces, edges and
corners of X, and points on and on both sides of each surface, are listed here: with the coordinates that no border and
no surface fixes on a lattice that the caller chooses. Those of the fit lie on the lattice of the cell
centres, those of the check on a random one. None of them is a random sample of X: they never enter the statistical
statement.

A switching surface is an expression over states and inputs that is 0 on it. Effects own theirs (`Effect.surfaces`), a
nominal model in equations has those of its `sign`, `abs`, `min` and `max`, a joint those of its end stops. What an
engine does on its own, unknown to the case, is not among them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from simgap import reading
from simgap.arrays import Bools, Floats, Ints
from simgap.config.case import Case
from simgap.effects import effect
from simgap.errors import UserError
from simgap.gap.bounds.function import GapDomain
from simgap.gap.sampling.points import (
    Columns,
    covering_grid,
    free_axes,
    gap_ends,
    product,
    remembers,
    stacked,
    successor_columns,
)
from simgap.gap.sampling.symmetry import shifted_states
from simgap.gap.sampling.values import check_numbers
from simgap.gap.thresholds import CHECK_LEVELS, LEAST_CHECKED_BORDER, MOST_BORDER_STATES
from simgap.geometry import mesh
from simgap.late import sympy as sp
from simgap.model.symbolic import symbol
from simgap.plants.context import Context
from simgap.plants.model_file import joint_stops
from simgap.simulators.rollouts import engine_of, roll_out_range

BESIDE = 1e-9
"""How far beside a surface its sides are sampled, as a share of the width of X: above rounding, below any cell."""
_MESH = 65  # points along an axis between which a surface that is met twice is not seen
_HALVINGS = 60
_LATTICE = 9  # levels along each axis where the caller names none


@dataclass(frozen=True, eq=False)
class Borders:
    """States on borders and surfaces.

    Attributes:
        x: (n, nx), each state once, in order.
        fixed: (n, nx), which coordinates a border or a surface fixes; the gap may jump along these.
        sheet: (n,), number of the side of a border or surface that a state lies on: along it the gap is one function.
    """

    x: Floats
    fixed: Bools
    sheet: Ints

    def neighbours(self, j: int) -> Ints:
        """The states before and after each one along axis j on its sheet, (n, 2); its own number where there is none.

        Only the coordinate j and those that a border or surface fixes differ between neighbours.
        """
        own = np.arange(len(self.x))
        found = np.stack([own, own], axis=1)
        level = np.where(self.fixed, 0.0, self.x)
        level[:, j] = 0.0
        line = np.column_stack([self.sheet, level])
        order = np.lexsort((self.x[:, j], *line.T[::-1]))
        order = order[~self.fixed[order, j]]
        before, after = order[:-1], order[1:]
        same = np.all(line[before] == line[after], axis=1)
        found[after[same], 0] = before[same]
        found[before[same], 1] = after[same]
        return found


@dataclass(frozen=True, eq=False)
class Directed:
    """The gap of one dimension on borders of X and beside switching surfaces, where cell centres never lie.

    Attributes:
        at: where they lie, E states.
        lower, upper: (E, M), ends of the gap; equal where nothing spreads it.

    Raises:
        UserError: for shapes that do not fit or values that are not finite.
    """

    at: Borders
    lower: Floats
    upper: Floats

    @property
    def x(self) -> Floats:
        """(E, nx) states."""
        return self.at.x

    def __post_init__(self) -> None:
        check_numbers((len(self.x), self.lower.shape[-1]), {"on borders": self.lower, "on borders, upper": self.upper})

    def side(self, upper: bool) -> Floats:
        """(E, M) what one side has to cover: the upper end for `hi`, minus the lower one for `-lo`."""
        return self.upper if upper else -self.lower


def critical_points(
    domain: GapDomain,
    surfaces: Sequence[sp.Expr] = (),
    lattice: Sequence[Floats] | None = None,
    most: int = MOST_BORDER_STATES,
) -> Borders:
    """Faces, edges and corners of X, and every surface with both its sides, for use with every input of U.

    Args:
        domain: X and U; nothing is fixed along axes that are free.
        surfaces: expressions over states and inputs that are 0 on a surface (`switching_surfaces`). One of inputs alone
            has no states of its own: every state is taken with all of U.
        lattice: levels of the coordinates that are not fixed, one array for each axis; evenly spaced by default.
        most: states; a lattice with more is thinned.
    """
    functions = [_Function.of(domain, surface) for surface in surfaces]
    box = domain.box
    if lattice is None:
        lattice = [np.linspace(lo, hi, _LATTICE + 2)[1:-1] for lo, hi in zip(box.lo, box.hi, strict=True)]
    middle = 0.5 * (box.lo + box.hi)
    levels = [middle[[j]] if j in domain.free else np.sort(own) for j, own in enumerate(lattice)]
    while True:
        thin = max(len(own) for own in levels) <= 2
        if thin or border_count([len(own) for own in levels], domain.free) <= most:  # else: not even listed
            found = _listed(domain, functions, levels)
            if thin or len(found.x) <= most:
                return found
        longest = int(np.argmax([len(own) for own in levels]))
        levels[longest] = levels[longest][::2]


def border_count(levels: Sequence[int], free: Sequence[int] = ()) -> int:
    """States on faces, edges and corners of X for so many levels inside X on each axis; free axes have no ends."""
    ends = [n if j in free else n + 2 for j, n in enumerate(levels)]
    return math.prod(ends) - math.prod(levels)


def thinned_count(levels: Sequence[int], free: Sequence[int], most: int) -> int:
    """Number of states that `critical_points` lists where there is no switching surface."""
    left = [1 if j in free else n for j, n in enumerate(levels)]
    while max(left) > 2 and border_count(left, free) > most:
        longest = int(np.argmax(left))
        left[longest] = -(-left[longest] // 2)
    return border_count(left, free)


def _listed(domain: GapDomain, functions: Sequence[_Function], levels: Sequence[Floats]) -> Borders:
    nx = domain.box.size
    fixed = [np.array([] if j in domain.free else [domain.box.lo[j], domain.box.hi[j]]) for j in range(nx)]
    for function in functions:
        if len(function.axes) == 1 and not function.of_inputs:
            (j,) = function.axes
            line = 0.5 * (domain.box.lo + domain.box.hi)[None]
            fixed[j] = np.union1d(fixed[j], _sides(domain, j, function.roots(domain, line, j)[1]))
    every = [np.union1d(own, ends) for own, ends in zip(levels, fixed, strict=True)]
    faces = [[fixed[k] if k == j else every[k] for k in range(nx)] for j in range(nx) if len(fixed[j])]
    border = np.concatenate([np.empty((0, nx)), *(mesh(*face) for face in faces)])  # what lies inside X is never listed
    held = np.stack([np.isin(border[:, j], fixed[j]) for j in range(nx)], axis=1)
    parts = [(border, held, _numbered(np.where(held, border, np.nan)))]
    for function in functions:
        if len(function.axes) > 1 or (function.axes and function.of_inputs):
            parts += [_along(domain, function, j, every, fixed) for j in function.axes]
    x, marks = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    firsts = np.cumsum([0, *(int(part[2].max(initial=-1)) + 1 for part in parts)])
    sheet = np.concatenate([part[2] + before for part, before in zip(parts, firsts, strict=False)])
    x, first = np.unique(x, axis=0, return_index=True)
    return Borders(x, marks[first], sheet[first])


def _along(
    domain: GapDomain, function: _Function, j: int, every: Sequence[Floats], fixed: Sequence[Floats]
) -> tuple[Floats, Bools, Ints]:
    """Places where lines along axis j through the other axes' levels meet a surface: states, what is fixed, sheets.

    Shapes (n, nx), (n, nx), (n,).
    """
    lines = mesh(*(every[k] if k != j else np.zeros(1) for k in range(domain.box.size)))
    which, roots, branch = function.roots(domain, lines, j)
    sides = _sides(domain, j, roots)
    x = np.repeat(lines[which], sides.shape[1], axis=0)
    x[:, j] = sides.ravel()
    held = np.stack([np.isin(x[:, k], fixed[k]) for k in range(domain.box.size)], axis=1)
    held[:, j] = True
    side = np.tile(np.arange(sides.shape[1]), len(which))
    return x, held, _numbered(np.column_stack([np.repeat(branch, sides.shape[1]), side, held]).astype(float))


def _numbered(keys: Floats) -> Ints:
    """The number of each row (n, k) among the different ones, (n,); what is no number is equal to itself."""
    return np.unique(np.nan_to_num(keys, nan=np.inf), axis=0, return_inverse=True)[1].ravel()


@dataclass(frozen=True, eq=False)
class _Function:
    """A compiled surface: `values` (n, nx), (n, nu) -> (n,); the state axes that it depends on."""

    values: Callable[..., Floats | float]
    axes: tuple[int, ...]
    of_inputs: bool

    @staticmethod
    def of(domain: GapDomain, surface: sp.Expr) -> _Function:
        names = (*domain.states, *domain.inputs)
        axes = tuple(j for j, name in enumerate(domain.states) if symbol(name) in surface.free_symbols)
        of_inputs = any(symbol(name) in surface.free_symbols for name in domain.inputs)
        return _Function(sp.lambdify([symbol(n) for n in names], surface, modules="numpy"), axes, of_inputs)

    def __call__(self, x: Floats, u: Floats) -> Floats:
        value = self.values(*x.T, *u.T)
        return np.broadcast_to(np.asarray(value, dtype=float), len(x))

    def roots(self, domain: GapDomain, lines: Floats, j: int) -> tuple[Ints, Floats, Ints]:
        """Places where lines (L, nx) along axis j meet the surface: number of line, coordinate, branch; (k,) each.

        Roots of neighbouring lines that come as the same one of the same input are of one branch.
        """
        lo, hi = domain.box.lo[j], domain.box.hi[j]
        levels = np.linspace(lo, hi, _MESH)
        which, ends, branches = [np.empty(0, np.int64)], [np.empty(0)], [np.empty(0, np.int64)]
        for number, u in enumerate(domain.input_set if self.of_inputs else domain.input_set[:1]):
            x = np.repeat(lines, _MESH, axis=0)
            x[:, j] = np.tile(levels, len(lines))
            sign = np.sign(self(x, np.tile(u, (len(x), 1)))).reshape(len(lines), _MESH)
            row, column = np.nonzero((sign[:, :-1] != sign[:, 1:]) & np.isfinite(sign[:, :-1] + sign[:, 1:]))
            left, right, before = levels[column], levels[column + 1], sign[row, column]
            for _ in range(_HALVINGS):
                middle = 0.5 * (left + right)
                at = lines[row].copy()
                at[:, j] = middle
                same = np.sign(self(at, np.tile(u, (len(at), 1)))) == before
                left, right = np.where(same, middle, left), np.where(same, right, middle)
            which.append(row)
            branches.append(number * _MESH + np.arange(len(row)) - np.searchsorted(row, row))
            root = np.where(before == 0.0, left, right)
            ends.append(np.where((left <= 0.0) & (right >= 0.0), 0.0, root))  # rest is exactly rest
        return np.concatenate(which), np.concatenate(ends), np.concatenate(branches)


def _sides(domain: GapDomain, j: int, roots: Floats) -> Floats:
    """Coordinates below, on and above a surface that axis j meets at `roots` (k,): (k, 3)."""
    lo, hi = domain.box.lo[j], domain.box.hi[j]
    return np.clip(roots[:, None] + np.array([-1.0, 0.0, 1.0]) * BESIDE * (hi - lo), lo, hi)


FIT, CHECK, SHIFTED = "fit", "check", "shifted"
NO_BORDERS = "the samples on borders of X and beside switching surfaces are missing"
MAKE_BORDERS = "Make them with `simgap borders` and give them as --borders."


def switching_surfaces(context: Context) -> tuple[sp.Expr, ...]:
    """All surfaces of a case, each once, in order of their text: those of model and simulator alike.

    Raises:
        UserError: a plant that cannot be built.
    """
    plant, simulator = context.case.plant, context.case.simulator
    declared = context.plant.declared
    found = kinks(context.plant.carried.numeric())
    if simulator is not None:
        found += engine_of(context.case, context.folder).switches(context.case, context.folder)
    found += [symbol(state) - sp.Float(end) for _, state, ends in stops_of(context) for end in ends]
    for added in (*plant.effects, *(simulator.effects if simulator is not None else ())):
        own = effect(added.name)
        if added.on in own.targets(declared):
            found += own.surfaces(declared, added.on, added.parameters)
    known = {symbol(name) for name in (*context.states, *context.inputs)}
    kept = {e for e in found if e.free_symbols and e.free_symbols <= known}
    return tuple(sorted(kept, key=str))


def kinks(expressions: Iterable[sp.Expr]) -> list[sp.Expr]:
    """Surfaces on which `sign`, `abs`, `min` and `max` in the expressions switch."""
    found: list[sp.Expr] = []
    for expression in expressions:
        for node in sp.preorder_traversal(expression):
            if isinstance(node, sp.sign | sp.Abs):
                found.append(node.args[0])
            elif isinstance(node, sp.Min | sp.Max):
                found += [a - b for a, b in combinations(node.args, 2)]
    return found


def stops_of(context: Context) -> list[tuple[str, str, tuple[float, ...]]]:
    """For each joint of a model file of the case whose position is a state: joint, state, and its end stops."""
    plant, simulator = context.case.plant, context.case.simulator
    places = {s.joint: name for name, s in plant.states.items() if s.quantity == "position" and s.joint}
    files = {f for f in (plant.urdf, simulator.urdf if simulator is not None else None) if f}
    return [
        (joint, places[joint], ends)
        for file in sorted(files)
        if reading.is_file(context.folder / file)
        for joint, ends in joint_stops(context.folder / file, list(places)).items()
    ]


def parts_of(context: Context) -> tuple[str, ...]:
    """The parts of the table: for the fit, for the check, and shifted ones where a translation is declared."""
    return (FIT, CHECK, SHIFTED) if free_axes(context.case) else (FIT, CHECK)


def border_states(context: Context, name: str, part: str) -> Borders:
    """States for the fit, for the check, or shifted ones, on the grid of that name.

    Raises:
        UserError: a simulator that remembers earlier inputs, whose gap is not a function of X.
    """
    if remembers(context.case):
        raise UserError("a gap taken over histories has no border of X", key="hidden_state")
    box, grid = context.box, covering_grid(context.case, context.box, name)
    if part == SHIFTED:
        x = shifted_states(context)
        return Borders(x, np.zeros(x.shape, dtype=bool), np.arange(len(x)))
    names = tuple(context.states), tuple(context.inputs)
    domain = GapDomain(*names, box, context.input_set, free_axes(context.case))
    if part == FIT:
        lattice, most = [grid.axis(j) for j in range(box.size)], MOST_BORDER_STATES
    else:  # fresh samples and means have streams of their own
        rng = np.random.default_rng([context.need(context.case.gap, "gap").seed, 2])
        lattice = [rng.uniform(lo, hi, CHECK_LEVELS) for lo, hi in zip(box.lo, box.hi, strict=True)]
        most = checked_at_most(grid.size)
    return critical_points(domain, switching_surfaces(context), lattice, most)


def checked_at_most(grid: int) -> int:
    """Most states on borders that check a bound made on so many states."""
    return min(MOST_BORDER_STATES, max(LEAST_CHECKED_BORDER, grid))


def directed_samples(context: Context, name: str, rolled: Columns, i: int) -> Directed:
    """The gap of dimension i at the states of the fit.

    Raises:
        UserError: a table of another case, or of another grid.
    """
    own = border_states(context, name, FIT)
    _, _, lower, upper = border_gaps(context, rolled, FIT, own)
    shape = (len(own.x), len(context.input_set))
    return Directed(own, lower[:, i].reshape(shape), upper[:, i].reshape(shape))


def border_gaps(context: Context, rolled: Columns, part: str, own: Borders) -> tuple[Floats, Floats, Floats, Floats]:
    """States, inputs, and both ends of the gap of one part: (n, nx), (n, nu), (n, nx), (n, nx).

    Raises:
        UserError: a table of another case, or of another grid.
    """
    mine = {key: values[rolled["part"] == part] for key, values in rolled.items()} if "part" in rolled else {}
    x, u = product(own.x, context.input_set)
    known = {*context.states, *context.inputs} <= set(mine)
    if not (
        known and np.array_equal(stacked(mine, context.states), x) and np.array_equal(stacked(mine, context.inputs), u)
    ):
        raise UserError(
            "the samples on borders and beside switching surfaces are those of another case",
            remedy="Run `borders` again, and `scp` and `gap` after it.",
        )
    return gap_ends(context.plant.sampled.step, mine, context.states, context.inputs)


def roll_out_borders(
    case: Case, folder: Path, states: dict[str, Floats], inputs: Floats, draws: int = 0
) -> tuple[Columns, str]:
    """Roll out each part's states (n, nx) with all inputs (M, nu), in the engine's process: the table, the engine.

    `draws` are of the noise, if there is some.
    """
    x, u = product(np.concatenate(list(states.values())), inputs)
    following, spread, engine = roll_out_range(case, folder, x, u, draws)
    return border_columns(case, states, inputs, following, spread), engine


def border_columns(
    case: Case, states: dict[str, Floats], inputs: Floats, following: Floats,
    spread: tuple[Floats, Floats] | None = None,
) -> Columns:  # fmt: skip
    """The table of roll-outs of the parts of `states` with all inputs: successors (n, nx)."""
    x, u = product(np.concatenate(list(states.values())), inputs)
    part = np.repeat(list(states), [len(own) * len(inputs) for own in states.values()])
    return {"part": part, **successor_columns(case, x, u, following, spread)}
