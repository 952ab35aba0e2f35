"""JSON results: readable, the same bytes for the same content, floats that read back exactly."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from simgap.errors import UserError
from simgap.io.atomic import write_text


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def write_json(path: Path, content: Any) -> None:
    """Write a result atomically."""
    write_text(path, json.dumps(_plain(content), indent=1, ensure_ascii=False) + "\n")


def read_json(path: Path) -> Any:
    """Read a result.

    Raises:
        UserError: missing or damaged file.
    """
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise UserError("the file does not exist", file=path, remedy="Run the stage that makes it.") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"damaged: {error}", file=path, remedy="Delete it and run again.") from None
