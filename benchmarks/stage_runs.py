"""What the benchmarks of faults share: a tiny case taken through every stage once, and each stage run again alone.

A stage runs as its rule types it, in a fork of this process, which has imported what stages import; engines are
processes of their own, as ever. Every run has a folder of its own with hard links to the files that were there before.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tiny_cases import NAMES, write_cases

ROOT = Path(__file__).parents[1]
UNEQUAL = re.compile(r"(.*/)?(logs|benchmarks|\.snakemake|__pycache__)/.*|.*\.(log|rrd)|(.*/)?(cost|check)\.json")
"""Files whose bytes may differ between two runs: logs, timings (also those of `check`), recordings."""
IMPORTS = ("numba", "sympy", "scipy.optimize", "scipy.ndimage", "cvxpy", "clarabel", "pyarrow.parquet", "pyarrow.csv",
           "matplotlib.figure", "matplotlib.backends.backend_svg", "jinja2", "pydantic", "rerun", "rerun.blueprint",
           "simgap.cli")  # fmt: skip


def environment(**more: str) -> dict[str, str]:
    """In which this checkout's stages are found."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)} | more


def workflow(folder: Path, cores: int, *options: str, **more: str) -> subprocess.Popen[str]:
    """The documented command, in a process group of its own."""
    command = [sys.executable, "-m", "simgap.cli", "run", *NAMES, "--cores", str(cores), *options]
    return subprocess.Popen(
        command, cwd=folder, env=environment(**more), text=True, start_new_session=True, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )  # fmt: skip


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file that must be the same in every run."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    names = {str(path.relative_to(folder)): path for path in files}
    return {n: hashlib.sha256(p.read_bytes()).hexdigest() for n, p in names.items() if not UNEQUAL.fullmatch(n)}


@dataclass(frozen=True)
class Stage:
    """One job: its command, the files that are there before, and those that it makes with their digests."""

    name: str
    command: tuple[str, ...]
    before: tuple[str, ...]
    makes: dict[str, str]
    recordings: tuple[str, ...]


def code() -> str:
    """Digest of the package and of the cases: what was counted with another counts no more."""
    sources = [*sorted((ROOT / "simgap").rglob("*.py")), ROOT / "benchmarks/tiny_cases.py"]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]


class Journal:
    """What was done so far, a line each, in a file of this code: a benchmark goes on where it was."""

    def __init__(self, folder: Path, name: str) -> None:
        self._path = folder / f"{name}-{code()}.jsonl"
        lines = self._path.read_text().splitlines() if self._path.exists() else []
        self.done: list[dict[str, Any]] = [json.loads(line) for line in lines]

    def add(self, entry: dict[str, Any]) -> None:
        """One thing more was done."""
        self.done.append(entry)
        with self._path.open("a") as stream:
            stream.write(json.dumps(entry) + "\n")


def reference(folder: Path) -> list[Stage]:
    """The stages of the tiny cases, from a run that nothing disturbs; kept in `folder` until the code changes."""
    kept = folder / f"stages-{code()}.json"
    if kept.exists():
        return [Stage(**{k: tuple(v) if isinstance(v, list) else v for k, v in s.items()})
                for s in json.loads(kept.read_text())]  # fmt: skip
    again = folder / "again"
    shutil.rmtree(again, ignore_errors=True)
    write_cases(again)
    plan = workflow(again, 1, "-n", "-p")
    told = plan.communicate()[0]
    if plan.returncode:
        sys.exit(f"the workflow cannot be planned:\n{told[-3000:]}")
    commands = [shlex.split(line)[1:] for line in re.findall(r"Shell command: (simgap .*)", told)]
    stages: list[Stage] = []
    for command in commands:
        before = tuple(sorted(_files(again)))
        status, told = finish(fork(again, command))
        if status:
            sys.exit(f"{shlex.join(command)} failed: {told}: {(folder / 'again.out').read_text()[-800:]}")
        new = sorted(_files(again) - {*before})
        makes = {n: d for n, d in digests(again).items() if n in new}
        stages.append(Stage(command[0], tuple(command), before, makes, tuple(n for n in new if n.endswith(".rrd"))))
    kept.write_text(json.dumps([asdict(stage) for stage in stages], indent=1))
    return stages


def _files(folder: Path) -> set[str]:
    names = (str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    return {name for name in names if not re.search(r"(^|/)(logs|benchmarks|\.snakemake|__pycache__)/", name)}


def restore(source: Path, names: Sequence[str], target: Path) -> None:
    """Hard links of the files that were there before a stage; results are replaced, never written to."""
    shutil.rmtree(target, ignore_errors=True)
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        os.link(source / name, target / name)


def warm() -> None:
    """Import what stages import, so that a fork begins with its work."""
    for name in IMPORTS:
        importlib.import_module(name)


def fork(folder: Path, command: Sequence[str], first: Callable[[], object] | None = None, **environ: str) -> int:
    """A stage in a process group of its own, its output in `folder`.out; -> the process. `first` is called in it."""
    folder.mkdir(parents=True, exist_ok=True)
    process = os.fork()
    if process:
        return process
    status = 99
    try:
        os.setsid()
        out = os.open(folder.parent / f"{folder.name}.out", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        os.chdir(folder)
        os.environ.update(environment(**environ))
        sys.argv = ["simgap", *command]
        if first is not None:
            first()
        status = _stage(command)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _stage(command: Sequence[str]) -> int:
    import traceback

    from simgap.cli import main

    try:
        main(list(command))
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else 1
    except BaseException:
        traceback.print_exc()
        return 98
    return 0


def finish(process: int, longest: float = 120.0) -> tuple[int, str]:
    """Wait for a fork: -> status (negative for a signal, -999 where it took too long), and how it ended in words."""
    end = time.monotonic() + longest
    while True:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            code = os.waitstatus_to_exitcode(status)
            return code, f"status {code}"
        if time.monotonic() > end:
            os.killpg(process, signal.SIGKILL)
            os.waitpid(process, 0)
            return -999, f"still running after {longest:g} s"
        time.sleep(0.005)


def alive(mark: str) -> list[int]:
    """Processes that carry the mark in their environment and run."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                dead = (entry / "stat").read_text().rpartition(")")[2].split()[0] == "Z"
                if not dead and mark.encode() in (entry / "environ").read_bytes():
                    found.append(int(entry.name))
            except OSError:
                continue
    return found
