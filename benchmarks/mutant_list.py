"""The faults of `mutants.py`: file, what goes wrong, the text that stands there, what replaces it, who must notice."""

from __future__ import annotations

from dataclasses import dataclass

INTERVALS = ("tests/model/test_interval_definitions.py",)
KERNELS = ("tests/synthesis/test_kernel_definitions.py",)
WAVES = ("tests/synthesis/test_row_waves.py",)
BOUNDS = ("tests/gap/test_bound_definitions.py",)
SETS = ("tests/specifications/test_margins_of_sets.py",)
BORDERS = ("tests/gap/test_borders.py",)
RANGES = ("tests/gap/test_gap_ranges.py",)
SYMMETRY = ("tests/gap/test_symmetry.py",)
JUDGE = ("tests/test_judge.py",)
BESIDE = (
    "tests/synthesis/test_synthesis_controller.py::test_outside_the_grid_there_is_nothing_though_its_last_cell_wins",
)
PLACES = ("tests/specifications/test_sections.py", "tests/specifications/test_surroundings.py")
TURNS = ("tests/gap/test_gap_periodic.py",)
PROBE = ("tests/simulators/test_probe.py",)
_LINES = "tests/checker/test_checker.py::test_"
REPEATS = (
    f"{_LINES}on_a_circle_equations_repeat_and_what_is_one_state_is_said",
    f"{_LINES}how_far_an_expression_moves_after_a_turn_is_what_its_values_say",
)
ROUNDED = (f"{_LINES}rounding_that_is_left_out_of_a_bound_is_found",)
COMPILED = (RANGES, WAVES, TURNS, INTERVALS)
"""Tests whose code asks for compiled kernels: what they call is handed over by address, which Python has none of, or is
asked for the sine of infinity, at which Python raises."""


@dataclass(frozen=True)
class Mutant:
    """One fault: in `file` the text `old`, which stands there once, becomes `new`; `tests` must fail."""

    file: str
    fault: str
    old: str
    new: str
    tests: tuple[str, ...]


def _of(
    file: str, tests: tuple[str, ...], *faults: tuple[str, str, str] | tuple[str, str, str, tuple[str, ...]]
) -> list[Mutant]:
    made = []
    for fault in faults:
        own = fault[3] if len(fault) == 4 else tests
        made.append(
            Mutant(file if file.startswith("checker/") else f"simgap/{file}", fault[0], fault[1], fault[2], own)
        )
    return made


MUTANTS: list[Mutant] = [
    *_of(
        "model/interval.py",
        INTERVALS,
        ("sums are not rounded outward", "return widen(a[0] + b[0], a[1] + b[1])", "return a[0] + b[0], a[1] + b[1]"),
        (
            "products are not rounded outward",
            "return widen(min(min(p, q), min(r, s)), max(max(p, q), max(r, s)))",
            "return min(min(p, q), min(r, s)), max(max(p, q), max(r, s))",
        ),
        ("a product's lower end looks at two corners", "min(min(p, q), min(r, s))", "min(p, s)"),
        ("a product's upper end looks at two corners", "max(max(p, q), max(r, s))", "max(p, s)"),
        ("inverses are not rounded outward", "return widen(1.0 / a[1], 1.0 / a[0])", "return 1.0 / a[1], 1.0 / a[0]"),
        (
            "an inverse ignores a zero on its end",
            "if a[0] <= 0.0 <= a[1]:\n        return -np.inf",
            "if a[0] < 0.0 < a[1]:\n        return -np.inf",
        ),
        ("an even power forgets that it turns at 0", "small = 0.0 if a[1] >= 0.0 else -a[1]", "small = abs(a[1])"),
        ("powers are not rounded outward", "return _moved(lo, hi, (n + 1) * _LIBM)", "return lo, hi"),
        (
            "roots are not rounded outward",
            "lo, hi = widen(math.sqrt(max(a[0], 0.0)), math.sqrt(max(a[1], 0.0)))",
            "lo, hi = math.sqrt(max(a[0], 0.0)), math.sqrt(max(a[1], 0.0))",
        ),
        (
            "library functions are not rounded outward",
            "return _moved(lo, hi, _LIBM)",
            "return lo, hi",
        ),
        ("a sine misses its top", "-0.5 * _PI, 0.5 * _PI)", "-0.5 * _PI, 1.5 * _PI)"),
        ("a sine misses its bottom", "-0.5 * _PI, 0.5 * _PI)", "0.5 * _PI, 0.5 * _PI)"),
        ("a cosine misses its top", "_PI, 0.0)", "_PI, _PI)"),
        ("a cosine misses its bottom", "_PI, 0.0)", "0.0, 0.0)"),
        ("sin(x)/x is not negative enough", "return -0.2173,", "return -0.21,"),
        ("a tangent misses one pole", "_holds(a, 0.5 * _PI) or ", ""),
        ("a size forgets the negative end", "return 0.0, max(-a[0], a[1])", "return 0.0, a[1]"),
        (
            "the larger of two takes the smaller upper end",
            "return max(a[0], b[0]), max(a[1], b[1])",
            "return max(a[0], b[0]), min(a[1], b[1])",
        ),
        (
            "a hull of branches takes the first upper end",
            "return min(a[0], b[0]), max(a[1], b[1])",
            "return min(a[0], b[0]), a[1]",
        ),
    ),
    *_of(
        "synthesis/abstraction/post.py",
        KERNELS,
        ("the rounding pad of cells is dropped", "grow = data[4 * n + j] + data[5 * n + j]", "grow = data[4 * n + j]"),
        (
            "a cell is not widened by the measurement error",
            "grow = data[4 * n + j] + data[5 * n + j]",
            "grow = data[5 * n + j]",
        ),
        (
            "a cell is widened on one side alone",
            "hi[j] = min(left + data[n + j] + grow,",
            "hi[j] = min(left + data[n + j],",
        ),
        (
            "the rounding pad of posts is dropped",
            "data[n + i], data[4 * n + i] + data[5 * n + i]",
            "data[n + i], data[4 * n + i]",
        ),
        (
            "a post ignores the next measurement's error",
            "data[n + i], data[4 * n + i] + data[5 * n + i]",
            "data[n + i], data[5 * n + i]",
        ),
        (
            "a post's lower end is not widened",
            "np.floor((lo - grow - origin) / width)",
            "np.floor((lo - origin) / width)",
        ),
        (
            "a post's upper end is not widened",
            "np.floor((hi + grow - origin) / width)",
            "np.floor((hi - origin) / width)",
        ),
        ("infinite posts become cells", "if not (-largest < lo and hi < largest):", "if not (-largest < lo):"),
        ("a group's gap ignores its last cell", "index[n - 1] += extra\n", "index[n - 1] += extra - 1\n"),
        (
            "a group's gap starts at its second cell",
            "cell_box(index, n, data, lo, spare)",
            "cell_box(index + 1, n, data, lo, spare)",
        ),
        ("slopes of one sign spread nothing", "spread += max(-a, b) * r", "spread += max(a, b) * r"),
        (
            "the image's upper end has no spread",
            "hi[i] = value[i][1] + spread * (1.0 + 2.0**-48)",
            "hi[i] = value[i][1]",
        ),
        (
            "the image's lower end has no spread",
            "lo[i] = value[i][0] - spread * (1.0 + 2.0**-48)",
            "lo[i] = value[i][0]",
        ),
        (
            "a tabulated gap moves its upper end by the lower",
            "out[d, row, m, 1] += work[3, which[d]]",
            "out[d, row, m, 1] += work[2, which[d]]",
        ),
        ("offsets are counted from the face, not the centre", "axis[i] = -0.5 * axis[n + i]", "axis[i] = 0.0"),
    ),
    *_of(
        "synthesis/games/row_waves.py",
        WAVES,
        ("erosions begin where the set changed", "start = r - widest + 1", "start = r"),
        ("the swept box may leave the slab", "0 <= q // words + clear_rows < rows", "True"),
        ("free cells are not looked at", "if word and clear_at >= 0:", "if word and clear_at < -1:"),
        ("a slab's neighbours are forgotten", "out[q] & won[slab, q]", "out[q] | won[slab, q]"),
        (
            "only the first input of equal moves is noted",
            "range(inputs_from[v], inputs_from[v + 1])",
            "range(inputs_from[v], inputs_from[v] + 1)",
        ),
        ("entries of a word are those of the one before", "placed[n, 1]", "placed[n - 1, 1]"),
        ("levels are written a cell too low", "value[start + j * stride, c] = level", "value[start, c] = level"),
    ),
    *_of(
        "synthesis/games/row_moves.py",
        WAVES,
        ("boxes wrap where axes end", "(low + size <= lead[0])", "(low <= lead[0])"),
        ("rows have no empty bits behind them", "(count + farthest + 63) // 64", "(count + 63) // 64"),
    ),
    *_of(
        "synthesis/input_sets.py",
        KERNELS,
        ("sensing windows do not wrap", "to &= np.roll(near, by, axis=0)", "to &= near"),
        ("sensing windows miss their last cell", "range(1, m + 1)", "range(1, m)"),
        ("margins are rounded down", "int(np.ceil(e / (2.0 * h) + 1e-9))", "int(np.floor(e / (2.0 * h) + 1e-9))"),
        (
            "an error on a face does not reach the next cell",
            "int(np.ceil(e / (2.0 * h) + 1e-9))",
            "int(np.ceil(e / (2.0 * h) - 1e-9))",
        ),
        ("measurements beyond X are not padded on both sides", "[c + 2 * int(p) for", "[c + int(p) for"),
    ),
    *_of(
        "synthesis/abstraction/cells.py",
        KERNELS,
        (
            "a box across the seam leaves the count",
            "holes = np.concatenate([holes, holes], axis=j)",
            "holes = np.concatenate([holes, 0 * holes], axis=j)",
        ),
        ("a box that leaves below is kept", "if lo < 0 or hi >= cells:", "if hi >= cells:"),
        ("a box that leaves above is kept", "if lo < 0 or hi >= cells:", "if lo < 0 or hi > cells:"),
        (
            "a box of a full turn loses its last cell",
            "boxes[at], boxes[at + n] = 0, cells - 1",
            "boxes[at], boxes[at + n] = 0, cells - 2",
        ),
        ("flat boxes miss their last row", "np.uint64(boxes[at + 2] + 1) * s0", "np.uint64(boxes[at + 2]) * s0"),
        (
            "solid boxes miss their last layer",
            "e, f = np.uint64(boxes[at + 2]), np.uint64(boxes[at + 5] + 1)",
            "e, f = np.uint64(boxes[at + 2]), np.uint64(boxes[at + 5])",
        ),
        ("boxes of four axes miss their last cells", "np.uint64(boxes[at + 7] + 1)", "np.uint64(boxes[at + 7])"),
    ),
    *_of(
        "synthesis/abstraction/intersample.py",
        KERNELS,
        (
            "swept boxes ignore the heading's error",
            "rotated_box(t0 - off, t0 + step + off, box[m, 0]",
            "rotated_box(t0, t0 + step, box[m, 0]",
        ),
        (
            "swept boxes look at one heading of a layer",
            "rotated_box(t0 - off, t0 + step + off, box[m, 0]",
            "rotated_box(t0 - off, t0 + off, box[m, 0]",
        ),
        (
            "swept cells forget the width of the start's cell",
            "np.ceil(1.0 + b / width - SHRINK) - 1",
            "np.ceil(b / width - SHRINK) - 1",
        ),
    ),
    *_of(
        "synthesis/abstraction/intersample.py",
        SETS,
        (
            "a path strays for a quarter of the sampling time",
            "needed = 0.5 * tau * speed",
            "needed = 0.25 * tau * speed",
        ),
        ("what the real plant adds between samples is left out", ".max(axis=0) + added", ".max(axis=0)"),
        (
            "rates are bounded at the samples alone",
            "low, high = region.lo - reach, region.hi + reach",
            "low, high = region.lo, region.hi",
        ),
        ("rates backwards do not count", "np.maximum(np.abs(low), np.abs(high))", "np.abs(high)"),
    ),
    *_of(
        "specifications/reaching.py",
        SETS,
        (
            "the target ignores the sensing error",
            "lo, hi = box.lo + game.error, box.hi - game.error",
            "lo, hi = box.lo, box.hi",
        ),
        (
            "free cells ignore the sensing error",
            "self.free(game.space, game.grid, game.stray + game.error)",
            "self.free(game.space, game.grid, game.stray)",
        ),
        (
            "free cells ignore the path between samples",
            "self.free(game.space, game.grid, game.stray + game.error)",
            "self.free(game.space, game.grid, game.error)",
        ),
    ),
    *_of(
        "specifications/arena.py",
        SETS,
        (
            "walls need no clearance",
            "lo, hi = grid.box.lo + walls, grid.box.hi - walls",
            "lo, hi = grid.box.lo, grid.box.hi - walls",
        ),
        ("obstacles do not grow", "cells_meeting(grid, grown(box, keep))", "cells_meeting(grid, box)"),
    ),
    *_of(
        "specifications/space.py",
        KERNELS,
        ("cells that stick out lie within", "(low >= lo) & (high <= hi)", "(low >= lo) & (low <= hi)"),
        ("cells that are met by a part are free", "(high > lo) & (low < hi)", "(low > lo) & (low < hi)"),
        (
            "no copy across the seam",
            "copies = (near - period, near, near + period)",
            "copies = (near, near, near + period)",
        ),
    ),
    *_of(
        "gap/bounds/cells.py",
        BOUNDS,
        ("tables are not rounded outward", "slack = 2.0**-48 * (abs(low) + abs(high)) + 1e-300", "slack = 0.0"),
        (
            "a face counts for the cell above it alone",
            'np.searchsorted(axis, a - margin, side="left") - 1',
            'np.searchsorted(axis, a + margin, side="left") - 1',
        ),
        (
            "tables end before the last touched cell",
            'np.searchsorted(axis, b + margin, side="right") - 1',
            'np.searchsorted(axis, a + margin, side="right") - 1',
        ),
    ),
    *_of(
        "gap/memory/bound.py",
        BOUNDS,
        ("the heading deviation is not added", "raised = margin + deviation.largest", "raised = margin"),
        (
            "the margin of random sequences is not added",
            "raised = margin + deviation.largest",
            "raised = deviation.largest",
        ),
        ("paths between recorded poses are not added", " + robot.between_poses)", ")"),
    ),
    *_of(
        "gap/memory/hidden_state.py",
        BOUNDS,
        (
            "sequences below the hull do not count",
            "np.maximum(np.maximum(lower[own] - outer[0], outer[1] - upper[own]), 0.0)",
            "np.maximum(outer[1] - upper[own], 0.0)",
        ),
    ),
    *_of(
        "gap/memory/hidden_state.py",
        BOUNDS,
        ("hulls keep their first upper end", "np.maximum.at(hi, m, values)", "np.maximum.at(hi, m[:1], values[:1])"),
        (
            "the influence of older inputs has a sign",
            "np.abs(responses - responses[-1]).max(axis=1)",
            "(responses - responses[-1]).max(axis=1)",
        ),
    ),
    *_of(
        "statistics.py",
        BOUNDS,
        ("nothing is extrapolated beyond the largest excess", "* r / (1.0 - r))", "* 0.0)"),
    ),
    *_of(
        "gap/bounds/body_frame.py",
        BOUNDS,
        (
            "heading bounds are not rounded outward",
            "slack = 2.0**-48 * (abs(lower[m, k]) + abs(upper[m, k])) + 1e-300",
            "slack = 0.0",
        ),
    ),
    *_of(
        "gap/sampling/symmetry.py",
        BOUNDS,
        (
            "deviations between headings have a sign",
            "off = np.abs(turned - reference[None])",
            "off = turned - reference[None]",
        ),
    ),
    *_of(
        "gap/bounds/body_frame.py",
        SYMMETRY,
        (
            "a turned box misses its farthest point",
            "    if np.floor(hi / (2.0 * np.pi) + 1e-12) >= np.ceil(lo / (2.0 * np.pi) - 1e-12):\n        high = 1.0",
            "    if False:\n        high = 1.0",
        ),
        ("a turned box has three corners", "for corner in range(4):", "for corner in range(3):"),
    ),
    *_of(
        "gap/lipschitz/grid.py",
        BOUNDS,
        (
            "the change of slope is left out",
            "(to_cells(step, j, grid) + turns(step, j, grid, axes)) / (2.0",
            "to_cells(step, j, grid) / (2.0",
        ),
        ("slopes look ahead alone", "return np.maximum(np.abs(forward), np.abs(backward))", "return np.abs(forward)"),
        (
            "the first end of a range decides its slopes",
            "np.maximum(getattr(a, name), getattr(b, name)) for name in",
            "getattr(a, name) for name in",
        ),
    ),
    *_of(
        "gap/lipschitz/estimates.py",
        RANGES,
        (
            "slopes are those of the lower end",
            "samples.floor) for d in samples.ends])",
            "samples.floor) for d in samples.ends[:1]])",
        ),
    ),
    *_of(
        "gap/sampling/borders.py",
        BORDERS,
        (
            "the upper side covers the lower end",
            "return self.upper if upper else -self.lower",
            "return self.lower if upper else -self.lower",
        ),
        ("X has no upper faces", "else [domain.box.lo[j], domain.box.hi[j]])", "else [domain.box.lo[j]])"),
        (
            "surfaces have one side",
            "parts += [_along(domain, function, j, every, fixed) for j in function.axes]",
            "parts += []",
        ),
        ("rest is missed by a rounding error", "np.where((left <= 0.0) & (right >= 0.0), 0.0, root)", "root + 1e-18"),
    ),
    *_of(
        "gap/lipschitz/local.py",
        RANGES,
        (
            "local padding leaves the change of slope out",
            "to_cells(step, j, grid, expected) + turns(step, j, grid, axes)",
            "to_cells(step, j, grid, expected)",
        ),
    ),
    *_of(
        "gap/fitting/padding.py",
        RANGES,
        ("the padding per axis is not added", "raised = reach + fit.missing", "raised = fit.missing"),
        (
            "the gap's own constants are left out",
            "return float((lipschitz.constants + gradient) @ h)",
            "return float(gradient @ h)",
        ),
    ),
    *_of(
        "gap/fitting/acceptance.py",
        BOUNDS,
        ("samples below the bound are not counted", "excess = np.maximum(lo - d, top - hi)", "excess = top - hi"),
        (
            "the upper end of a range is not held against the bound",
            "top = d if d_upper is None else d_upper",
            "top = d",
        ),
        (
            "Clopper-Pearson forgets a violation",
            "betaincinv(violations + 1, n - violations,",
            "betaincinv(max(violations, 1), n - violations,",
        ),
    ),
    *_of(
        "statistics.py",
        BOUNDS,
        ("the rank is that of n scores", "math.ceil((n + 1) * level)", "math.ceil(n * level)"),
    ),
    *_of(
        "closed_loop.py",
        JUDGE,
        ("a level that stays is taken for one that falls", "(after < before)", "(after <= before)"),
        ("a step is held against the bound after its own input", "[REST, *r.inputs[:-1]]", "[*r.inputs]"),
        (
            "a successor is not moved by the turns of its state",
            "x, following = self.space.unwound(x, following)",
            "x, _ = self.space.unwound(x, following)",
        ),
        ("a state beyond the grid is in its last cell", "(~inside | (cells < 0))[1:]", "(~inside)[1:]"),
    ),
    *_of(
        "synthesis/controller.py",
        BESIDE,
        (
            "a lookup outside the grid is that of the last node",
            "np.where(rows >= 0, self.choice[rows], -1)",
            "self.choice[rows]",
        ),
        (
            "what is outside the grid is in the domain of the last cell",
            "np.where(cells >= 0, self.solution.winning[cells], False)",
            "self.solution.winning[cells]",
        ),
        (
            "what is outside the grid is in the target of the last cell",
            "np.where(cells >= 0, ended[cells], False)",
            "ended[cells]",
        ),
        (
            "a value outside the grid is that of the last node",
            "np.where(rows >= 0, self.solution.value[rows], -1)",
            "self.solution.value[rows]",
        ),
    ),
    *_of(
        "closed_loop.py",
        BESIDE,
        (
            "the loop looks up the last node outside the grid",
            "int(picked[cell * memory + pending]) if cell >= 0 else -1",
            "int(picked[cell * memory + pending])",
        ),
    ),
    *_of(
        "specifications/space.py",
        PLACES,
        ("a successor keeps its turns", "return x - turns, following - turns", "return x - turns, following", JUDGE),
        (
            "an axis wraps that a region cuts at its upper end",
            "region.lo[j] == self.box.lo[j] and region.hi[j] == self.box.hi[j]",
            "region.lo[j] == self.box.lo[j]",
        ),
    ),
    *_of(
        "specifications/space.py",
        PLACES,
        (
            "a copy of the target begins at 0",
            "np.mod(x[:, j] - lo, space.box.hi[j] - space.box.lo[j]) <= hi - lo",
            "np.mod(x[:, j], space.box.hi[j] - space.box.lo[j]) <= hi - lo",
        ),
    ),
    *_of(
        "specifications/arena.py",
        PLACES,
        ("what just touches touches nothing", "np.flatnonzero(clearance <= 0.0)", "np.flatnonzero(clearance < 0.0)"),
        ("upper walls are not there", "np.minimum(at - self.walls[0], self.walls[1] - at)", "(at - self.walls[0])"),
        (
            "an obstacle has no copies many turns away",
            "np.round((at[..., j] - centre) / self.period[j]) * self.period[j]",
            "np.zeros_like(at[..., j])",
        ),
        ("a chord is its beginning", "np.linspace(0.0, 1.0, POINTS)", "np.linspace(0.0, 0.0, POINTS)"),
    ),
    *_of(
        "gap/bounds/function.py",
        TURNS,
        (
            "parts of a box across the seam lose their rounding",
            "start, end = xlo[j] - back - slack, xhi[j] - back + slack",
            "start, end = xlo[j] - back, xhi[j] - back",
        ),
        (
            "parts of a box reach beyond X",
            "a[j], b[j] = max(start, lo[j]), min(end, hi[j])",
            "a[j], b[j] = start, end",
        ),
    ),
    *_of(
        "simulators/supervision.py",
        PROBE,
        ("calls are repeated at once", "time.sleep(PAUSE)", "time.sleep(0.0)"),
        ("calls are not repeated later", "elif len(x) >= BLOCK:", "elif not tried:"),
        ("second steps are not tried", "        if self._whole:\n", "        if not self._first.size:\n"),
        ("calls are repeated in the same order", "order = self._rng.permutation(CALLS)", "order = np.arange(CALLS)"),
    ),
    *_of(
        "checker/repeats.py",
        REPEATS,
        ("any angle counts as whole turns", "<= ROUNDING * abs(by)", "<= abs(by)"),
        ("a successor may move by parts of a period", ".denominator == 1)", ".denominator >= 1)"),
        ("the larger of two moves as the first does", "if len({*parts}) == 1 else None", "if parts else None"),
        ("a black box is not told", 'unknown = c.header["simulator"] is None', "unknown = False"),
    ),
    *_of(
        "checker/pairs.py",
        ROUNDED,
        (
            "a gap may leave its bound on part of a cell",
            "sound &= where.range(e)[0] >= 0",
            "sound &= where.range(e)[1] >= 0",
        ),
        ("the same in rational numbers", "any(where.range(e)[0] < 0", "any(where.range(e)[1] < 0"),
    ),
]
