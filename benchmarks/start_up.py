"""What each stage imports and spends before it computes: `python benchmarks/start_up.py` writes results/start_up.json.

Every stage of a tiny case on PyBullet (`tiny_cases.py`) runs as its rule types it, in a fresh process, twice: the
first fills the caches of machine code (`cold_cpu_s`), the second is what else the table tells: CPU seconds of the
process and of its engines, the modules that it had imported when it ended, and the large libraries among them.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from stage_runs import environment
from tiny_cases import write_cases

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "benchmarks" / "results" / "start_up.json"
LARGE = [
    "numba", "sympy", "scipy", "scipy.stats", "pyarrow", "pydrake", "matplotlib", "rerun", "cvxpy", "jinja2", "pandas",
]  # fmt: skip
STAGE = """
import json, os, sys
from simgap.cli import main
large, sys.argv = sys.argv[1].split(","), ["simgap", *sys.argv[2:]]
try:
    main(sys.argv[1:])
finally:
    used = os.times()
    found = {"modules": len(sys.modules), "large": [name for name in large if name in sys.modules]}
    found |= {"cpu_s": round(used.user + used.system, 2)}
    found |= {"engines_cpu_s": round(used.children_user + used.children_system, 2)}
    open(os.environ["TOLD"], "w").write(json.dumps(found))
"""


def commands(folder: Path) -> list[list[str]]:
    """The stages of the case, each as its rule types it; not those of the corrected case."""
    plan = [sys.executable, "-m", "simgap.cli", "run", "small.yaml", "--cores", "1", "-n", "-p"]
    told = subprocess.run(plan, cwd=folder, env=environment(), capture_output=True, text=True, check=True).stdout
    found = [shlex.split(line)[1:] for line in re.findall(r"Shell command: (simgap .*)", told)]
    return [words for words in found if not any("corrected" in word for word in words) and words[0] != "index"]


def stage(folder: Path, command: list[str]) -> dict[str, object]:
    """One stage in a process of its own."""
    told = folder / "told.json"
    words = [sys.executable, "-c", STAGE, ",".join(LARGE), *command]
    subprocess.run(words, cwd=folder, env=environment(TOLD=str(told)), check=True, stdout=subprocess.DEVNULL)
    return {"stage": command[0], **json.loads(told.read_text())}


def main() -> None:
    """Run every stage twice; of one that comes several times the first is told."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        os.environ["XDG_CACHE_HOME"] = f"{place}/cache"  # empty: machine code, byte code and expressions
        write_cases(folder)
        rows: dict[str, dict[str, object]] = {}
        for command in commands(folder):
            first = stage(folder, command)
            if command[0] not in rows:
                rows[command[0]] = stage(folder, command) | {"cold_cpu_s": first["cpu_s"]}
                print(json.dumps(rows[command[0]]), flush=True)
    machine = {"cores": os.cpu_count(), "python": sys.version.split()[0]}
    RESULT.write_text(json.dumps({"machine": machine, "rows": list(rows.values())}, indent=1) + "\n")


if __name__ == "__main__":
    main()
