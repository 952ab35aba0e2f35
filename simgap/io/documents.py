"""JSON results: readable, the same bytes for the same content, floats that read back exactly, a checksum at the end."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.errors import UserError, excerpt
from simgap.io.atomic import SEAL, seal_holds, sealed
from simgap.reading import JSON_HELD

CHECKSUM = "checksum"
REMEDY = "Delete it and run again: it is remade."
MOST = reading.MOST // JSON_HELD
"""Bytes of a result: what it takes once it is read is a quarter of the machine's memory."""


def plain(value: Any) -> Any:
    """Content as JSON has it: lists for arrays, null for what is not a number, "inf" for what has no end."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a result atomically, its checksum (key `checksum`, which content cannot have) last."""
    body = plain({key: value for key, value in content.items() if key != CHECKSUM})
    text = json.dumps(body | {CHECKSUM: SEAL}, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    with sealed(path) as temporary:
        temporary.write_bytes(text.encode(errors="backslashreplace"))


def read_json(path: Path) -> dict[str, Any]:
    """Read a result that `write_json` wrote, without its checksum.

    Raises:
        UserError: missing, damaged, edited or foreign file.
    """
    try:
        data = reading.read_bytes(path, MOST)
        content = json.loads(
            data.decode(), object_pairs_hook=_distinct, parse_constant=_no_constant, parse_float=_finite
        )
    except FileNotFoundError:
        raise UserError("the file does not exist", file=path, remedy="Run the stage that makes it.") from None
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"damaged: {excerpt(error)}", file=path, remedy=REMEDY) from None
    if not isinstance(content, dict) or CHECKSUM not in content:
        raise UserError("damaged: not a result of simgap, or its checksum is missing", file=path, remedy=REMEDY)
    content.pop(CHECKSUM)
    if not seal_holds(data):
        raise UserError(
            "damaged: the checksum does not fit the content, which was changed after it was written",
            file=path,
            remedy=REMEDY,
        )
    return content


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        known: set[str] = set()
        twice = next(key for key, _ in pairs if key in known or known.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"the key {excerpt(repr(twice))} appears twice")
    return content


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{excerpt(text, 40)} is too large a number")
    return value


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is not a JSON number")
