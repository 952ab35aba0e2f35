"""Controllers as files: one compressed .npz, equal bytes for equal controllers, nothing believed when it is read."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from simgap import reading
from simgap.config.case import Case
from simgap.errors import UserError
from simgap.io.atomic import atomic
from simgap.io.controller_content import controller_from, require
from simgap.io.packed_arrays import checksum, fits, pack, unpacked
from simgap.io.unpacked import TooLarge, require_room
from simgap.synthesis.controller import Controller

REMEDY = "Run the synthesis stage again."
FEWER = "Take another machine, fewer cells (synthesis.cells) or fewer inputs (domain.U)."
CHECKSUM = "sha256"
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
    arrays[CHECKSUM] = checksum(arrays)
    try:
        require_room(sum(array.nbytes for array in arrays.values()))
    except TooLarge as error:
        raise UserError(f"the controller {error.problem}", remedy=FEWER) from None
    with atomic(Path(path)) as temporary:
        pack(temporary, arrays)


def load_controller(path: Path | str) -> Controller:
    """Read a controller.

    Raises:
        UserError: a file that is missing, damaged, changed by hand or no controller at all.
    """
    return _load(path, whole=True)


def _load(path: Path | str, whole: bool) -> Controller:
    try:
        with reading.opened(Path(path)) as stream, zipfile.ZipFile(stream) as archive:
            require_room(sum(entry.file_size for entry in archive.infolist()))
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            require({*names} >= _NEEDED and ("mask" in names) != ("chosen" in names), "parts of it are missing")
            require(CHECKSUM in names, "it has no checksum, so nothing says that it is whole")
            stated = unpacked(archive, CHECKSUM)
            whole = whole or stated.ndim == 1  # an earlier version's, one checksum of everything
            arrays = {n: unpacked(archive, n) for n in names if n != CHECKSUM and (whole or n not in _INPUTS)}
        about = json.loads(arrays["about"].tobytes().decode())
        require(fits(stated, arrays, sorted({*names} - {CHECKSUM})), "its checksum does not fit its content")
        return controller_from(about, arrays)
    except FileNotFoundError:
        raise UserError("there is no such controller", file=path, remedy="Run the synthesis stage") from None
    except TooLarge as error:
        raise UserError(error.problem, file=path, remedy=FEWER) from None
    except UserError as error:
        raise UserError(f"not a controller file ({error.problem})", file=path, remedy=REMEDY) from None
    except (
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
    ) as error:
        raise UserError(f"not a controller file ({error!s:.120})", file=path, remedy=REMEDY) from None


class CaseNames(Protocol):
    """What a controller must be made for: a stage's context has it."""

    @property
    def case(self) -> Case: ...  # noqa: D102
    @property
    def states(self) -> Sequence[str]: ...  # noqa: D102
    @property
    def inputs(self) -> Sequence[str]: ...  # noqa: D102
    @property
    def input_set(self) -> NDArray[np.float64]: ...  # noqa: D102
    def own(self, path: Path | str, record: Any, *stages: str) -> None: ...  # noqa: D102


def load_domain(path: Path | str) -> Controller:
    """Read a controller but for its admissible inputs, nearly all of its bytes; it refuses to be asked for one.

    Raises:
        UserError: what `load_controller` refuses, as far as it is read.
    """
    return _load(path, whole=False)


def load_domain_of(path: Path | str, wanted: CaseNames) -> Controller:
    """`load_domain` of the controller of a case.

    Raises:
        UserError: as `load_controller_of`.
    """
    return _made_for(wanted, load_domain(path), path)


def load_controller_of(path: Path | str, wanted: CaseNames) -> Controller:
    """Read the controller of a case.

    Raises:
        UserError: what `load_controller` refuses, and a controller of another case, named, or of another U.
    """
    return _made_for(wanted, load_controller(path), path)


def _made_for(wanted: CaseNames, found: Controller, path: Path | str) -> Controller:
    made_for = found.metadata.get("case")
    for what, one, other in (
        ("case", made_for, wanted.case.name),
        ("states", list(found.states), list(wanted.states)),
        ("inputs", list(found.input_names), list(wanted.inputs)),
    ):
        if one != other:
            raise UserError(
                f"the controller is of another case: its {what} is {one}, that of this case {other}", file=path,
                remedy=REMEDY,
            )  # fmt: skip
    if not np.array_equal(found.input_set, wanted.input_set):
        raise UserError(f"the controller of '{made_for}' is of another U than this case has", file=path, remedy=REMEDY)
    wanted.own(path, found.metadata, "synthesis")
    return found
