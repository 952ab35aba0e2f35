"""Recordings of strangers, as CSV, as Parquet and as JSON."""

from __future__ import annotations

import io
import json
import random
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hostile.damage import damaged

CSV = "t,q,v,trace\n" + "".join(f"{0.01 * k:g},{k % 7 - 3:g},{0.1 * k:g},a\n" for k in range(40))


def read_csv(rng: random.Random, folder: Path) -> None:
    """A damaged recording in CSV."""
    from simgap.io.recordings.tables import read_recording

    path = folder / "run.csv"
    text = CSV if rng.random() < 0.6 else CSV.replace(",", rng.choice((";", "\t"))).replace(".", rng.choice(".,"))
    path.write_bytes(damaged(text.encode(), rng))
    read_recording(path, ["q", "v"], "t", "trace")


@cache
def _parquet() -> bytes:
    out = io.BytesIO()
    field = pa.field("q", pa.float64(), metadata={"unit": "rad"})
    schema = pa.schema([("t", pa.float64()), field, ("v", pa.float32()), ("trace", pa.string())])
    columns = [np.arange(50) * 0.01, np.arange(50.0), np.arange(50, dtype=np.float32), ["a"] * 50]
    pq.write_table(pa.table(columns, schema=schema), out)
    return out.getvalue()


def read_parquet(rng: random.Random, folder: Path) -> None:
    """A damaged recording in Parquet, or one whose columns are of strange types."""
    from simgap.io.recordings.tables import read_recording

    path = folder / "run.parquet"
    if rng.random() < 0.8:
        path.write_bytes(damaged(_parquet(), rng))
    else:
        kinds = [[1.0, 2.0], [None, 1.0], ["1", "b"], [[1], [2]], [{"a": 1}, None], [b"\xff", b"1"],
                 [True, False],
                 ["٣", "1"], [float("nan"), 1.0], [2**62, 1], [None, None]]  # fmt: skip
        columns = [pa.array(rng.choice(kinds)) for _ in range(3)]
        units = [{"unit": b"\xff"} if rng.random() < 0.1 else None for _ in columns]
        named = [pa.field(n, c.type, metadata=m) for n, c, m in zip(("t", "q", "v"), columns, units, strict=True)]
        pq.write_table(pa.Table.from_arrays(columns, schema=pa.schema(named)), path)
    read_recording(path, ["q", "v"], "t", "trace")


def _json(rng: random.Random) -> tuple[str, bytes]:
    """Name and content of a whole one, in one of the shapes that are read."""
    rows = [{"t": 0.01 * k, "q": k % 7 - 3, "v": 0.1 * k, "on": k % 2 == 0, "at": {"c": 20}} for k in range(40)]
    shapes: tuple[tuple[str, object], ...] = (
        ("run.json", rows),
        ("run.json", {name: [row[name] for row in rows] for name in ("t", "q", "v", "on")}),
        ("run.json", {"mass": 1.5, "bus": {"volts": 12}, "pid": [32, 0], "entries": rows}),
    )
    if rng.random() < 0.25:
        return "run.jsonl", "\n".join(map(json.dumps, rows)).encode()
    name, content = rng.choice(shapes)
    return name, json.dumps(content, indent=rng.choice((None, 1))).encode(rng.choice(("utf-8", "utf-8-sig", "utf-16")))


def read_json(rng: random.Random, folder: Path) -> None:
    """A damaged recording in JSON."""
    from simgap.io.recordings.tables import read_recording

    name, content = _json(rng)
    path = folder / name
    path.write_bytes(damaged(content, rng))
    read_recording(path, ["q", "v", "on", "mass"], "t", "trace")
