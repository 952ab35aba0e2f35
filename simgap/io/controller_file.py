"""Controllers as files: a compressed .npz, and an export for machines without simgap (a C header, a Python file).

The .npz has equal bytes for equal controllers, and nothing in it is believed when it is read. Both exports look a cell
up as `Grid.finder` does, with the same operations on doubles in the same order, and hold the input that the
controller's rule picks in each cell; where the sets of admissible inputs are few enough, also those, and a shield as
`simgap.shield` has it. What they promise is what the controller promises, of the measured state in the
units of the case; they say -1 (Python: raise) where it has no input.
"""

from __future__ import annotations

import io
import json
import math
import re
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap import reading
from simgap.arrays import Bools, Ints
from simgap.errors import UserError, placed
from simgap.geometry import Box, Grid
from simgap.io.atomic import SEAL, seal_holds, sealed, write_text
from simgap.io.pages import text
from simgap.plants.context import Context
from simgap.reading import TooLarge, require_room
from simgap.specifications.base import specification_of
from simgap.specifications.solution import Progress, Solution
from simgap.specifications.space import Space
from simgap.synthesis.controller import Controller
from simgap.synthesis.input_sets import packed_width

MOST_INPUTS = 2**15 - 1  # the chosen input is stored in 16 bits


def require(holds: Any, problem: str) -> None:
    """Raise a UserError with the problem unless something holds."""
    if not holds:
        raise UserError(problem)


def controller_from(about: Mapping[str, Any], arrays: Arrays) -> Controller:
    """The controller of a file's metadata and arrays; without `mask` and `chosen` its admissible inputs are unknown.

    Raises:
        UserError: arrays that do not fit each other or the metadata. KeyError, TypeError, ValueError: other damage.
        TooLarge: more cells than there is memory for.
    """
    states, inputs = _names(about, "states"), _names(about, "inputs")
    grid, input_set = _grid(about, arrays, len(states)), arrays["input_set"]
    require(
        input_set.dtype == np.float64
        and input_set.ndim == 2
        and 1 <= len(input_set) <= MOST_INPUTS
        and input_set.shape[1] == len(inputs)
        and np.isfinite(input_set).all(),
        f"its inputs are not a table of finite numbers with the columns {', '.join(inputs)}",
    )
    memory, first, late, statistics = (about[name] for name in ("memory", "first", "late", "statistics"))
    require(type(late) is bool, "it does not say whether its inputs act late")
    kind = _kind(about["kind"], len(input_set))
    base = (len(input_set) if late else 1) * (1 if kind is None else int(kind.max()) + 1)
    progress = _progress(arrays, grid.size, base, about.get("persists", False), about.get("awaits", []))
    wanted = base * (1 if progress is None else progress.after.shape[1])
    require(type(memory) is int and memory == wanted, f"memory {memory!r:.40} cannot be")
    require(type(first) is int and 0 <= first < memory, f"it cannot begin with memory {first!r:.40}")
    require(isinstance(statistics, dict) and isinstance(about["provenance"], dict), "its metadata is not a mapping")
    mask, chosen = _inputs(arrays, grid.size * memory, len(input_set))
    solution = Solution(
        grid=grid,
        winning=_flags(arrays, "winning", grid.size),
        mask=mask,
        free=_flags(arrays, "free", grid.size),
        value=arrays.get("value"),
        target=_flags(arrays, "target", grid.size * memory) if "target" in arrays else None,
        memory=memory,
        first=first,
        late=late,
        kind=kind,
        statistics=statistics,
        acting=arrays.get("acting"),
        chosen=chosen,
        progress=progress,
    )
    _check_sets(solution)
    return Controller(input_set, states, inputs, solution, about["rule"], about["provenance"])


def _inputs(arrays: Arrays, nodes: int, count: int) -> tuple[NDArray[np.uint8], NDArray[np.int16] | None]:
    """The table of admissible inputs, or one without columns and the input of each node."""
    chosen = arrays.get("chosen")
    if chosen is None and "mask" not in arrays:
        require_room(nodes)  # no table says how many there are
        return np.empty((nodes, 0), np.uint8), None  # they were not asked for
    if chosen is not None:
        require(chosen.dtype == np.int16 and chosen.shape == (nodes,), "its inputs are not one a node")
        require(((chosen >= -1) & (chosen < count)).all(), "it admits inputs that do not exist")
        return np.empty((nodes, 0), np.uint8), chosen
    mask, shape = arrays["mask"], (nodes, packed_width(count))
    require(mask.dtype == np.uint8 and mask.shape == shape, f"its table of inputs has shape {mask.shape}, not {shape}")
    spare = 8 * shape[1] - count
    require(not (mask[:, -1] >> (8 - spare)).any() if spare else True, "it admits inputs that do not exist")
    return mask, None


def _kind(given: Any, inputs: int) -> Ints | None:
    """Classes of the previous input, every one of them in use."""
    if given is None:
        return None
    good = isinstance(given, list) and len(given) == inputs and all(type(c) is int and c >= 0 for c in given)
    require(good and {*given} == {*range(max(given) + 1)}, "its classes of previous inputs are not numbered")
    return np.array(given, dtype=np.int64)


def _progress(arrays: Arrays, cells: int, base: int, persists: Any, awaits: Any) -> Progress | None:
    """What a task has come to after a sample in each cell."""
    after = arrays.get("progress")
    if after is None:
        return None
    good = after.dtype == np.int16 and after.ndim == 2 and len(after) == cells and after.shape[1] > 0
    require(good and ((after >= 0) & (after < after.shape[1])).all(), "its task does not go on in every cell")
    require(type(persists) is bool, "it does not say whether its task is to stay")
    named = isinstance(awaits, list) and len(awaits) in (0, after.shape[1]) and all(isinstance(w, str) for w in awaits)
    require(named, "it does not say what each state of its task waits for")
    return Progress(after, base, persists, tuple(awaits))


def _names(about: Mapping[str, Any], key: str) -> tuple[str, ...]:
    names = about[key]
    good = isinstance(names, list) and all(isinstance(n, str) and n for n in names) and len({*names}) == len(names)
    require(good, f"its {key} are not distinct names")
    return tuple(names)


def _grid(about: Mapping[str, Any], arrays: Arrays, nx: int) -> Grid:
    box, cells, periodic = arrays["box"], arrays["cells"], about["periodic"]
    require(box.dtype == np.float64 and box.shape == (2, nx) and np.isfinite(box).all(), "its box is not 2 x states")
    require(cells.dtype == np.int64 and cells.shape == (nx,), "its cell counts are not one integer a state")
    good = isinstance(periodic, list) and all(type(j) is int and 0 <= j < nx for j in periodic)
    require(good and len({*periodic}) == len(periodic), "its periodic axes are not axes")
    return Grid(Box(*box), cells.tolist(), periodic)


def _flags(arrays: Arrays, name: str, size: int) -> Bools:
    packed = arrays[name]
    good = packed.dtype == np.uint8 and packed.shape == ((size + 7) // 8,)
    require(good, f"its set of {name} cells has another size than its grid")
    return np.unpackbits(packed, count=size).view(np.bool_)


def _check_sets(s: Solution) -> None:
    """Require of a solution: winning cells are allowed, have an input or are the end, and count down to it."""
    require(not (s.winning & ~s.free).any(), "it wins cells that the specification forbids")
    require((s.value is None) == (s.target is None), "it has a value function or a target, but not both")
    done = np.zeros(len(s.mask), np.bool_) if s.target is None else s.target
    known = s.mask.shape[1] > 0 or s.chosen is not None
    served = s.served if known else done if s.value is None else (s.value >= 0)
    began = s.at_first(done | served)
    require(not known or not (s.winning & ~began).any(), "it wins cells without an input")
    if s.acting is not None:
        require(s.chosen is None, "it keeps cells of the true state by one input each")
        shape = (s.grid.size, s.mask.shape[1])
        require(s.acting.dtype == np.uint8 and s.acting.shape == shape, "its inputs that may act are of other cells")
        first = s.acting[:, s.first >> 3] >> (s.first & 7) & 1
        same = s.late and s.kind is None and np.array_equal(first == 1, s.winning)
        require(same, "its starts are not where its first input may act")
    if s.value is not None:
        require(s.value.dtype == np.int32 and s.value.shape == (len(s.mask),), "its values are not one a node")
        # A measured cell may have a value without being won: winning are cells whose every measurement has one.
        require(np.array_equal(s.value >= 0, done | served), "its values and its inputs differ")
        require(not (s.winning & (s.at_first(s.value) < 0)).any(), "its values and its winning cells differ")
        require(not (done & (s.value < 0)).any(), "its target has no value")


REMEDY = "Run the synthesis stage again."
FEWER = "Use a machine with more memory, fewer cells (synthesis.cells) or fewer inputs (domain.U)."
_NEEDED = {"about", "box", "cells", "input_set", "winning", "free"}
_INPUTS = ("mask", "chosen", "acting")  # arrays that say which inputs are admissible, most of a file's bytes


def save_controller(controller: Controller, path: Path | str) -> None:
    """Write a controller, whole or not at all; equal controllers give equal bytes.

    Raises:
        UserError: one that is too large to be read again on this machine.
    """
    s, grid = controller.solution, controller.grid
    about = {
        "states": list(controller.states),
        "inputs": list(controller.input_names),
        "periodic": list(grid.periodic),
        "rule": controller.rule,
        "memory": s.memory,
        "first": s.first,
        "late": s.late,
        "kind": None if s.kind is None else s.kind.tolist(),
        "statistics": s.statistics,
        "provenance": controller.metadata,
        **({} if s.progress is None else {"persists": s.progress.persists, "awaits": list(s.progress.awaits)}),
    }
    arrays: dict[str, NDArray[Any]] = {
        "about": np.frombuffer(json.dumps(about, sort_keys=True).encode(), np.uint8),
        "box": np.stack([grid.box.lo, grid.box.hi]),
        "cells": np.array(grid.cells, np.int64),
        "input_set": controller.input_set,
        "winning": np.packbits(s.winning),
        "free": np.packbits(s.free),
        **({"mask": s.mask} if s.chosen is None else {"chosen": s.chosen}),
    }
    if s.value is not None and s.target is not None:
        arrays |= {"value": s.value, "target": np.packbits(s.target)}
    if s.acting is not None:
        arrays["acting"] = s.acting
    if s.progress is not None:
        arrays["progress"] = s.progress.after
    try:
        require_room(sum(array.nbytes for array in arrays.values()))
    except TooLarge as error:
        raise UserError(f"the controller {error.problem}", remedy=FEWER) from None
    with sealed(Path(path)) as temporary:
        write_arrays(temporary, arrays)


def load_controller(path: Path | str, whole: bool = True) -> Controller:
    """Read a controller, or without its admissible inputs, nearly all of its bytes: it refuses to be asked for one.

    Raises:
        UserError: a file that is missing, damaged, changed by hand or no controller at all, as far as it is read.
    """
    try:
        data = reading.read_bytes(Path(path))
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            require_room(sum(entry.file_size for entry in archive.infolist()))
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            require({*names} >= _NEEDED and ("mask" in names) != ("chosen" in names), "parts of it are missing")
            holds = seal_holds(data)
            require(holds is not None, "it has no checksum, so nothing says that it is whole")
            require(holds, "its checksum does not fit its content")
            arrays = {name: read_array(archive, name) for name in names if whole or name not in _INPUTS}
        return controller_from(json.loads(arrays["about"].tobytes().decode()), arrays)
    except FileNotFoundError:
        raise UserError("there is no such controller", file=path, remedy="Run the synthesis stage") from None
    except TooLarge as error:
        raise UserError(error.problem, file=path, remedy=FEWER) from None
    except _DAMAGE as error:
        problem = error.problem if isinstance(error, UserError) else f"{error!s:.120}"
        raise UserError(f"not a controller file ({problem})", file=path, remedy=REMEDY) from None


_DAMAGE = (
    UserError,
    AttributeError,  # an array that is no archive
    KeyError,
    TypeError,
    ValueError,
    OSError,
    EOFError,
    MemoryError,  # a damaged header may ask for any size
    RuntimeError,  # a flag that says encrypted or compressed some other way; a recursion without end
    zipfile.BadZipFile,
    zlib.error,
)


def load_controller_of(path: Path | str, wanted: Context, whole: bool = True) -> Controller:
    """Read the controller of a case, as `load_controller`.

    Raises:
        UserError: what `load_controller` refuses, and a controller of another case, named, of another U or task.
    """
    found = load_controller(path, whole)
    made_for = found.metadata.get("case")
    with placed(file=path, remedy=REMEDY):
        for what, one, other in (
            ("case", made_for, wanted.case.name),
            ("states", list(found.states), list(wanted.states)),
            ("inputs", list(found.input_names), list(wanted.inputs)),
        ):
            require(one == other, f"the controller is of another case: its {what} is {one}, that of this case {other}")
        same = np.array_equal(found.input_set, wanted.input_set)
        require(same, f"the controller of '{made_for}' is of another U than this case has")
        if wanted.case.synthesis is not None:
            space, sensing = Space.of(wanted.case), wanted.case.sensing
            error = space.vector(sensing.error if sensing is not None else {})
            specification_of(wanted.case).recognise(space, found.solution, error)
    wanted.own(path, found.metadata, "synthesis")
    return found


Arrays = Mapping[str, NDArray[Any]]
_EPOCH = (1980, 1, 1, 0, 0, 0)
_PIECE = 2**20  # bytes read_array at a time


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays in their order, and a place for their checksum."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.comment = SEAL.encode()
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry._compresslevel = 1  # type: ignore[attr-defined]  # zipfile has no other way for an open entry
            with archive.open(entry, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)


def read_array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """One array of the file, a piece at a time into its place.

    Raises:
        UserError: a header that says something else than how many bytes there are. Damage raises what zipfile raises.
    """
    entry = archive.getinfo(f"{name}.npy")
    with archive.open(entry) as stream:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise UserError("it is of another version of numpy's format")
        shape, columns_first, kind = np.lib.format.read_array_header_1_0(stream)
        if kind.hasobject or columns_first:
            raise UserError("its arrays are laid out in another way")
        size = math.prod(shape) * kind.itemsize
        if stream.tell() + size != entry.file_size:
            raise UserError("an array has another size than it says")
        array = np.empty(shape, kind)
        place, done = array.reshape(-1).view(np.uint8).data, 0
        while piece := stream.read(_PIECE):  # to the end, where the archive's own checksum is compared
            place[done : done + len(piece)] = piece
            done += len(piece)
    return array


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
        remedy = "Give another file name."
        raise UserError("does not begin with a letter, but names in it must", file=path, remedy=remedy)
    write_text(path, text(f"controller{path.suffix}.j2", **_content(controller, name)))


def _about(c: Controller) -> list[str]:
    made_for = c.metadata.get("case", "a case")
    state = f"x = ({', '.join(c.states)}), as measured, in the units of the case"
    promise = (
        f"Controller of '{made_for}', by simgap, rule {c.rule}. {state}; u = ({', '.join(c.input_names)}). At every "
        "sample: measure x, choose, apply u until the next one. Where nothing is chosen (-1) nothing is promised: stop "
        "safely."
    )
    if c.rule == "least_effort":
        promise += (
            " The smallest admissible input is taken: it may switch at every sample, and the state may drift to a "
            "border of the domain."
        )
    lines = wrap(re.sub(r"[^ -~]", "?", promise).replace("*/", "* /").replace('"""', "'''"), 100)
    if c.progress is not None:
        lines += [
            "What its task has come to is part of its state: remember it, beginning with FIRST. At every sample",
            "choose with the memory, then give observe(x, memory) and the choice to the function for the next one.",
        ]
    if c.late:
        lines += ["An input acts one sample after it is chosen: remember it, beginning with FIRST, and give it back."]
    elif c.kind is not None:
        lines += ["The class of the previous input is part of its state: remember it, beginning with FIRST."]
    return lines


def _numbers(values: np.ndarray) -> str:
    """Shortest decimals that read back as the same doubles."""
    return ", ".join(repr(float(v)) for v in np.asarray(values, dtype=np.float64).reshape(-1))


def _table(values: np.ndarray) -> str:
    numbers = [str(v) for v in np.asarray(values).tolist()]
    return ",\n".join(",".join(numbers[k : k + 40]) for k in range(0, len(numbers), 40))


def _content(c: Controller, name: str) -> dict[str, Any]:
    """Values for both templates."""
    task = c.progress
    kinds, box = np.zeros(len(c.input_set), dtype=np.int64) if c.kind is None else c.kind, c.grid.box
    choice, admitted, sets = c.choice, np.empty((0, 0), np.uint8), _sets(c)
    if sets is not None:
        choice, admitted = sets[1][:, :2].copy().view(np.int16)[:, 0], sets[1][:, 2:]
    least, most = c.input_set.min(axis=0), c.input_set.max(axis=0)
    return {
        "c": c, "name": name, "about": _about(c), "nx": box.size, "nu": c.input_set.shape[1], "m": len(c.input_set),
        "low": _numbers(box.lo), "high": _numbers(box.hi), "width": _numbers(2.0 * c.grid.h),
        "wraps": [j in c.grid.periodic for j in range(box.size)], "inputs": [_numbers(row) for row in c.input_set],
        "progress": "" if task is None else _table(task.after.reshape(-1)),
        "states": 1 if task is None else task.after.shape[1], "base": c.memory if task is None else task.base,
        "own": "memory" if task is None else f"(memory % {task.base})",
        "kept": "" if task is None else f"memory - memory % {task.base} + ",
        "kinds": kinds.tolist(), "classes": int(kinds.max()) + 1, "table": _table(choice), "rows": len(choice),
        "sets": _table(sets[0]) if sets is not None else "", "admitted": admitted.tolist(), "nodes": len(c.choice),
        "bits": [int.from_bytes(row.tobytes(), "little") for row in admitted], "least": _numbers(least),
        "most": _numbers(most), "range": _numbers(np.where(most > least, most - least, 1.0)),
    }  # fmt: skip


MOST_SETS = 2**16
"""Different sets of admissible inputs that an export tells apart, by numbers of 16 bits."""


def _sets(c: Controller) -> tuple[NDArray[np.uint16], NDArray[np.uint8]] | None:
    """Numbers of what the nodes hold, (nodes,), and that, a row each: the chosen input, two bytes, then the admitted
    ones. Many nodes hold the same. None where the inputs were not recorded, or rows are more than `MOST_SETS`."""
    if c.solution.chosen is not None:
        return None
    numbers, known = np.empty(len(c.choice), np.uint16), dict[bytes, int]()
    for first in range(0, len(numbers), MOST_SETS):
        piece = slice(first, first + MOST_SETS)
        rows = np.concatenate([c.choice[piece, None].view(np.uint8), c.solution.mask[piece]], axis=1)
        found, at = np.unique(rows.view(f"V{rows.shape[1]}")[:, 0], return_inverse=True)
        own = np.array([known.setdefault(row.tobytes(), len(known)) for row in found])
        if len(known) > MOST_SETS:
            return None
        numbers[piece] = own[at]
    return numbers, np.frombuffer(b"".join(known), np.uint8).reshape(len(known), -1)
