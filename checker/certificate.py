"""A certificate as it is read: nothing in it is believed but what `check` verifies."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from expressions import Malformed, exact

FORMAT, VERSION = "simgap certificate", 1
KINDS = ("invariance", "reach_avoid")
LOST = np.iinfo(np.int64).max


@dataclass
class Certificate:
    """Grid and tables, the map and its bound.

    Attributes:
        lo, hi: exact ends of the grid by state; cells: per axis; periodic: flags.
        inputs: exact values, (M, nu). admissible: (cells, M) as packed bits, bit m % 8 of byte m // 8.
        rank: (cells,) 0 for winning cells of an invariance, levels of a reach-avoid, LOST elsewhere.
        header: everything in certificate.json.
    """

    header: dict[str, Any]
    states: list[str]
    input_names: list[str]
    lo: list[Fraction]
    hi: list[Fraction]
    cells: list[int]
    periodic: list[bool]
    inputs: list[list[Fraction]]
    admissible: np.ndarray
    rank: np.ndarray

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod(self.cells))

    @property
    def reaches(self) -> bool:
        """Whether levels count down to a target."""
        return bool(self.header["kind"] == "reach_avoid")

    def admits(self, m: int) -> np.ndarray:
        """Cells in which input m is admissible, (cells,) bool."""
        return ((self.admissible[:, m // 8] >> (m % 8)) & 1).astype(bool)

    def index(self, cell: int) -> tuple[int, ...]:
        """Index of a cell along each axis."""
        return tuple(int(k) for k in np.unravel_index(cell, self.cells))


def read(folder: Path) -> Certificate:
    """Read a certificate.

    Raises:
        Malformed: what is missing, damaged or not of this format.
    """
    try:
        header = json.loads((folder / "certificate.json").read_text())
        if (header["format"], header["version"]) != (FORMAT, VERSION) or header["kind"] not in KINDS:
            raise Malformed("it is no certificate of this format, version and kind")
        tables = {name: _table(folder / name, digest) for name, digest in header["files"].items()}
        if header["digest"] != digest_of(header):
            raise Malformed("its header was changed: the digest does not fit")
        return _certificate(header, tables)
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise Malformed(f"it cannot be read: {error!r:.150}") from None


def digest_of(header: dict[str, Any]) -> str:
    """SHA-256 of the header without this key, as compact JSON with sorted keys."""
    rest = {key: value for key, value in header.items() if key != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _table(path: Path, digest: str) -> np.ndarray:
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise Malformed(f"{path.name} was changed: its SHA-256 is not that of the header")
    return np.load(path, allow_pickle=False)


def _certificate(header: dict[str, Any], tables: dict[str, np.ndarray]) -> Certificate:
    grid, cells = header["grid"], [int(c) for c in header["grid"]["cells"]]
    inputs = [[exact(v) for v in row] for row in header["input_set"]]
    size, states = int(np.prod(cells)), [s["name"] for s in header["states"]]
    lo, hi = [exact(v) for v in grid["lo"]], [exact(v) for v in grid["hi"]]
    admissible, winning = tables["inputs.npy"], tables["winning.npy"]
    rank = np.where(winning == 1, 0, LOST).astype(np.int64)
    if header["kind"] == "reach_avoid":
        rank = np.where(tables["levels.npy"] >= 0, tables["levels.npy"].astype(np.int64), LOST)
    good = (
        len(states) == len(lo) == len(hi) == len(cells) == len(grid["periodic"])
        and all(a < b for a, b in zip(lo, hi, strict=True))
        and min(cells) > 0
        and admissible.dtype == np.uint8
        and admissible.shape == (size, (len(inputs) + 7) // 8)
        and winning.dtype == np.uint8
        and winning.shape == rank.shape == (size,)
    )
    if not good:
        raise Malformed("its tables do not fit its grid and its inputs")
    names = [i["name"] for i in header["inputs"]]
    return Certificate(header, states, names, lo, hi, cells, list(grid["periodic"]), inputs, admissible, rank)
