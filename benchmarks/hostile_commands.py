"""Whole commands in hostile folders, by the thousand: links, pipes, modules, profiles, names, archives, disks, clocks.

    python benchmarks/hostile_commands.py [--count 2000] [--first 0] [--seed 1] [--minutes M] [--folder DIR] [--only N]

Folder n of a seed is made from these two alone (hostile/folders.py), and one command is run in it, in a process of its
own (hostile/whole.py). A finding is: a traceback, an end by a signal or without a reason in one line, more than 60 s at
work or 3 GB, a changed file outside the folder, code of the folder that ran, characters that steer a terminal, a
half-written file. It goes on where it was when it is called again.
Results: benchmarks/results/hostile_commands.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

from hostile import ROOT, prepare
from hostile.folders import CART, RUN, TAU, units
from hostile.whole import one, plain, warm

RESULT = ROOT / "benchmarks/results/hostile_commands.json"


def results_of_the_cart(kept: Path) -> None:
    """A bound and a controller that are whole, once."""
    if (kept / "results").is_dir():
        return
    kept.mkdir(parents=True, exist_ok=True)
    (kept / "cart.yaml").write_text(CART.format(unit="m", tau=TAU, files="run.csv"))
    (kept / "run.csv").write_text(RUN)
    command = [Path(sys.executable).with_name("simgap"), "run", "cart.yaml", "--until=synthesis"]
    subprocess.run(command, cwd=kept, check=False, stdout=subprocess.DEVNULL)


def report(done: list[dict[str, Any]], seed: str) -> None:
    """Counts by command and by what was done, and every finding."""
    content = {
        "seed": seed,
        "folders": len(done),
        "findings": sum(d["wrong"] is not None for d in done),
        "by_command": Counter(d["command"][0] for d in done),
        "by_ingredient": Counter(name for d in done for name in d["done"]),
        "by_status": Counter(str(d["status"]) for d in done),
        "wall_s": round(sum(d["seconds"] for d in done)),
        "found": [d for d in done if d["wrong"] is not None],
    }
    RESULT.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")
    print(json.dumps({k: v for k, v in content.items() if k != "found"}, indent=1))


def main() -> None:
    """Try, count, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", default="1")
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--folder", type=Path, default=Path("/tmp/simgap-hostile"))
    parser.add_argument("--only", type=int, default=None)
    asked = parser.parse_args()
    end, kept = time.monotonic() + 60 * asked.minutes, asked.folder / "kept"
    prepare(kept)
    results_of_the_cart(kept)
    units(kept)
    os.environ |= dict.fromkeys(("TMPDIR", "XDG_CACHE_HOME"), str(asked.folder / "own"))
    (asked.folder / "own").mkdir(exist_ok=True)
    warm()
    if asked.only is not None:
        print(json.dumps(plain(one(asked.only, asked.seed, asked.folder, kept)), indent=1))
        return
    journal = asked.folder / f"tried-{asked.seed}.jsonl"
    done = [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []
    ran = {d["number"] for d in done}
    for number in (k for k in range(asked.first, asked.count) if k not in ran):
        if time.monotonic() > end:
            break
        done.append(plain(one(number, asked.seed, asked.folder, kept)))
        with journal.open("a") as stream:
            stream.write(json.dumps(done[-1]) + "\n")
        if done[-1]["wrong"]:
            print(number, done[-1]["command"], done[-1]["done"], done[-1]["wrong"][-500:], flush=True)
    report(done, asked.seed)


if __name__ == "__main__":
    main()
