"""A certificate as it is read: nothing in it is believed but what `check` verifies."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from fractions import Fraction
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from expressions import Malformed, exact, well_formed

FORMAT, VERSION = "simgap certificate", 1
KIND = "invariance"
TABLES = ("inputs.npy", "winning.npy")


@dataclass
class Certificate:
    """Grid and tables, the map and its bound.

    Attributes:
        lo, hi: exact ends of the grid by state; cells: per axis; periodic: flags.
        inputs: exact values, (M, nu). admissible: (cells, M) as packed bits, bit m % 8 of byte m // 8.
        winning: (cells,) bool, the cells that are promised.
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
    winning: np.ndarray

    @property
    def size(self) -> int:
        """Number of cells."""
        return prod(self.cells)

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
        if (header["format"], header["version"]) != (FORMAT, VERSION):
            raise Malformed("it is no certificate of this format and version")
        if header["kind"] != KIND:
            raise Malformed(f"it is of the kind {str(header['kind'])[:60]!r}, and only {KIND!r} can be checked")
        tables = [_table(folder / name, header["files"][name]) for name in TABLES]
        if header["digest"] != digest_of(header):
            raise Malformed("its header was changed: the digest does not fit")
        return _certificate(header, *tables)
    except KeyError as error:
        raise Malformed(f"its header has no {error}") from None
    except (OSError, EOFError, LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
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


def _certificate(header: dict[str, Any], admissible: np.ndarray, winning: np.ndarray) -> Certificate:
    grid, cells = header["grid"], header["grid"]["cells"]
    inputs = [[exact(v) for v in row] for row in header["input_set"]]
    states, names = [s["name"] for s in header["states"]], [i["name"] for i in header["inputs"]]
    lo, hi = [exact(v) for v in grid["lo"]], [exact(v) for v in grid["hi"]]
    _check_header(header, states, names)
    good = (
        len(states) == len(lo) == len(hi) == len(cells) == len(grid["periodic"])
        and all(a < b for a, b in zip(lo, hi, strict=True))
        and all(type(k) is int and k > 0 for k in cells)
        and all(type(wraps) is bool for wraps in grid["periodic"])
        and len(inputs) > 0
        and all(len(row) == len(names) for row in inputs)
        and admissible.dtype == winning.dtype == np.uint8
        and admissible.shape == (prod(cells), (len(inputs) + 7) // 8)
        and winning.shape == (prod(cells),)
    )
    if not good:
        raise Malformed("its tables do not fit its grid and its inputs")
    return Certificate(header, states, names, lo, hi, cells, grid["periodic"], inputs, admissible, winning == 1)


def _check_header(header: dict[str, Any], states: list[str], inputs: list[str]) -> None:
    """Everything that is looked up later is there and well formed.

    Raises:
        KeyError, ValueError, TypeError: what is missing. Malformed: what is no name, number or expression.
    """
    names = set(states + inputs)
    if not states or len(names) < len(states + inputs) or not all(isinstance(name, str) for name in names):
        raise Malformed("its states and inputs need a name each, and no two the same")
    said = header["not_covered"]
    if not isinstance(said, list) or not all(isinstance(text, str) for text in said):
        raise Malformed("its 'not_covered' is no list of sentences")
    expressions = [header["nominal"], *([] if header["simulator"] is None else [header["simulator"]])]
    for s in states:
        for ends in (header["domain"][s], header["safe"][s]):
            if len(ends) != 2 or exact(ends[0]) >= exact(ends[1]):
                raise Malformed(f"the ends of {s!r} are no interval")
        for e in (*(known[s] for known in expressions), header["gap"][s]["lower"], header["gap"][s]["upper"]):
            well_formed(e, names)
