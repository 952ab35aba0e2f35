"""Running the checker as a person does, and deceiving it as a clever one would."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

CHECKER = Path(__file__).parents[2] / "checker"


def run(folder, *more):
    """The checker as a person runs it, on an interpreter that finds no simgap."""
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    command = [sys.executable, str(CHECKER / "check.py"), str(folder), *more]
    done = subprocess.run(command, capture_output=True, text=True, env=env, cwd=folder, check=False)
    return done.returncode, done.stdout + done.stderr


def change(folder, edit=None, **tables):
    """Change header or tables and make every sum anew: what somebody does who wants to deceive."""
    path = folder / "certificate.json"
    head = json.loads(path.read_text())
    for name, table in tables.items():
        np.save(folder / f"{name}.npy", table)
        head["files"][f"{name}.npy"] = hashlib.sha256((folder / f"{name}.npy").read_bytes()).hexdigest()
    if edit is not None:
        edit(head)
    rest = {k: v for k, v in head.items() if k != "digest"}
    head["digest"] = hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
    path.write_text(json.dumps(head))
