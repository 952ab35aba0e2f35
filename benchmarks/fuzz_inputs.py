"""Hostile and damaged inputs, each made from its kind and number alone, and what reads them."""

from __future__ import annotations

import contextlib
import io
import json
import random
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

ROOT = Path(__file__).parents[1]
WORDS = (
    "1",
    "-1",
    "0",
    "1e400",
    ".inf",
    ".nan",
    "~",
    "[]",
    "{}",
    "[[1]]",
    "&a",
    "*a",
    "<<: *a",
    "!!set",
    "!!binary x",
    "- ",
    ": ",
    "? ",
    "x: 1",
    "{a: 1, a: 2}",
    "2024-13-45",
    "\x00",
    "\t",
    "\n",
    "#",
    "'",
    '"',
    "|",
    ">",
    "%",
    "@",
    "١٢",
    "9" * 400,
    "1" * 5001,
    "--- ",
    "on",
    "yes",
    "name",
    "plant",
    "extends: x.yaml",
    "../../etc/passwd",
    "$(touch x)",
    "\u202e",
    "\U0001f600",
    "<script>",
    "1/0",
    "9**9**9",
    "sin()",
    "max(1/0,x)",
    "[" * 1100,
    "(" * 1100,
    "{a: " * 300,
    "!!python/object/apply:os.system [x]",
    "NaN",
    "Infinity",
    "null",
    "-0",
    "1_000",
    "0x1F",
    "\ufeff",
    "\r",
    "\x1b[2J",
    "nan",
    "inf",
    "abc",
    "__import__('os')",
    "x.__class__",
    "lambda: 0",
    "e" * 20_000,
    "1,5",
    ";",
    ",,",
    "&#x41;",
    "<!ENTITY a 'b'>",
    "<a>",
    "</robot>",
    "]]>",
)
NAMES = ("sin", "cos", "tan", "atan", "tanh", "exp", "log", "sqrt", "abs", "sign", "min", "max", "eval", "open")
LEAVES = ("x", "y", "pi", "1", "0", "-1", "2.5", "1e300", "1e-300", "1e400", "9", "z", "()", "True", "'x'", "9" * 320,
          "٣", "x", "y", "0.1", "3", "100", "101", "1/3")  # fmt: skip
OPERATORS = ("+", "-", "*", "/", "^", "**", "//", "%", " ", "+", "-", "*", "/")


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bits flipped, words put in, parts removed, doubled, swapped or cut off."""
    for _ in range(rng.choice((1, 1, 2, 3, 6))):
        at, how = rng.randrange(len(data) + 1), rng.randrange(7)
        length = rng.choice((0, 1, 4, 12, 60))
        if how == 0 and data:
            k = min(at, len(data) - 1)
            data = data[:k] + bytes([data[k] ^ 1 << rng.randrange(8)]) + data[k + 1 :]
        elif how in (1, 2, 3):
            data = data[:at] + rng.choice(WORDS).encode() + data[at + length :]
        elif how == 4:
            data = data[:at] + data[at : at + length] * rng.choice((2, 2, 3, 50)) + data[at + length :]
        elif how == 5:
            data = data[:at] + data[at + length :] if rng.random() < 0.7 else data[:at]
        else:
            other = rng.randrange(len(data) + 1)
            data = data[:at] + data[other : other + length] + data[at:]
    return data


def expression(rng: random.Random, depth: int = 0) -> str:
    """A random expression, most of them of the right form."""
    how = rng.random()
    if depth > 5 or how < 0.3:
        return rng.choice(LEAVES)
    inner = expression(rng, depth + 1)
    if how < 0.6:
        return f"{inner}{rng.choice(OPERATORS)}{expression(rng, depth + 1)}"
    if how < 0.85:
        more = [expression(rng, depth + 1) for _ in range(rng.choice((0, 0, 0, 1, 2)))]
        return f"{rng.choice(NAMES)}({','.join([inner, *more] if rng.random() < 0.97 else [])})"
    return f"({inner})" if how < 0.95 else f"-{inner}"


def altered(content: Any, rng: random.Random) -> Any:
    """Plain content with a value replaced, removed or moved somewhere in it."""
    if isinstance(content, dict) and content and rng.random() < 0.9:
        key = rng.choice(list(content))
        if rng.random() < 0.1:
            return {k: v for k, v in content.items() if k != key}
        return content | {key: altered(content[key], rng)}
    if isinstance(content, list) and content and rng.random() < 0.85:
        k = rng.randrange(len(content))
        if rng.random() < 0.15:
            return content[:k] + content[k + 1 :] * rng.choice((0, 1, 2))
        return [*content[:k], altered(content[k], rng), *content[k + 1 :]]
    if isinstance(content, int | float) and not isinstance(content, bool) and rng.random() < 0.5:
        return rng.choice((-content, content * 1e-6, content * 1e9, content + 1, float(content), int(content)))
    return rng.choice((None, True, [], {}, "", "x", 0, -1, 1e308, 2**70, [[]], {"a": []}, "nan", [1, "a"], 0.5, "1e5"))


def _case(rng: random.Random) -> bytes:
    names = ("dfki_pendulum", "dc_motor", "multiarm_pendulum", "vtol", "dcdc", "pendulum", "turtlebot")
    return damaged((ROOT / f"configs/cases/{rng.choice(names)}.yaml").read_bytes(), rng)


def read_case(rng: random.Random, folder: Path) -> None:
    """A damaged case file; its model file lies where it says."""
    from simgap.config.load import load_case

    path = folder / "cases/case.yaml"
    path.write_bytes(_case(rng))
    load_case(path)


def read_altered_case(rng: random.Random, folder: Path) -> None:
    """A case that is whole YAML with a value that may be wrong."""
    from simgap.config.load import parse_case

    content = _parsed(rng.choice(("dfki_pendulum", "dc_motor", "vtol", "pendulum", "turtlebot", "dcdc")))
    for _ in range(rng.choice((1, 1, 2))):
        content = altered(content, rng)
    parse_case(content, folder / "cases/case.yaml")


@cache
def _parsed(name: str) -> Any:
    from simgap.config.load_yaml import read_yaml

    return read_yaml(ROOT / f"configs/cases/{name}.yaml")


def read_expression(rng: random.Random, folder: Path) -> None:
    """An expression, by a grammar, or one that is damaged."""
    from simgap.model.expressions import parse

    text = expression(rng)
    parse(text if rng.random() < 0.8 else damaged(text.encode(), rng).decode(errors="replace"), ["x", "y"])


def read_urdf(rng: random.Random, folder: Path) -> None:
    """A damaged model file."""
    from simgap.plants.urdf_checks import check_urdf, root_link

    path = folder / "model.urdf"
    name = rng.choice(("pendulum", "pendulum", "cart_pole"))
    path.write_bytes(damaged(_model(name), rng))
    check_urdf(path)
    root_link(path)


@cache
def _model(name: str) -> bytes:
    return (ROOT / f"configs/models/{name}.urdf").read_bytes()


CSV = "t,q,v,trace\n" + "".join(f"{0.01 * k:g},{k % 7 - 3:g},{0.1 * k:g},a\n" for k in range(40))


def read_csv(rng: random.Random, folder: Path) -> None:
    """A damaged recording in CSV."""
    from simgap.io.diagnosis_tables import read_recording

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
    from simgap.io.diagnosis_tables import read_recording

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


def read_result(rng: random.Random, folder: Path) -> None:
    """A damaged JSON result: refused, or the same content."""
    from simgap.io.documents import read_json, write_json

    path, whole = folder / "a.json", {"kind": "linear", "eps": 0.0056, "gap": {"x": [7.6e-7, "x", None, {"a": [1, 2]}]}}
    if not (folder / "whole.json").exists():
        write_json(folder / "whole.json", whole)
    path.write_bytes(damaged((folder / "whole.json").read_bytes(), rng))
    if read_json(path) != whole:
        raise AssertionError("altered content was accepted")


def read_table(rng: random.Random, folder: Path) -> None:
    """A damaged table of simgap's own: refused, or the same content."""
    from simgap.io.parquet import read_parquet, table, write_parquet

    path, whole = folder / "b.parquet", folder / "whole.parquet"
    if not whole.exists():
        write_parquet(whole, table({"x": np.arange(50.0), "y": np.ones(50)}, {"x": "m"}, {"case": "c"}, {"a": 1}))
    path.write_bytes(damaged(whole.read_bytes(), rng))
    if not read_parquet(path).equals(read_parquet(whole)):
        raise AssertionError("altered content was accepted")


def read_gap(rng: random.Random, folder: Path) -> None:
    """A gap that was altered by somebody who can write a checksum; what is taken is right side up."""
    from simgap.gap.load import from_json

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
    from simgap.gap.bases import Basis
    from simgap.gap.cells import CellGap
    from simgap.gap.forms import make_form
    from simgap.gap.function import GapDomain
    from simgap.gap.linear import LinearGap
    from simgap.gap.symmetry import BodyFrameGap
    from simgap.gap.tiers import Tier
    from simgap.geometry import Box

    box, inputs, tiers = Box([-1.0, -2.0], [1.0, 2.0]), np.array([[-1.0], [0.0], [1.0]]), (Tier(1, "It holds."),)
    domain, edges = GapDomain(("x", "v"), ("u",), box, inputs), (np.linspace(-1, 1, 3), np.linspace(-2, 2, 3))
    form = make_form(Basis(("x", "u", "1"), ("x", "v"), ("u",)), box, inputs, [0.1, 0.0, 0.2])
    low, nodes = np.full((4, 3, 2), -0.1), tuple(0.5 * (e[1:] + e[:-1]) for e in edges)
    floor = GapDomain(("x", "y", "heading"), ("u",), Box([0.0, 0.0, -3.0], [4.0, 4.0, 3.0]), inputs, (0, 1))
    made = (
        LinearGap.unsigned(domain, tiers, [form, form]),
        CellGap(domain, tiers, edges, nodes, low, -low, np.full((2, 2), 0.01)),
        BodyFrameGap(floor, tiers, np.full((3, 3), -0.1), np.full((3, 3), 0.1)),
    )
    for gap in made[:2]:  # compiled here, before an alarm is set
        gap.bounds(np.zeros((1, 2)), inputs[:1])
    return tuple(json.dumps(gap.to_json()) for gap in made)


def read_controller(rng: random.Random, folder: Path) -> None:
    """A damaged controller, or one that was altered by somebody who can write a checksum."""
    from simgap.io.controller_file import _checksum, load_controller

    whole, path = folder / "whole.npz", folder / "a.npz"
    if rng.random() < 0.4:
        path.write_bytes(damaged(whole.read_bytes(), rng))
    else:
        with np.load(whole) as stored:
            arrays = {name: stored[name] for name in stored.files if name != "sha256"}
        name = rng.choice(list(arrays))
        if name == "about" or rng.random() < 0.4:
            about = altered(json.loads(arrays["about"].tobytes().decode()), rng)
            arrays["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
        else:
            arrays[name] = _altered_array(arrays[name], rng)
        arrays["sha256"] = _checksum(arrays)
        np.savez(path, **arrays)
    load_controller(path)


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


COMMANDS = (
    "check",
    "grid",
    "rollouts",
    "fresh",
    "borders",
    "calibration",
    "scp",
    "lipschitz",
    "gap",
    "synthesis",
    "twin",
    "validation",
    "audit",
    "replay",
    "trace",
    "report",
    "index",
    "rig",
    "effects",
    "times",
    "export",
    "certify",
    "new",
    "tutorial",
    "run",
    "diagnose",
    "sweep",
    "point",
    "sweep-page",
    "paper",
    "nothing",
)
OPTIONS = (
    "--out",
    "--log",
    "--point",
    "--grid",
    "--shard",
    "--rollouts",
    "--state",
    "--gap",
    "--controller",
    "--workers",
    "--samples",
    "--fresh",
    "--urdf",
    "--equations",
    "--traces",
    "--nominal",
    "--robust",
    "--summary",
    "--cores",
    "--help",
    "-x",
    "--",
    "--version",
    "--times",
    "--witness",
    "--margins",
    "--scp",
    "--lipschitz",
)
VALUES = (
    "broken.yaml",
    "none.yaml",
    ".",
    "a.json",
    "whole.npz",
    "run.csv",
    "b.parquet",
    "out",
    "out/x.json",
    "-1",
    "0",
    "1",
    "eps~0.1",
    "x",
    "nan",
    "",
    "\x1b[2J",
    "a" * 5000,
    "/dev/full",
    "/dev/null",
    "/proc/x",
    "../../x",
    "no.urdf",
    "hidden-state",
    "\udce9",
    "9" * 30,
    "cases",
    "model.urdf",
)


def read_command(rng: random.Random, folder: Path) -> None:
    """A command line: an exit status of 0, 1 or 2 and no traceback."""
    from simgap.cli import main

    words = [rng.choice(COMMANDS)]
    if rng.random() < 0.8:
        words.append(rng.choice(VALUES))
    for _ in range(rng.choice((0, 1, 2, 3, 5))):
        words += [rng.choice(OPTIONS)] + [rng.choice(VALUES)] * (rng.random() < 0.9)
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            main(words)
        except SystemExit as ended:
            if ended.code not in (0, 1, 2, None):
                raise AssertionError(f"{words}: status {ended.code}") from None
    if "Traceback" in said.getvalue():
        raise AssertionError(f"{words}: a traceback: {said.getvalue()[-300:]}")


def prepare(folder: Path) -> None:
    """The files that inputs stand beside."""
    from simgap.geometry import Box, Grid
    from simgap.io.controller_file import save_controller
    from simgap.specifications.solution import Solution
    from simgap.synthesis.controller import Controller

    (folder / "cases").mkdir(parents=True, exist_ok=True)
    (folder / "models").mkdir(exist_ok=True)
    for path in (ROOT / "configs/models").glob("*.urdf"):
        (folder / "models" / path.name).write_bytes(path.read_bytes())
    (folder / "broken.yaml").write_text("name: broken\nplant: {states: 3}\n")
    (folder / "run.csv").write_text(CSV)
    grid = Grid(Box(np.zeros(2), np.ones(2)), [4, 4], [])
    won = np.arange(16) % 3 > 0
    mask = np.where(won, 3, 0).astype(np.uint8)[:, None]
    solution = Solution(grid=grid, winning=won, mask=mask, free=np.ones(16, bool), statistics={"rounds": 1})
    law = Controller(np.array([[0.0], [1.0]]), ("x", "v"), ("u",), solution, "least_effort", {"case": "c"})
    save_controller(law, folder / "whole.npz")


KINDS: Mapping[str, tuple[int, Callable[[random.Random, Path], None]]] = {
    "case files, damaged": (20_000, read_case),
    "case files, altered values": (20_000, read_altered_case),
    "expressions": (60_000, read_expression),
    "URDFs": (20_000, read_urdf),
    "CSV recordings": (15_000, read_csv),
    "Parquet recordings": (15_000, read_parquet),
    "JSON results": (20_000, read_result),
    "tables of results": (15_000, read_table),
    "gap bounds": (10_000, read_gap),
    "controllers": (10_000, read_controller),
    "command lines": (5_000, read_command),
}
"""For each kind how many inputs, and what makes one of a number and reads it."""
