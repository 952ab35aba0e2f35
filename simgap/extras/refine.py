"""Along which axes a grid of samples has to be fine: from lines of samples through X, one axis at a time.

On a line with many points, what the gap (less the basis) moves from the middle of a cell to elsewhere in it is known
for every number of cells. Summed over the axes it is what a bound loses between its samples, and the cells go where
one more of them takes most of that away.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from simgap.arrays import Floats
from simgap.config.controller import SynthesisSection
from simgap.errors import UserError
from simgap.gap.bases import Blocks
from simgap.gap.fitting.dimension_fit import listed_basis
from simgap.gap.sampling.points import covering_grid, free_axes, own_point, remembers
from simgap.geometry import Box
from simgap.plants.context import Context
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out_alike

POINTS, LINES = 192, 64
"""Points of a line, and lines along each axis at random places. Judgement: 12,000 roll-outs an axis, a few seconds."""
COUNTS = (4, 6, 8, 12, 16, 24, 32, 48, 96)
"""Cells along an axis that are weighed: each has an even number of points; four are the fewest that a slope takes."""


def random_lines(box: Box, inputs: Floats, axis: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """States (LINES POINTS, nx) and inputs (LINES POINTS, nu) on lines along an axis of the box.

    They go through random states under random inputs of U (M, nu), the points in the middle of as many equal parts.
    """
    x = np.repeat(rng.uniform(box.lo, box.hi, (LINES, box.size)), POINTS, axis=0)
    lo, hi = box.lo[axis], box.hi[axis]
    x[:, axis] = np.tile(lo + (hi - lo) * (np.arange(POINTS) + 0.5) / POINTS, LINES)
    return x, np.repeat(inputs[rng.integers(0, len(inputs), LINES)], POINTS, axis=0)


def movement(values: Floats) -> dict[int, Floats]:
    """Mean over the cells of the largest distance from the value in the middle: (LINES, POINTS, nx) -> count: (nx,)."""
    found = {}
    for count in COUNTS:
        cells = values.reshape(len(values), count, POINTS // count, -1)
        half = cells.shape[2] // 2
        middle = 0.5 * (cells[:, :, half - 1] + cells[:, :, half])
        found[count] = np.abs(cells - middle[:, :, None]).max(axis=2).mean(axis=(0, 1))
    return found


def at_count(moved: Mapping[int, Floats], count: int) -> Floats:
    """Movement at a count between those of COUNTS, (nx,): linear in its logarithm, the ends held."""
    where = np.log(COUNTS)
    every = np.stack([moved[n] for n in COUNTS])
    return np.array([np.interp(math.log(count), where, own) for own in every.T])


def counts_for(moved: Sequence[Mapping[int, Floats]], weights: Floats, most: int) -> tuple[int, ...]:
    """Cells along each axis, at most `most` in all: greedily where a step up takes most away for its cost.

    Args:
        moved: for each axis, see `movement`. weights: (nx,), of the states, for what is lost to be one number.
    """
    chosen = [COUNTS[0]] * len(moved)
    following = dict(pairwise(COUNTS))
    while True:
        gains = {}
        for j, own in enumerate(moved):
            n = chosen[j]
            if n not in following or math.prod(chosen) // n * following[n] > most:
                continue
            less = float(weights @ (own[n] - own[following[n]]))
            gains[j] = less / math.log(following[n] / n)
        if not gains or max(gains.values()) <= 0.0:
            return _filled(chosen, most)
        best = max(gains, key=gains.__getitem__)
        chosen[best] = following[chosen[best]]


def _filled(counts: Sequence[int], most: int) -> tuple[int, ...]:
    """Counts with the samples that are left, spread evenly over the axes."""
    more = (most / math.prod(counts)) ** (1.0 / len(counts))
    return tuple(int(n * more * (1.0 + 1e-12)) for n in counts)


SEED = 0


@dataclass(frozen=True)
class Refined:
    """A grid of samples for a case.

    Attributes:
        cells: along each state on which the gap may depend. half_widths: of them, in the states' units.
        blocks: of the bound, where its basis is a table. samples: of all inputs.
        now, then: for each state what the gap less the basis moves within a cell, on average, today and on this grid.
    """

    cells: Mapping[str, int]
    half_widths: Mapping[str, float]
    blocks: tuple[int, ...]
    samples: int
    now: Mapping[str, float]
    then: Mapping[str, float]

    def block(self) -> str:
        """The section of a case file, and the change of the bound's basis if it needs one."""
        widths = ", ".join(f"{name}: {width:.4g}" for name, width in self.half_widths.items())
        cells = " x ".join(map(str, self.cells.values()))
        lines = [f"# {cells} cells of {', '.join(self.cells)}: {self.samples:,} samples", "grid:"]
        lines.append(f"  half_widths: {{{widths}}}")
        if self.blocks:
            lines += ["gap:", f"  basis: {{kind: blocks, blocks: [{', '.join(map(str, self.blocks))}]}}"]
        return "\n".join(lines)


def refine(path: Path, samples: int | None, tell: Callable[[str], None], workers: int = 2) -> Refined:
    """The grid with which a bound of this case loses least between its samples.

    Args:
        samples: at most so many, all inputs counted; as many as the case has now if None.

    Raises:
        UserError: a case without grid, domain, simulator or bound, one whose simulator remembers earlier inputs, or
            fewer samples than the least grid has.
    """
    context = Context.load(path)
    with context.blame():
        case = context.case
        if remembers(case):
            raise UserError(
                "a gap over histories has no grid of states", key="hidden_state",
                remedy="`simgap refine` is for bounds over X; leave it out.",
            )  # fmt: skip
        section, box, inputs = context.need(case.gap, "gap"), context.box, context.input_set
        today = covering_grid(case, box, own_point(case))
        moving = [j for j in range(box.size) if j not in free_axes(case)]
        most = (samples or today.size * len(inputs)) // len(inputs)
        if most < COUNTS[0] ** len(moving):
            raise UserError(
                f"{samples:,} samples are fewer than four cells along each axis and {len(inputs)} inputs take",
                key="--samples", remedy=f"Give at least {COUNTS[0] ** len(moving) * len(inputs)}.",
            )  # fmt: skip
        left = _left(context, moving, tell, workers)
        moved = [movement(values) for values in left]
        weights = _weights(context, case.synthesis, left)
        chosen = counts_for(moved, weights, most)
    names = context.states
    cells = {names[j]: n for j, n in zip(moving, chosen, strict=True)}
    width = box.hi - box.lo
    table = isinstance(section.basis, Blocks)
    return Refined(
        cells,
        {names[j]: float(width[j] / (2 * n)) for j, n in zip(moving, chosen, strict=True)},
        tuple(cells.get(n, 1) for n in names) if table else (),
        math.prod(chosen) * len(inputs),
        _by_state(names, [at_count(own, today.cells[j]) for own, j in zip(moved, moving, strict=True)]),
        _by_state(names, [at_count(own, n) for own, n in zip(moved, chosen, strict=True)]),
    )


def _left(context: Context, moving: list[int], tell: Callable[[str], None], workers: int) -> list[Floats]:
    """Along each axis, what the basis leaves of the gap at the points of the lines, (LINES, POINTS, nx)."""
    rng, box = np.random.default_rng(SEED), context.box
    lines = [random_lines(box, context.input_set, j, rng) for j in moving]
    x, u = (np.concatenate(part) for part in zip(*lines, strict=True))
    tell(f"{len(x):,} roll-outs on lines through X")
    parts = zip(np.array_split(x, workers), np.array_split(u, workers), strict=True)
    jobs = [(context.case, context.folder, a, b) for a, b in parts]
    following = np.concatenate([own for own, _ in run_in_processes(roll_out_alike, jobs, workers, None)])
    d = following - context.plant.sampled.step(x, u)
    section = context.need(context.case.gap, "gap")
    if not isinstance(section.basis, Blocks):
        names = context.states, context.inputs
        basis = listed_basis(section.basis, *names, box, free_axes(context.case)).evaluate(x, u)
        d = d - basis @ np.linalg.lstsq(basis, d, rcond=None)[0]
    return [np.ascontiguousarray(part.reshape(-1, POINTS, box.size)) for part in np.array_split(d, len(moving))]


def _weights(context: Context, synthesis: SynthesisSection | None, left: list[Floats]) -> Floats:
    """One over a cell of the controller, or over the size of what is left where the case asks for none."""
    if synthesis is not None:
        return np.array(synthesis.cells) / (context.box.hi - context.box.lo)
    size = np.max([np.abs(values).max(axis=(0, 1)) for values in left], axis=0)
    return np.asarray(1.0 / np.where(size > 0.0, size, np.inf))


def _by_state(names: list[str], parts: list[Floats]) -> dict[str, float]:
    return dict(zip(names, np.sum(parts, axis=0).tolist(), strict=True))
