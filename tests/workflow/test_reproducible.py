"""The same case elsewhere: another copy of the package, more cores, other caches, date, zone and seed of hashes.

All stages are compared in benchmarks/reproducible.py.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.little_cart import write_cart

ROOT = Path(__file__).parents[2]
CASE = {
    "simulator": {"engine": "equations", "integrator": "rk4"},
    "domain": {"tau": 0.1, "X": {"x": [-1, 1], "v": [-1, 1]}, "U": {"F": {"values": [-1, 0, 1]}}},
    "grid": {"eps": 0.2, "shards": 1},
    "gap": {"basis": ["x", "v", "F", 1], "fresh_samples": 300},
}
PROGRAM = """
import sys, time
shift, workers = float(sys.argv[1]), sys.argv[2]
real = time.time
time.time = lambda: real() + shift  # another day
from simgap.cli import main
for words in (["grid", "cart.yaml", "--out", "grid", "--log", "logs/a"],
              ["rollouts", "cart.yaml", "--grid", "grid", "--shard", "0", "--out", "shard.parquet", "--log", "logs/b"],
              ["fresh", "cart.yaml", "--out", "fresh.parquet", "--workers", workers, "--log", "logs/c"],
              ["lipschitz", "cart.yaml", "--grid", "grid", "--rollouts", "shard.parquet",
               "--out", "v.json", "--log", "logs/d"]):
    try:
        main(words)
    except SystemExit as ended:
        assert ended.code == 0, words
"""


def made(folder, package, shift, workers, **environment):
    """The bytes of every result of a run in this folder."""
    folder.mkdir(parents=True)
    write_cart(folder, **CASE)
    (folder / "run.py").write_text(f"if __name__ == '__main__':\n    exec({PROGRAM!r})\n")
    env = os.environ | {"PYTHONPATH": str(package)} | environment
    command = [sys.executable, "run.py", str(shift), str(workers)]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.parent.name != "logs"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_every_result_has_the_same_bytes_elsewhere(tmp_path):
    first = made(tmp_path / "a", ROOT, 0, 1, PYTHONHASHSEED="1")
    assert {"grid/states.parquet", "shard.parquet", "fresh.parquet", "v.json"} <= set(first)
    clone = tmp_path / "another place" / "clone"
    shutil.copytree(ROOT / "simgap", clone / "simgap", ignore=shutil.ignore_patterns("__pycache__"))
    other = {"PYTHONHASHSEED": "2", "TZ": "Asia/Kathmandu", "LC_ALL": "C", "XDG_CACHE_HOME": str(tmp_path / "cold")}
    second = made(tmp_path / "another place" / "b", clone, 4e7, 2, **other)
    assert first == second
