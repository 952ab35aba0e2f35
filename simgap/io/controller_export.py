"""A controller as a file for machines without simgap: a C header, or a Python file that needs no package.

Both look a cell up as `Grid.finder` does, with the same operations on doubles in the same order, and hold the input
that the controller's rule picks in each cell. What they promise is what the controller promises, of the measured state
in the units of the case; they say -1 (Python: raise) where it has no input.
"""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import wrap

import numpy as np

from simgap.errors import UserError
from simgap.io.atomic import write_text
from simgap.synthesis.controller import Controller

ENDINGS = (".h", ".py")


def export_controller(controller: Controller, path: Path | str) -> None:
    """Write the controller as a C header (`name.h`) or as Python (`name.py`).

    Raises:
        UserError: another ending, or a file name of which no identifier can be made.
    """
    path = Path(path)
    if path.suffix not in ENDINGS:
        raise UserError("is neither a C header nor Python", file=path, remedy="Let the name end with .h or .py.")
    name = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    if not re.match(r"[A-Za-z]", name):
        raise UserError("begins with no letter, but names in it do", file=path, remedy="Give another file name.")
    write_text(path, _c(controller, name) if path.suffix == ".h" else _python(controller, name))


def _about(c: Controller) -> list[str]:
    made_for = c.metadata.get("case", "a case")
    state = f"x = ({', '.join(c.states)}), as measured, in the units of the case"
    promise = f"Controller of '{made_for}', by simgap, rule {c.rule}. {state}; u = ({', '.join(c.input_names)})."
    lines = wrap(re.sub(r"[^ -~]", "?", promise).replace("*/", "* /").replace('"""', "'''"), 100)
    if c.late:
        lines += ["An input acts one sample after it is chosen: remember it, beginning with FIRST, and give it back."]
    elif c.memory > 1:
        lines += ["The class of the previous input is part of its state: remember it, beginning with FIRST."]
    return lines


def _numbers(values: np.ndarray) -> str:
    """Shortest decimals that read back as the same doubles."""
    return ", ".join(repr(float(v)) for v in np.asarray(values, dtype=np.float64).reshape(-1))


def _table(values: np.ndarray) -> str:
    text = [str(v) for v in np.asarray(values).tolist()]
    return ",\n".join(",".join(text[k : k + 40]) for k in range(0, len(text), 40))


def _kinds(c: Controller) -> np.ndarray:
    return np.zeros(len(c.input_set), dtype=np.int64) if c.kind is None else c.kind


def _c(c: Controller, name: str) -> str:
    grid, big = c.grid, name.upper()
    nx, nu, m = grid.box.size, c.input_set.shape[1], len(c.input_set)
    wraps = ", ".join(str(int(j in grid.periodic)) for j in range(nx))
    kinds = _kinds(c)
    about = "\n".join(f" * {line}" for line in _about(c))
    nested = ",\n  ".join("{" + _numbers(row) + "}" for row in c.input_set)
    classes = int(kinds.max()) + 1
    following = f"chosen * {classes} + {name}_kind[memory / {classes}]" if c.late else f"{name}_kind[chosen]"
    acting = f"memory / {classes}" if c.late else "chosen"
    return f"""\
/*
{about}
 * Needs no library, allocates nothing. Compile without -ffast-math, so that cells are found as simgap finds them.
 */
#ifndef {big}_H
#define {big}_H
typedef char {name}_needs_doubles_of_64_bits[sizeof(double) == 8 ? 1 : -1];
#define {big}_STATES {nx}
#define {big}_INPUTS {nu}
#define {big}_CHOICES {m}
#define {big}_CELLS {grid.size}L
#define {big}_MEMORY {c.memory}L
#define {big}_FIRST {c.first}L

static const double {name}_low[{nx}] = {{{_numbers(grid.box.lo)}}};
static const double {name}_high[{nx}] = {{{_numbers(grid.box.hi)}}};
static const double {name}_width[{nx}] = {{{_numbers(2.0 * grid.h)}}};
static const long {name}_cells[{nx}] = {{{", ".join(map(str, grid.cells))}}};
static const int {name}_wraps[{nx}] = {{{wraps}}};
static const double {name}_inputs[{m}][{max(nu, 1)}] = {{
  {nested}
}};
static const short {name}_kind[{m}] = {{{", ".join(str(k) for k in kinds.tolist())}}};
static const short {name}_choice[{len(c.choice)}] = {{
{_table(c.choice)}
}};

/* Number of the cell that holds x, -1 outside or for what is no number. */
static long {name}_cell(const double x[{nx}]) {{
  long flat = 0;
  int j;
  for (j = 0; j < {nx}; ++j) {{
    double place = (x[j] - {name}_low[j]) / {name}_width[j];
    long k, count = {name}_cells[j];
    if (!(place > -1e9 && place < 1e9)) return -1;
    k = (long)place;
    if ((double)k > place) --k;
    if (k == count && x[j] <= {name}_high[j]) --k;
    if ({name}_wraps[j]) k = ((k % count) + count) % count;
    else if (k < 0 || k >= count) return -1;
    flat = flat * count + k;
  }}
  return flat;
}}

/* Number of the input to choose at x, -1 where there is none: outside the winning domain, or where the task is done. */
static int {name}_choose(const double x[{nx}], long memory) {{
  long cell = {name}_cell(x);
  if (cell < 0 || memory < 0 || memory >= {big}_MEMORY) return -1;
  return {name}_choice[cell * {big}_MEMORY + memory];
}}

/* Number of the input that acts now, and the memory for the next sample. */
static int {name}_acting(long memory, int chosen) {{ (void)memory; (void)chosen; return (int)({acting}); }}
static long {name}_next(long memory, int chosen) {{ (void)memory; (void)chosen; return {following}; }}

/* The input to choose at x: -> its number, its values in u; -1 and u untouched where there is none. */
static int {name}_input(const double x[{nx}], long memory, double u[{max(nu, 1)}]) {{
  int j, chosen = {name}_choose(x, memory);
  if (chosen >= 0) for (j = 0; j < {nu}; ++j) u[j] = {name}_inputs[chosen][j];
  return chosen;
}}
#endif
"""


def _python(c: Controller, name: str) -> str:
    grid, kinds = c.grid, _kinds(c)
    about = "\n".join(_about(c))
    classes = int(kinds.max()) + 1
    acting = f"memory // {classes}" if c.late else "chosen"
    following = f"chosen * {classes} + KIND[memory // {classes}]" if c.late else "KIND[chosen]"
    return f'''\
"""{about}

    from {name} import choose, INPUTS

Needs the standard library alone.
"""

from math import floor, isfinite

STATES = {list(c.states)!r}
INPUT_NAMES = {list(c.input_names)!r}
LOW = [{_numbers(grid.box.lo)}]
HIGH = [{_numbers(grid.box.hi)}]
WIDTH = [{_numbers(2.0 * grid.h)}]
CELLS = {list(grid.cells)!r}
WRAPS = {[j in grid.periodic for j in range(grid.box.size)]!r}
INPUTS = {c.input_set.tolist()!r}
KIND = {kinds.tolist()!r}
MEMORY, FIRST = {c.memory}, {c.first}
CHOICE = [
{_table(c.choice)}
]


def cell(x):
    """Number of the cell that holds x, -1 outside."""
    if len(x) != {grid.box.size} or not all(isfinite(v) for v in x):
        raise ValueError(f"a state is {grid.box.size} finite numbers, not {{x}}")
    flat = 0
    for value, low, high, width, count, wraps in zip(x, LOW, HIGH, WIDTH, CELLS, WRAPS):
        place = (value - low) / width
        if not abs(place) < 1e9:
            return -1
        k = floor(place)
        if k == count and value <= high:
            k -= 1
        if wraps:
            k %= count
        elif not 0 <= k < count:
            return -1
        flat = flat * count + k
    return flat


def choose(x, memory=FIRST):
    """Number of the input to choose at x, -1 where there is none."""
    where = cell(x)
    if not 0 <= memory < MEMORY:
        raise ValueError(f"memory is a number from 0 to {{MEMORY - 1}}, not {{memory}}")
    return CHOICE[where * MEMORY + memory] if where >= 0 else -1


def after(memory, chosen):
    """Number of the input that acts now, and the memory for the next sample."""
    return {acting}, {following}


def input(x, memory=FIRST):
    """The input to choose at x; ValueError where there is none."""
    chosen = choose(x, memory)
    if chosen < 0:
        raise ValueError(f"the controller has no input at {{list(x)}}")
    return INPUTS[chosen]
'''
