"""Faults put into soundness-critical code, one at a time, and whether the tests named for them notice.

    python benchmarks/mutants.py [--only WORD]

Each mutant of `mutant_list.py` changes one place of one file in a temporary copy of the package; the tests named for it
run there. A text that no longer stands exactly once in its file is an error, as is a test that fails without any
fault. Where kernels themselves are at fault they run as the Python that they are written in, so that nothing is
compiled and nothing compiled before is met. Every run is a fork of this process, which has imported what the package
imports, but nothing of the package.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from pathlib import Path

import numba
import pytest
from mutant_list import COMPILED, MUTANTS, Mutant

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "benchmarks" / "results" / "mutants.json"
LOG = "pytest.log"
LONGEST = 600  # seconds of a test run; a mutant that hangs is noticed, too
FOREIGN = ("numpy", "scipy.optimize", "scipy.ndimage", "scipy.stats", "sympy", "mpmath", "numba", "pydantic", "yaml",
           "cvxpy", "pyarrow.parquet")  # fmt: skip
OUTCOMES = {pytest.ExitCode.OK: True, pytest.ExitCode.TESTS_FAILED: False, pytest.ExitCode.INTERRUPTED: False}
"""A file that cannot even be imported interrupts the collection: the fault was noticed."""


def mutated(mutant: Mutant, text: str) -> str:
    """The file with the fault; the text that it replaces must stand there exactly once."""
    found = text.count(mutant.old)
    if found != 1 or mutant.old == mutant.new:
        sys.exit(f"{mutant.file}: the text of '{mutant.fault}' stands there {found} times; correct mutant_list.py")
    return text.replace(mutant.old, mutant.new)


def _in_child(folder: Path, tests: tuple[str, ...]) -> int:
    signal.alarm(LONGEST)  # ends a child that hangs
    out = os.open(folder / LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1)
    os.dup2(out, 2)
    numba.config.DISABLE_JIT = tests not in COMPILED
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    sys.dont_write_bytecode = True
    return pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests])


def passes(folder: Path, tests: tuple[str, ...]) -> bool:
    """Whether tests pass in a copy of the project, in a fork of this process."""
    child = os.fork()
    if child == 0:
        code = 99
        try:
            code = int(_in_child(folder, tests))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)  # nothing of the parent's is cleaned up here
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return False
    code = os.WEXITSTATUS(status)
    if code not in OUTCOMES:
        sys.exit(f"pytest ended with {code} on {tests}:\n{(folder / LOG).read_text()[-3000:]}")
    return OUTCOMES[pytest.ExitCode(code)]


def main() -> None:
    """Run all mutants, or those whose fault or file holds a word; write what was caught."""
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--only", default="", help="Run mutants whose fault or file holds this; nothing is written.")
    only = asked.parse_args().only
    chosen = [m for m in MUTANTS if only in m.fault or only in m.file]
    for mutant in chosen:  # before anything runs
        mutated(mutant, (ROOT / mutant.file).read_text())
    for module in FOREIGN:
        importlib.import_module(module)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("simgap", "checker", "tests", "configs"):
            shutil.copytree(ROOT / part, folder / part)
        shutil.copy2(ROOT / "pyproject.toml", folder)
        for tests in sorted({m.tests for m in chosen}):
            print("without a fault:", *tests, flush=True)
            if not passes(folder, tests):
                sys.exit(f"{tests} fail without any fault:\n{(folder / LOG).read_text()[-3000:]}")
        for mutant in chosen:
            path = folder / mutant.file
            path.write_text(mutated(mutant, path.read_text()))
            caught = not passes(folder, mutant.tests)
            shutil.copy2(ROOT / mutant.file, path)
            rows.append({"file": mutant.file, "fault": mutant.fault, "tests": mutant.tests, "caught": caught})
            print("caught  " if caught else "SURVIVED", mutant.file, "-", mutant.fault, flush=True)
    survived = [row for row in rows if not row["caught"]]
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = round(used.ru_utime + used.ru_stime)
    print(f"{len(rows) - len(survived)} of {len(rows)} caught, {seconds} s of CPU")
    if not only:
        content = {"mutants": len(rows), "caught": len(rows) - len(survived), "cpu_s": seconds, "rows": rows}
        RESULT.write_text(json.dumps(content, indent=1) + "\n")
    sys.exit(1 if survived else 0)


if __name__ == "__main__":
    main()
