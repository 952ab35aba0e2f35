"""Damaged inputs, disks that are full and outputs that cannot be written, for every stage: one line, or the same bytes.

    python benchmarks/storage.py [--faults 300] [--folder DIR] [--minutes 4]

Stages of the tiny cases (stage_runs.py) run as their rules type them, each with one fault: a bit of an input flipped,
an input cut off, emptied, replaced by a folder or by another result; a disk that takes no more after some bytes; a
folder in the place of an output. A stage must end with status 0 and the same bytes, or with one line on stderr, no
traceback, nothing hidden left, and be taken up by the same command when the fault is gone.
Results: results/storage.json.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import time
from collections import Counter
from pathlib import Path
from typing import Any

import stage_runs
from stage_runs import Stage, digests, finish, fork, restore

RESULT = stage_runs.ROOT / "benchmarks/results/storage.json"
FAULTS = (
    "flipped bit",
    "cut off",
    "emptied",
    "folder",
    "another result",
    "full disk",
    "full disk",
    "output is a folder",
)


def inject(fault: str, stage: Stage, source: Path, place: Path, rng: random.Random) -> tuple[str, int]:
    """Put the fault in: -> what it was done to, and the bytes that a file may have (0: any number)."""
    results = [n for n in stage.before if n in " ".join(stage.command) and (place / n).is_file()]
    if fault == "full disk":
        return "the disk", rng.choice((1, 100, 1000, 4000, 20_000, 100_000))
    if fault == "output is a folder" or not results:
        name = rng.choice(sorted(stage.makes) or ["nothing"])
        (place / name).mkdir(parents=True, exist_ok=True)
        return name, 0
    name = rng.choice(results)
    data = bytearray((source / name).read_bytes())
    (place / name).unlink()
    if fault == "folder":
        (place / name).mkdir()
        return name, 0
    if fault == "flipped bit" and data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif fault == "cut off":
        data = data[: rng.randrange(max(1, len(data)))]
    elif fault == "emptied":
        data = bytearray()
    elif fault == "another result":
        data = bytearray((source / rng.choice(results)).read_bytes())
    (place / name).write_bytes(data)
    return name, 0


def one(stage: Stage, fault: str, source: Path, place: Path, rng: random.Random) -> dict[str, Any]:
    """One fault in one stage, then the same command without it."""
    restore(source, stage.before, place)
    where, most = inject(fault, stage, source, place, rng)
    if most:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))  # the fork has it too
        process = fork(place, stage.command)
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    else:
        process = fork(place, stage.command)
    status, told = finish(process)
    out = place.with_suffix(".out").read_text(errors="replace")
    result: dict[str, Any] = {"stage": stage.name, "fault": fault, "where": where, "status": status}
    if status == 0:
        made = digests(place)
        differ = [n for n, d in stage.makes.items() if made.get(n) != d]
        return result | ({"wrong": f"accepted, other bytes: {differ}"} if differ and fault != "another result" else {})
    said = [line for line in out.splitlines() if line.startswith("simgap: ")]
    if status not in (1, 2) or "Traceback" in out or (len(said) != 1 and not most):
        return result | {"wrong": f"{told}: {out[-400:]}"}
    hidden = [str(p.relative_to(place)) for p in place.rglob(".*")]
    if hidden:
        return result | {"wrong": f"left {hidden}"}
    for name in stage.makes:
        if (place / name).is_dir():
            shutil.rmtree(place / name)
    for name in (n for n in stage.before if n == where):
        shutil.rmtree(place / name) if (place / name).is_dir() else (place / name).unlink()
        os.link(source / name, place / name)
    status, told = finish(fork(place, stage.command))
    made = digests(place)
    differ = [n for n, d in stage.makes.items() if made.get(n) != d]
    return result | ({"wrong": f"not taken up: {told}, {differ}"} if status or differ else {})


def main() -> None:
    """Inject, count, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", type=int, default=300)
    parser.add_argument("--folder", type=Path, default=Path("/tmp/simgap-kill"))
    parser.add_argument("--minutes", type=float, default=1e9)
    asked = parser.parse_args()
    end = time.monotonic() + 60 * asked.minutes
    asked.folder.mkdir(parents=True, exist_ok=True)
    stage_runs.warm()
    stages = stage_runs.reference(asked.folder)
    journal = asked.folder / "storage.jsonl"
    done = [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []
    for number in range(len(done), asked.faults):
        if time.monotonic() > end:
            break
        stage, fault = stages[number % len(stages)], FAULTS[number * 5 % len(FAULTS)]
        found = one(stage, fault, asked.folder / "again", asked.folder / "two", random.Random(f"storage {number}"))
        done.append(found)
        with journal.open("a") as stream:
            stream.write(json.dumps(found) + "\n")
        if "wrong" in found:
            print(number, found, flush=True)
    content = {
        "injected": len(done),
        "wrong": sum("wrong" in f for f in done),
        "refused": sum(f["status"] != 0 for f in done),
        "by_fault": dict(Counter(f["fault"] for f in done)),
    }
    RESULT.write_text(json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
