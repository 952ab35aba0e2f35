"""A synthesised controller: one file, asked for an input at a state in one line.

    u = Controller.load("controller.npz").input(x)

Every admissible input keeps the promise of the specification, so which of them is applied is a matter of taste. The
default rule is `least_effort`: the input of smallest sum of squares, each input scaled by its largest magnitude, ties
broken by the order of the input set. `middle` takes the median of the admissible inputs in that order.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgap.errors import BrokenPromise, UserError
from simgap.geometry import Box, Grid
from simgap.io.atomic import atomic
from simgap.specifications.solution import Solution
from simgap.synthesis.bits import preferred, unpack

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
RULES = ("least_effort", "middle")
_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, eq=False)
class Controller:
    """Static map from measured states (and the pending input, if there is latency) to admissible inputs.

    Attributes:
        input_set: U, (M, nu).
        states, input_names: names in order.
        solution: winning domain, admissible inputs and, for reach-avoid, the value function.
        rule: how one admissible input is chosen.
        metadata: what made it; plain JSON values.
    """

    input_set: Floats
    states: tuple[str, ...]
    input_names: tuple[str, ...]
    solution: Solution
    rule: str
    metadata: dict[str, Any]

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise UserError(f"no selection rule '{self.rule}'", remedy=f"Known rules: {', '.join(RULES)}")

    @property
    def grid(self) -> Grid:
        """Cells of the measured state."""
        return self.solution.grid

    @property
    def memory(self) -> int:
        """1, or M + 1 when the pending input is part of the controller's state."""
        return self.solution.memory

    @cached_property
    def choice(self) -> NDArray[np.int16]:
        """The input that the rule picks, (cells * memory,), -1 where there is none; row cell * memory + pending."""
        if self.rule == "middle":
            return _middle(self.solution.mask, len(self.input_set))
        return preferred(self.solution.mask, least_effort(self.input_set))

    def rows(self, x: ArrayLike, pending: ArrayLike = 0) -> Ints:
        """Rows of `choice` and of the mask: measured states (n, nx), pending inputs (n,) -> (n,), -1 outside."""
        cells = self.grid.index(np.atleast_2d(np.asarray(x, dtype=np.float64)))
        return np.where(cells >= 0, cells * self.memory + np.asarray(pending), -1)

    def lookup(self, x: ArrayLike, pending: ArrayLike = 0) -> Ints:
        """Chosen input numbers: (n, nx), (n,) -> (n,), -1 where the controller has none."""
        rows = self.rows(x, pending)
        return np.where(rows >= 0, self.choice[rows], -1).astype(np.int64)

    def input(self, x: ArrayLike, pending: int = 0) -> Floats:
        """The input to apply at the measured state (nx,) -> (nu,).

        Raises:
            BrokenPromise: outside the winning domain, or in the target, where the task is done.
        """
        m = int(self.lookup(x, pending)[0])
        if m < 0:
            raise BrokenPromise(f"the controller has no input at {np.asarray(x).tolist()}", "Ask `contains` first.")
        return self.input_set[m].copy()

    def inputs(self, x: ArrayLike, pending: int = 0) -> Floats:
        """All admissible inputs at a measured state (nx,) -> (k, nu), k = 0 outside the winning domain."""
        row = int(self.rows(x, pending)[0])
        return self.input_set[unpack(self.solution.mask[row], len(self.input_set))] if row >= 0 else self.input_set[:0]

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether measured states are in the winning domain: (n, nx) -> (n,)."""
        cells = self.grid.index(np.atleast_2d(np.asarray(x, dtype=np.float64)))
        return np.where(cells >= 0, self.solution.winning[cells], False)

    def in_target(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether measured states are in a target cell: (n, nx) -> (n,); never for invariance."""
        cells = self.grid.index(np.atleast_2d(np.asarray(x, dtype=np.float64)))
        target = self.solution.target
        return np.zeros(len(cells), np.bool_) if target is None else np.where(cells >= 0, target[cells], False)

    def value(self, x: ArrayLike) -> Ints:
        """Worst-case steps to the target: (n, nx) -> (n,), -1 where losing or outside."""
        if self.solution.value is None:
            raise UserError("an invariance controller has no value function")
        cells = self.grid.index(np.atleast_2d(np.asarray(x, dtype=np.float64)))
        return np.where(cells >= 0, self.solution.value[cells], -1).astype(np.int64)

    def save(self, path: Path | str) -> None:
        """Write one compressed .npz, whole or not at all; equal controllers give equal bytes."""
        s = self.solution
        about = {
            "states": list(self.states),
            "inputs": list(self.input_names),
            "periodic": list(self.grid.periodic),
            "rule": self.rule,
            "memory": s.memory,
            "statistics": s.statistics,
            "provenance": self.metadata,
        }
        arrays: dict[str, NDArray[Any]] = {
            "about": np.frombuffer(json.dumps(about, sort_keys=True).encode(), np.uint8),
            "box": np.stack([self.grid.box.lo, self.grid.box.hi]),
            "cells": np.array(self.grid.cells, np.int64),
            "input_set": self.input_set,
            "winning": np.packbits(s.winning),
            "free": np.packbits(s.free),
            "mask": s.mask,
        }
        if s.value is not None and s.target is not None:
            arrays |= {"value": s.value, "target": np.packbits(s.target)}
        with atomic(Path(path)) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            for name, array in arrays.items():
                entry = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry._compresslevel = 1  # type: ignore[attr-defined]  # zipfile has no other way for an open entry
                with archive.open(entry, "w", force_zip64=True) as stream:
                    np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)

    @staticmethod
    def load(path: Path | str) -> Controller:
        """Read a saved controller.

        Raises:
            UserError: if the file is missing or not a controller.
        """
        try:
            with np.load(path, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
            about = json.loads(arrays["about"].tobytes().decode())
            grid = Grid(Box(*arrays["box"]), arrays["cells"].tolist(), about["periodic"])
            flags = {
                name: np.unpackbits(arrays[name], count=grid.size).view(np.bool_)
                for name in ("winning", "free", "target")
                if name in arrays
            }
            solution = Solution(
                grid=grid,
                mask=arrays["mask"],
                value=arrays.get("value"),
                memory=about["memory"],
                statistics=about["statistics"],
                **flags,
            )
            names = tuple(about["states"]), tuple(about["inputs"])
            return Controller(arrays["input_set"], *names, solution, about["rule"], about["provenance"])
        except FileNotFoundError as error:
            raise UserError("there is no such controller", file=path, remedy="Run the synthesis stage") from error
        except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise UserError(f"not a controller file ({error})", file=path, remedy="Run the synthesis stage") from error


def least_effort(inputs: Floats) -> Ints:
    """Input numbers from least to most effort: (M, nu) -> (M,)."""
    scale = np.maximum(np.abs(inputs).max(axis=0), 1e-300)
    effort = np.round(((inputs / scale) ** 2).sum(axis=1), 12)  # so that +u and -u tie whatever their last bits
    return np.argsort(effort, kind="stable")


def _middle(mask: NDArray[np.uint8], inputs: int) -> NDArray[np.int16]:
    out = np.full(len(mask), -1, np.int16)
    for first in range(0, len(mask), 65536):
        bits = unpack(mask[first : first + 65536], inputs)
        ranks, count = np.cumsum(bits, axis=1), bits.sum(axis=1)
        median = np.argmax(ranks >= ((count + 1) // 2)[:, None], axis=1)
        out[first : first + 65536] = np.where(count > 0, median, -1)
    return out
