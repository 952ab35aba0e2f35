"""Results that were damaged, or altered by somebody who can write a checksum."""

from __future__ import annotations

import json
import random
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hostile.damage import altered, damaged


def read_result(rng: random.Random, folder: Path) -> None:
    """A damaged JSON result: refused, or the same content."""
    from simgap.io.results import read_json, write_json

    path, whole = folder / "a.json", {"kind": "linear", "eps": 0.0056, "gap": {"x": [7.6e-7, "x", None, {"a": [1, 2]}]}}
    if not (folder / "whole.json").exists():
        write_json(folder / "whole.json", whole)
    path.write_bytes(damaged((folder / "whole.json").read_bytes(), rng))
    if read_json(path) != whole:
        raise AssertionError("altered content was accepted")


def read_table(rng: random.Random, folder: Path) -> None:
    """A damaged table of simgap's own: refused, or the same content."""
    from simgap.io.results import read_parquet, table, write_parquet

    path, whole = folder / "b.parquet", folder / "whole.parquet"
    if not whole.exists():
        write_parquet(whole, table({"x": np.arange(50.0), "y": np.ones(50)}, {"x": "m"}, {"case": "c"}, {"a": 1}))
    path.write_bytes(damaged(whole.read_bytes(), rng))
    if not read_parquet(path).equals(read_parquet(whole)):
        raise AssertionError("altered content was accepted")


def read_gap(rng: random.Random, folder: Path) -> None:
    """A gap that was altered by somebody who can write a checksum; what is taken is right side up."""
    from simgap.gap.bounds.load import from_json

    content: Any = json.loads(_gaps()[rng.randrange(len(_gaps()))])
    for _ in range(rng.choice((1, 1, 2, 3))):
        content = altered(content, rng)
    gap = from_json(content)
    if len(gap.domain.states) == 2 and len(gap.domain.inputs) == 1:
        x = gap.domain.box.lo + np.random.default_rng(0).random((20, 2)) * (gap.domain.box.hi - gap.domain.box.lo)
        lo, hi = gap.bounds(x, np.repeat(gap.domain.input_set[:1], 20, axis=0))
        assert (lo <= hi).all(), "a bound upside down was accepted"


@cache
def _gaps() -> tuple[str, ...]:
    """One bound of each kind, as JSON."""
    from simgap.gap.bounds.body_frame import BodyFrameGap
    from simgap.gap.bounds.cells import CellGap
    from simgap.gap.bounds.function import GapDomain, Tier
    from simgap.gap.bounds.linear import Basis, LinearGap, make_form
    from simgap.geometry import Box

    box, inputs, tiers = Box([-1.0, -2.0], [1.0, 2.0]), np.array([[-1.0], [0.0], [1.0]]), (Tier(1, "It holds."),)
    domain, edges = GapDomain(("x", "v"), ("u",), box, inputs), (np.linspace(-1, 1, 3), np.linspace(-2, 2, 3))
    form = make_form(Basis(("x", "u", "1"), ("x", "v"), ("u",)), box, inputs, [0.1, 0.0, 0.2])
    low = np.full((4, 3, 2), -0.1)
    floor = GapDomain(("x", "y", "heading"), ("u",), Box([0.0, 0.0, -3.0], [4.0, 4.0, 3.0]), inputs, (0, 1))
    made = (
        LinearGap.unsigned(domain, tiers, [form, form]),
        CellGap(domain, tiers, edges, low, -low),
        BodyFrameGap(floor, tiers, np.full((1, 3, 3), -0.1), np.full((1, 3, 3), 0.1)),
    )
    for gap in made[:2]:  # compiled here, before an alarm is set
        gap.bounds(np.zeros((1, 2)), inputs[:1])
    return tuple(json.dumps(gap.to_json()) for gap in made)


def read_controller(rng: random.Random, folder: Path) -> None:
    """A damaged controller, or one that was altered by somebody who can write a checksum."""
    from simgap.io.atomic import sealed
    from simgap.io.controller_file import load_controller, write_arrays

    whole, path = folder / "whole.npz", folder / "a.npz"
    if rng.random() < 0.4:
        path.write_bytes(damaged(whole.read_bytes(), rng))
    else:
        with np.load(whole) as stored:
            arrays = {name: stored[name] for name in stored.files}
        name = rng.choice(list(arrays))
        if name == "about" or rng.random() < 0.4:
            about = altered(json.loads(arrays["about"].tobytes().decode()), rng)
            arrays["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
        else:
            arrays[name] = _altered_array(arrays[name], rng)
        with sealed(path) as temporary:
            write_arrays(temporary, arrays)
    load_controller(path, whole=rng.random() < 0.5)


def _altered_array(array: Any, rng: random.Random) -> Any:
    changed = array.copy()
    how = rng.randrange(6)
    if how == 0 and changed.size:
        flat = changed.reshape(-1)
        flat[rng.randrange(flat.size)] = rng.choice((0, 1, 255, -1 if changed.dtype.kind != "u" else 7))
    elif how == 1 and changed.dtype.kind == "f" and changed.size:
        changed.reshape(-1)[rng.randrange(changed.size)] = rng.choice((np.nan, np.inf, 1e300))
    elif how == 2:
        changed = changed[: rng.randrange(len(changed) + 1)] if changed.ndim else changed
    elif how == 3:
        changed = changed.astype(rng.choice(("f4", "i8", "u1", "c16", "U8", "?")))
    elif how == 4:
        changed = changed.reshape(-1)[::-1].reshape(changed.shape)
    else:
        changed = changed[None]
    return changed
