"""What disks, clocks and other programs do to a run: each is one clear line or a clean end, and nothing is lost.

    python benchmarks/storage.py [--only WORD] [--minutes 4] [--folder DIR] [--clock libfaketime.so.1]

Every stage of the tiny cases (tiny_cases.py) meets, run as its rule types it:

    cut, flipped    each result that it reads, cut off or with one bit flipped
    full            a disk with less room than it writes (a tmpfs of that size; without the right to mount one, skipped)
    read-only       results mounted read-only (likewise)
    quota           EDQUOT from the system when a result is forced to the disk, and a limit on the size of a file
    twice           the same stage in the same folder at the same moment
    rewritten       another program that rewrites what it reads, whole and damaged in turns, while it reads
    clock           a clock that jumps by days and years in both directions while it runs (with libfaketime)

A stage may refuse, with one line and status 1 or 2, or end well with the bytes of a run that nothing disturbed. A fault
counts as wrong where it does neither, where it leaves a temporary file or changes one that was there, or where the
same command does not make the same bytes when the fault is gone. With `--minutes` it stops, and goes on where it was
when it is called again. Results: benchmarks/results/storage.json.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import time
from collections import Counter
from pathlib import Path
from typing import Any

import stage_runs
import storage_faults
from stage_runs import Journal, Stage, digests, finish, fork, restore

RESULT = stage_runs.ROOT / "benchmarks/results/storage.json"


def judge(stage: Stage, source: Path, place: Path, ended: tuple[int, str], spared: set[str]) -> str | None:
    """What is wrong with how a stage ended that met a fault; files in `spared` were damaged on purpose."""
    status, how = ended
    said = place.with_suffix(".out").read_text(errors="replace").strip()
    if status not in (0, 1, 2):
        return f"{how}: {said[-300:]}"
    if status and (said.count("\n") or not said.startswith("simgap: ") or len(said) > 1500):
        return f"not one line: {said[-600:]}"
    made = digests(place)
    if status == 0:
        differ = [n for n, digest in stage.makes.items() if made.get(n) != digest]
        if differ:
            return f"ended well with other bytes: {differ}"
    whole = digests(source)
    lost = [n for n in stage.before if n not in spared and n in whole and made.get(n) != whole[n]]
    hidden = [str(p.relative_to(place)) for p in place.rglob(".*") if ".snakemake" not in p.parts]
    half = [n for n in stage.makes if n in made and made[n] != stage.makes[n]]
    return f"lost: {lost}; left: {hidden}; half: {half}" if lost or hidden or half else None


def again(stage: Stage, place: Path) -> str | None:
    """What is wrong with the same command when the fault is gone."""
    status, how = finish(fork(place, stage.command))
    if status:
        return f"run again: {how}: {place.with_suffix('.out').read_text()[-300:]}"
    made = digests(place)
    differ = [n for n, digest in stage.makes.items() if made.get(n) != digest]
    return f"run again: other bytes: {differ}" if differ else None


def meet(fault: str, stage: Stage, detail: str, source: Path, place: Path, clock: str) -> dict[str, Any]:
    """One stage meets one fault: -> what was found."""
    rng = random.Random(f"{fault} {stage.command} {detail}")
    with storage_faults.ground(fault, stage, source, place) as ready:
        if not ready:
            return {"skipped": True}
        if fault not in storage_faults.MOUNTED:
            restore(source, stage.before, place)
        ended, spared = storage_faults.FAULTS[fault](stage, detail, source, place, rng, clock)
        if ended is None:
            return {"skipped": True}
        wrong = judge(stage, source, place, ended, spared)
        storage_faults.relieve(fault, place)
        for name in spared:
            shutil.copyfile(source / name, place / f"{name}.new")
            os.replace(place / f"{name}.new", place / name)
        if wrong is None and ended[0] and (fault not in ("cut", "flipped") or rng.random() < 0.1):
            wrong = again(stage, place)
    return {"refused": ended[0] != 0} | ({"wrong": wrong} if wrong else {})


def main() -> None:
    """Inject, judge, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--folder", type=Path, default=Path("/tmp/simgap-storage"))
    parser.add_argument("--clock", default=storage_faults.faketime())
    asked = parser.parse_args()
    end = time.monotonic() + 60 * asked.minutes
    asked.folder.mkdir(parents=True, exist_ok=True)
    stage_runs.warm()
    stages, journal = stage_runs.reference(asked.folder), Journal(asked.folder, "faults")
    ran = {(d["fault"], d["stage"], d["detail"]) for d in journal.done}
    for fault, number, detail in storage_faults.plan(stages):
        stage = stages[number]
        key = (fault, f"{number} {stage.name}", detail)
        if key in ran or asked.only not in fault:
            continue
        if time.monotonic() > end:
            break
        found = meet(fault, stage, detail, asked.folder / "again", asked.folder / "one", asked.clock)
        journal.add(dict(zip(("fault", "stage", "detail"), key, strict=True)) | found)
        if "wrong" in found:
            print(*key, found["wrong"], flush=True)
    report(journal.done)


def report(done: list[dict[str, Any]]) -> None:
    """Counts by fault."""
    met = [d for d in done if "skipped" not in d]
    content = {
        "faults": len(met),
        "wrong": sum("wrong" in d for d in met),
        "refused_in_one_line": sum(d["refused"] for d in met),
        "ended_with_the_same_bytes": sum(not d["refused"] for d in met),
        "by_fault": dict(Counter(d["fault"] for d in met)),
        "by_stage": dict(sorted(Counter(d["stage"].split()[1] for d in met).items())),
        "skipped": dict(Counter(d["fault"] for d in done if "skipped" in d)),
    }
    RESULT.write_text(json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
