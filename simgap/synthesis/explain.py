"""Explanation of an empty winning domain (one step in numbers, and a quick search on coarse cells), and of one state.

Looked at are cells spread over the grid with all inputs: what the inputs can move in one step, how wide the gap and the
successor of a cell are against that, and along which state every input leads out. Then the same problem is solved again
with more cells, a narrower gap, the nominal model alone and other sampling times, each on as many cells as a short
budget allows. These are searches, not proofs: what they do not find may exist on finer cells.

Of one state it is told what its inputs can do from its cell, and what the cell is lost to.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.errors import UserError
from simgap.gap.json_record import JsonRecord
from simgap.geometry import Grid
from simgap.late import njit, numba
from simgap.model.sampled import NominalModel
from simgap.notation import joined
from simgap.synthesis.abstraction.post import Kernel, no_gap
from simgap.synthesis.controller import Controller
from simgap.synthesis.margins import AROUND, ASKED, BESIDE, CELLS, GAMMA, NOTHING, Margins
from simgap.synthesis.synthesise import SynthesisProblem

SAMPLED = 2_000
"""Cells that are looked at one by one."""
PAIRS = 6_000_000
"""Most pairs of cell and input of one try: some seconds. A judgement; the synthesis itself may take minutes."""
GROWTH, ROUNDS = 4, 6
"""Times as many cells from one try to the next, and tries at most."""
MOST_PAIRS = 150_000_000
"""Beyond `PAIRS`, cells are refined once more than was asked for, up to this: what was asked for was worth its time."""
NARROWER = (0.5, 0.0)
"""Shares of the gap's width around its middle."""
OTHER_TAU = (2.0, 0.5)
"""Times the sampling time."""
NOMINAL = "the nominal model"
_NARROWER = "Smaller cells of the grid, a basis that follows the gap or gap.sides: signed make gamma narrower."


@dataclass(frozen=True)
class AxisNumbers(JsonRecord):
    """One state in one step.

    Attributes:
        cell: width of a cell. step: largest |f - x|. moves: what the choice of the input changes, median over cells.
        gamma, gamma_width: largest size and width of the gap over a cell, 0 for the nominal model alone.
        spans, spans_nominal: cells that a successor of one cell covers, median, with the gap and without it.
        leaves: share of the cells in which every input leads out of the region along this state.
    """

    state: str
    cell: float
    step: float
    moves: float
    gamma: float
    gamma_width: float
    spans: float
    spans_nominal: float
    leaves: float


@dataclass(frozen=True)
class Attempt(JsonRecord):
    """One thing that was tried: what, with which key, on which cells, and the share of the free cells that win."""

    what: str
    key: str
    with_gap: bool
    cells: tuple[int, ...]
    wins: float


@dataclass(frozen=True)
class EmptyDomainExplanation(JsonRecord):
    """Explanation of an empty winning domain.

    Attributes:
        cause: specification, cells, gap, between_samples or sensing. sentence: the same in words.
        first: the state that runs out first. axes: numbers of each state. tries: what was tried, in order.
    """

    cause: str
    sentence: str
    first: str
    axes: tuple[AxisNumbers, ...]
    tries: tuple[Attempt, ...]


@dataclass(frozen=True)
class GammaParts:
    """Parts of the largest gamma of a state, in its unit.

    Attributes:
        sampled: largest gap at a sample; whole: largest bound over all states; remainder: what measured data leave.
        remembered: effects with a memory that the nominal model does not carry.
    """

    sampled: float
    whole: float
    remainder: float
    remembered: tuple[str, ...] = ()

    def words(self, state: str) -> str:
        """The parts with their sizes, and what makes the largest smaller."""
        late = " and ".join(self.remembered)
        at_samples = f"{late}, which the model does not carry" if late else "the gap to the simulator at the samples"
        carry = (
            f"{late} carried as states (fewer cells, inputs or samples make room) or a larger tau" if late else
            "a corrected model (simgap diagnose, plant.effects) or another integrator"
        )  # fmt: skip
        between = "a smaller half-width of the grid, a basis that follows the gap or gap.sides: signed"
        longer = "longer or less noisy recordings, or an effect that explains it (simgap next)"
        parts = (
            (self.sampled, at_samples, carry),
            (max(self.whole - self.sampled, 0.0), "what may lie between samples (Lipschitz constants, jumps)", between),
            (self.remainder, "what the recordings leave unexplained (gap.remainder)", longer),
        )
        each = ", ".join(f"{size:.2g} is {what}" for size, what, _ in sorted(parts, reverse=True) if size > 0.0)
        return f"Of the largest gamma of {state}, {each}. The first shrinks with {max(parts)[2]}."


def explain(
    problem: SynthesisProblem,
    retimed: Callable[[float], NominalModel] | None = None,
    threads: int = 1,
    parts: Mapping[str, GammaParts] | None = None,
) -> EmptyDomainExplanation:
    """The reasons of a problem whose winning domain is empty.

    Args:
        problem: the problem.
        retimed: the nominal model at so many times the sampling time; None where it has no other.
        threads: for the kernels.
        parts: state -> what its gamma is made of, where that is known.
    """
    axes = axis_numbers(problem)
    tries = tuple(_tried(*own, threads) for own in _tries(problem, retimed))
    first = max(axes, key=lambda a: (a.leaves, a.spans / max(a.moves / a.cell, 1e-9))).state
    cause, sentence = _verdict(problem, first, tries)
    if cause == "gap":
        widest = max(axes, key=lambda a: a.gamma_width / max(a.moves, 1e-300)).state
        known = (parts or {}).get(widest)
        sentence += f" {known.words(widest) if known is not None else _NARROWER}"
    return EmptyDomainExplanation(cause, sentence, first, axes, tries)


def axis_numbers(problem: SynthesisProblem) -> tuple[AxisNumbers, ...]:
    """Numbers of one step for each state, from cells spread evenly over the grid."""
    grid, inputs = problem.grid, problem.inputs
    cells = np.unique(np.linspace(0, grid.size - 1, min(SAMPLED, grid.size)).astype(np.int64))
    centres, gap = grid.centres()[cells], problem.gap or no_gap
    before = np.repeat(centres, len(inputs), axis=0)
    moved = problem.model.step(before, np.tile(inputs, (len(centres), 1))) - before
    steps = moved.reshape(len(centres), len(inputs), -1)
    widest = np.zeros((grid.box.size, 2))
    _widest(gap, centres, np.array(grid.h), inputs, widest)
    boxes = replace(problem, swept=None).abstraction().boxes(cells)
    alone = replace(problem, gap=None, swept=None, error=None).abstraction().boxes(cells)
    out = (boxes[:, :, 0] < 0) | (boxes[:, :, 1] >= np.array(grid.cells))
    out[..., list(grid.periodic)] = False
    leaves = out.all(axis=1).mean(axis=0)
    spans, plain = (np.median(b[:, :, 1] - b[:, :, 0] + 1, axis=(0, 1)) for b in (boxes, alone))
    return tuple(
        AxisNumbers(
            name, 2.0 * float(grid.h[j]), float(np.abs(steps[..., j]).max()),
            float(np.median(np.ptp(steps[..., j], axis=1))), float(widest[j, 0]), float(widest[j, 1]),
            float(spans[j]), float(plain[j]), float(leaves[j]),
        )
        for j, name in enumerate(problem.space.states)
    )  # fmt: skip


def _tries(
    problem: SynthesisProblem, retimed: Callable[[float], NominalModel] | None
) -> Iterator[tuple[str, str, bool, SynthesisProblem]]:
    """Finer cells and narrower gaps as far as the budget goes; the path between samples is left aside."""
    plain = replace(problem, swept=None, stray=None, previous=None, latency=0, error=None)
    alone = replace(plain, gap=None)
    finer = _finer(problem.cells, len(problem.inputs))
    for cells in finer:
        yield NOMINAL, "synthesis.cells", False, replace(alone, cells=cells)
    if problem.gap is not None:
        for cells in finer:
            yield "with the gap", "synthesis.cells", True, replace(plain, cells=cells)
        for share in NARROWER:
            what = f"with {'half' if share else 'none'} of the gap's width"
            yield what, "gap", True, replace(plain, gap=_narrowed(problem.gap, share))
    if retimed is not None:
        for times in OTHER_TAU:
            own = replace(alone, model=retimed(times), cells=finer[-1])
            yield f"{NOMINAL}, {times:g} times tau", "domain.tau", False, own


def _tried(what: str, key: str, with_gap: bool, problem: SynthesisProblem, threads: int) -> Attempt:
    try:
        solution = problem.specification.solve(problem.game(threads))
    except UserError:  # sets that these cells cannot express
        return Attempt(what, key, with_gap, problem.cells, 0.0)
    return Attempt(what, key, with_gap, problem.cells, solution.fraction if solution.useful else 0.0)


def _finer(cells: Sequence[int], inputs: int) -> list[tuple[int, ...]]:
    """The cells that were asked for, then `GROWTH` times as many from one to the next while they are affordable."""
    pairs = math.prod(cells) * inputs
    most = max(PAIRS, min(1.3 * GROWTH * pairs, MOST_PAIRS))
    found = [tuple(cells)]
    for k in range(1, ROUNDS):
        more = tuple(math.ceil(c * GROWTH ** (k / len(cells))) for c in cells)
        if math.prod(more) * inputs > most:
            break
        found.append(more)
    return found


def _verdict(problem: SynthesisProblem, first: str, tries: Sequence[Attempt]) -> tuple[str, str]:
    alone = [t for t in tries if t.key == "synthesis.cells" and not t.with_gap]
    gapped = [t for t in tries if t.key == "synthesis.cells" and t.with_gap]
    narrow, other = ([t for t in tries if t.key == key and t.wins > 0] for key in ("gap", "domain.tau"))
    taus = "; another sampling time helps: " + ", ".join(t.what.split(", ")[1] for t in other) if other else ""
    run_out = f"{first} runs out first"
    if not any(t.wins > 0 for t in alone):
        finest = " x ".join(map(str, alone[-1].cells))
        return "specification", (
            f"{run_out}. The nominal model alone wins nothing either, up to {finest} cells: the inputs cannot meet "
            f"synthesis.specification on cells as fine as these{taus}."
        )
    won = next(t for t in alone if t.wins > 0)
    if problem.gap is None or any(t.wins > 0 for t in gapped):
        better = next((t for t in gapped if t.wins > 0), won)
        if math.prod(better.cells) > math.prod(problem.cells):
            needed = " x ".join(map(str, better.cells))
            return "cells", f"{run_out}. The cells are too large: {needed} of them win {better.wins:.3g}."
        known = ["the measurement error"] * (problem.error is not None) + ["the latency of 1 sample"] * problem.latency
        what = joined(known) or "the path between samples"
        return (
            "sensing" if known else "between_samples",
            f"{run_out}. At sampling instants and with a perfect measurement {better.wins:.3g} wins; "
            f"the rest is lost to {what}.",
        )
    helps = f"; with {narrow[0].what.removeprefix('with ')} it wins {narrow[0].wins:.3g}" if narrow else ""
    return "gap", f"{run_out}. The gap is the reason: the nominal model alone wins {won.wins:.3g}{helps}."


def _narrowed(gap: Kernel, share: float) -> Kernel:
    """The gap with a share of its width around its middle."""

    @numba.njit(error_model="numpy")
    def narrowed(xlo, xhi, u, lo, hi):  # type: ignore[no-untyped-def]
        gap(xlo, xhi, u, lo, hi)
        for i in range(len(lo)):
            middle, half = 0.5 * (lo[i] + hi[i]), 0.5 * (hi[i] - lo[i]) * share
            lo[i], hi[i] = middle - half, middle + half

    found: Kernel = narrowed
    return found


@njit(error_model="numpy")
def _widest(gap, centres, h, inputs, out):  # type: ignore[no-untyped-def]
    """Largest size and width of the gap over the cells around `centres` (k, n), for each dimension: (n, 2)."""
    n = centres.shape[1]
    lo, hi = np.empty(n), np.empty(n)
    for c in range(centres.shape[0]):
        for m in range(inputs.shape[0]):
            gap(centres[c] - 0.999 * h, centres[c] + 0.999 * h, inputs[m], lo, hi)
            for j in range(n):
                out[j, 0] = max(out[j, 0], abs(lo[j]), abs(hi[j]))
                out[j, 1] = max(out[j, 1], hi[j] - lo[j])


_FORBIDDEN = "The specification, its clearance or a wall of X forbids this cell, whatever the controller."
_CAUSE = {
    NOTHING: "Nothing is known of this cell.",
    ASKED: "What is asked for breaks in this cell itself, at the start of a run.",
    GAMMA: "Gamma costs it: at {factor:.3g} times its width an input would lead from this cell into cells that win.",
    CELLS: "The cells are too large: without gamma, an input would lead into cells that win from its centre alone.",
    AROUND: "The cells that it leads to lose: without gamma, no input leads into cells that win, nor from its centre. "
    "Stronger inputs help where it is too far, finer cells or a narrower gamma where those cells can be won.",
    BESIDE: "Its successors do not cost it, but the path between samples, or what a measurement leaves open.",
}


def why(problem: SynthesisProblem, controller: Controller, margins: Margins | str, x: Floats) -> tuple[str, ...]:
    """Sentences on a state x (nx,): whether a run may begin in its cell, by how much, and if not, what it runs into.

    Args:
        problem, controller: with the gap.
        margins: of that cell at least; a sentence where there are none.

    It looks one step ahead, at the set that won in the end, and not at the pass in which the cell was lost.
    """
    solution, grid, names = controller.solution, controller.grid, problem.space.states
    cell = int(grid.index(x[None])[0])
    if cell < 0:
        far = [n for n, v, lo, hi in zip(names, x, grid.box.lo, grid.box.hi, strict=True) if not lo <= v <= hi]
        return (f"Outside the region of the specification: {', '.join(far)}.",)
    if not solution.free[cell]:
        return (_FORBIDDEN,)
    if isinstance(margins, str):
        cause, factor = margins, float("nan")
    else:
        factor = float(margins.factor[cell])
        cause = _CAUSE[margins.loses_by[cell]].format(factor=factor)
    if solution.winning[cell]:
        grow = f" Gamma may grow by a factor of {factor:.4g} in this cell." if factor >= 1.0 else ""
        return (f"It wins: {len(controller.inputs(x))} of {len(problem.inputs)} inputs are admissible.{grow}",)
    if solution.memory > 1 or problem.on_true_cells:
        return ("It loses where a run begins.", cause)
    boxes = problem.abstraction().boxes(np.array([cell]))[0]
    leaves, lost = _fates(grid, solution.winning, boxes)
    return (
        "It loses: no input keeps every successor in cells that win.",
        *_inputs(problem, boxes, leaves, lost),
        cause,
    )


def _fates(grid: Grid, winning: Bools, boxes: Ints) -> tuple[Bools, Ints]:
    """Axes along which boxes of successors (M, 2, nx) may leave the region (M, nx); cells in each that lose, (M,)."""
    count, table = np.array(grid.cells), winning.reshape(grid.cells)
    out = (boxes[:, 0] < 0) | (boxes[:, 1] >= count)
    out[:, list(grid.periodic)] = False
    lost = np.zeros(len(boxes), dtype=np.int64)
    for m, (low, high) in enumerate(boxes):
        axes = [
            np.unique(np.arange(a, b + 1) % n) if j in grid.periodic else np.arange(max(a, 0), min(b, n - 1) + 1)
            for j, (a, b, n) in enumerate(zip(low, high, count, strict=True))
        ]
        lost[m] = np.count_nonzero(~table[np.ix_(*axes)])
    return out, lost


def _inputs(problem: SynthesisProblem, boxes: Ints, leaves: Bools, lost: Ints) -> Sequence[str]:
    names, M = problem.space.states, len(boxes)
    along = [f"{int(n)} along {name}" for n, name in zip(leaves.sum(axis=0), names, strict=True) if n]
    inside = ~leaves.any(axis=1)
    said = [f"Of {M} inputs {M - int(inside.sum())} may leave the region ({', '.join(along)})."] if along else []
    bad = inside & (lost > 0)
    if bad.any():
        m = int(np.flatnonzero(bad)[np.argmin(lost[bad])])
        size, best = boxes[m, 1] - boxes[m, 0] + 1, problem.inputs[m].tolist()
        many = f"{int(np.prod(size))} ({' x '.join(map(str, size))})"
        said.append(f"{int(bad.sum())} of {M} may end in cells that lose; the best, {best}, in {lost[m]} of {many}.")
    if (inside & (lost == 0)).any():
        said.append("The others end in cells that win, but what their path touches between samples may not.")
    return said
