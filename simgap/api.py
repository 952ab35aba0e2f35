"""Calls of `import simgap` beyond readers of single files: the calls that take paths and return values.

Every one raises `UserError` for a user's mistake, one line with file, key and remedy, `BrokenPromise` for a
guarantee that does not hold, and `EngineCrash` where a simulator's process died. None of them needs a `__main__` guard.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from simgap.config.load import load_case
from simgap.errors import SimgapError
from simgap.extras.wizard import new_case as _new
from simgap.gap.bounds.function import GapFunction
from simgap.io.gap_file import load_gap as _load_gap
from simgap.io.results import read_json
from simgap.plants.context import Context
from simgap.stages import check as _check
from simgap.stages.check import Checked


def load_gap(path: Path | str, case: Path | str) -> GapFunction:
    """The bound of the gap in a `gap.json`, for the case file that it was made for.

    `bounds(x, u)` gives lo and hi at states (n, nx) and inputs (n, nu), rounded outward; `sup()` the suprema over
    X x U; `tiers` what the bound rests on.

    Raises:
        UserError: a file that is missing or damaged, or the bound of another case.
    """
    return _load_gap(Path(path), Context.load(Path(case))).function


def load_summary(folder: Path | str) -> dict[str, Any]:
    """The figures of a case's results, `results/<case>`: what its page says, as plain data.

    Raises:
        UserError: no summary there, or a damaged one.
    """
    content: dict[str, Any] = read_json(Path(folder) / "summary.json")
    return content


def check(case: Path | str) -> Checked:
    """Findings of `simgap check`: costs of the stages, cells an axis, what the engine does with the model file.

    Raises:
        UserError: whatever a stage would refuse later.
    """
    return _check.run(Path(case))


def run(case: Path | str, cores: int = 2, full: bool = False, folder: Path | str = ".") -> Path:
    """Every stage of a case, as `simgap run` does it in this folder: the folder of its results, for `load_summary`.

    Raises:
        UserError: a case that is refused.
        SimgapError: a stage that failed; the last line that the run printed says why.
    """
    name = load_case(Path(case)).name
    words = ["run", str(Path(case).absolute()), "--cores", str(cores), *["--full"] * full]
    if subprocess.run([sys.executable, "-P", "-m", "simgap.cli", *words], cwd=folder, check=False).returncode:
        raise SimgapError(f"the run of {name} failed; the last line that it printed says why")
    return Path(folder) / "results" / name


def diagnose(
    case: Path | str, data: Path | str | Sequence[Path | str] = (), out: Path | str = "diagnosis"
) -> dict[str, Any]:
    """Find what the nominal model lacks, from recordings: -> the content of `diagnosis.json`.

    Args:
        case: case file; a nominal model is enough.
        data: CSV, Parquet, JSON or MCAP files, or one; those of the case if none is given.
        out: folder for page, corrected case, recording and pictures.

    Raises:
        UserError: whatever is wrong with case or data.
    """
    from simgap.stages import diagnosis as stage  # compiles: imported by who asks for it

    files = [data] if isinstance(data, Path | str) else data
    return stage.run(Path(case), [Path(file) for file in files], Path(out))


def new_case(name: str, urdf: Path | str | None = None, folder: Path | str = ".") -> Path:
    """Write a commented case for a URDF, or for equations to be replaced: its path.

    Raises:
        UserError: an invalid name, a file that exists already, or a model file that is refused.
    """
    return _new.run(name, None if urdf is None else Path(urdf), Path(folder))
