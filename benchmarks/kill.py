"""Kills every stage, at random moments and within every write, runs it again, and compares bytes.

    python benchmarks/kill.py [--kills 300] [--workflow 0] [--folder DIR] [--minutes 4]

Each kill (SIGKILL to the process group) hits a stage of a tiny case, run as its rule types it, which is then run
again by the same command: three are killed in a row, the fourth runs to its end. Counted are kills after which every
file has the bytes of the run that nothing disturbed, no process is alive, and no temporary file, lock or shared memory
is left. `--workflow` kills go to `simgap run` as a whole, after a random time; it is then typed again. Jobs have
numbers, and random numbers of their own; with `--minutes` the benchmark stops and goes on where it was when it is
called again. Results: benchmarks/results/kill.json. Semaphores that others leave behind meanwhile would count too: run
it alone, or within `unshare -m` with a /dev/shm of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path
from typing import Any

import stage_runs
from stage_runs import Journal, Stage, digests, finish, fork, restore
from tiny_cases import write_cases

RESULT = stage_runs.ROOT / "benchmarks/results/kill.json"
CHAIN = 3  # kills in a row before a run is left to end
POINTS = 3  # places within a write: before it, half of it done, just after it


def left_behind(folder: Path, scratch: Path, shared: set[str], mark: str) -> list[str]:
    """What a killed run left and the next one did not take away."""
    end = time.monotonic() + 10
    while (processes := stage_runs.alive(mark)) and time.monotonic() < end:
        time.sleep(0.02)
    found = [f"process {n}" for n in processes]
    for process in processes:
        os.kill(process, signal.SIGKILL)
    hidden = (p for p in folder.rglob(".*") if ".snakemake" not in p.parts)
    found += [str(path.relative_to(folder)) for path in hidden]
    found += [f"temporary {path.name}" for path in scratch.iterdir()]
    return found + [f"shared memory {name}" for name in unused(set(os.listdir("/dev/shm")) - shared)]


def unused(names: set[str]) -> set[str]:
    """Of shared memory that which no process maps: nobody will take it away."""
    left = set(names)
    for maps in Path("/proc").glob("[0-9]*/maps"):
        if not left:
            break
        try:
            text = maps.read_text()
        except OSError:
            continue
        left -= {name for name in left if name in text}
    return {name for name in left if (Path("/dev/shm") / name).exists()}


def kill_stage(stage: Stage, source: Path, place: Path, rng: random.Random, number: int) -> dict[str, Any]:
    """A stage is killed CHAIN times in a row, each time going on from what is left; then it runs to its end."""
    mark, scratch, shared = f"kill-{os.getpid()}-{number}", place.with_suffix(".tmp"), set(os.listdir("/dev/shm"))
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    restore(source, stage.before, place)
    result: dict[str, Any] = {"stage": stage.name, "killed": 0, "in_write": 0, "runs": CHAIN}
    for _ in range(CHAIN):
        status, told, in_write = _killed(stage, place, rng, mark, scratch)
        if status not in (0, -signal.SIGKILL):
            return result | {"wrong": f"the run that was to be killed: {told}"}
        result["killed"] += status == -signal.SIGKILL
        result["in_write"] += in_write and status == -signal.SIGKILL
    began = time.monotonic()
    status, told = finish(fork(place, stage.command, FAULT_MARK=mark, TMPDIR=str(scratch)))
    TIMES[stage.name] = max(0.2, time.monotonic() - began)
    if status:
        return result | {"wrong": f"run again: {told}: {place.with_suffix('.out').read_text()[-300:]}"}
    made = digests(place)
    differ = [n for n, digest in stage.makes.items() if made.get(n) != digest]
    differ += [n for n in stage.recordings if not (place / n).exists()]
    left = left_behind(place, scratch, shared, mark)
    return result | ({"wrong": f"differ: {differ}; left: {left}"} if differ or left else {})


def _killed(stage: Stage, place: Path, rng: random.Random, mark: str, scratch: Path) -> tuple[int, str, bool]:
    """One kill, at a place within a write or at any moment: -> how the run ended, and whether it was the former."""
    in_write = rng.random() < 0.6
    writes = max(1, len(stage.makes) + len(stage.recordings))
    more = {"SIMGAP_KILL_AT": str(rng.randint(1, POINTS * writes))} if in_write else {}
    process = fork(place, stage.command, FAULT_MARK=mark, TMPDIR=str(scratch), **more)
    if not in_write:
        time.sleep(rng.uniform(0.0, TIMES.get(stage.name, 2.0)))
        os.killpg(process, signal.SIGKILL)
    return *finish(process), in_write


TIMES: dict[str, float] = {}


def kill_workflow(folder: Path, rng: random.Random, number: int, wanted: dict[str, str]) -> dict[str, Any]:
    """One kill of `simgap run`, which goes on from what earlier kills left of it."""
    mark, shared = f"workflow-{os.getpid()}-{number}", set(os.listdir("/dev/shm"))
    folder.mkdir(parents=True, exist_ok=True)
    scratch = folder.with_suffix(".tmp")
    scratch.mkdir(exist_ok=True)
    if not (folder / "small.yaml").exists():
        write_cases(folder)
    run = stage_runs.workflow(folder, 2, "--quiet", "all", FAULT_MARK=mark, TMPDIR=str(scratch))
    try:
        run.communicate(timeout=rng.uniform(3.0, 25.0))
    except subprocess.TimeoutExpired:
        whole = rng.random() < 0.7  # else the command that a person sees alone, whose processes must follow it
        (os.killpg if whole else os.kill)(run.pid, signal.SIGKILL)
        run.wait()
    killed = int(run.returncode == -signal.SIGKILL)
    result: dict[str, Any] = {"stage": "simgap run", "killed": killed, "in_write": 0, "runs": 1}
    if run.returncode not in (0, -signal.SIGKILL):
        return result | {"wrong": f"status {run.returncode}"}
    if run.returncode == 0:  # all is there: the bytes are compared, and it begins anew
        made = digests(folder)
        differ = sorted(n for n, digest in wanted.items() if made.get(n) != digest)
        left = left_behind(folder, scratch, shared, mark)
        left += [p.name for p in (folder / ".snakemake/locks").glob("*")]
        shutil.rmtree(folder)
        shutil.rmtree(scratch)
        return result | ({"wrong": f"differ: {differ}; left: {left}"} if differ or left else {"whole": True})
    end = time.monotonic() + 10
    while (processes := stage_runs.alive(mark)) and time.monotonic() < end:
        time.sleep(0.02)
    return result | ({"wrong": f"processes {processes}"} if processes else {})


def main() -> None:
    """Kill, recover, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=300)
    parser.add_argument("--workflow", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("/tmp/simgap-kill"))
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--seed", type=int, default=14)
    asked = parser.parse_args()
    end = time.monotonic() + 60 * asked.minutes
    asked.folder.mkdir(parents=True, exist_ok=True)
    stage_runs.warm()
    stages = stage_runs.reference(asked.folder)
    journal = Journal(asked.folder, "kills")
    ran = {(k["kind"], k["number"]) for k in journal.done}
    jobs = [("stage", n) for n in range(-(-asked.kills // CHAIN))] + [("workflow", n) for n in range(asked.workflow)]
    wanted = digests(asked.folder / "again")
    for kind, number in (job for job in jobs if job not in ran):
        if time.monotonic() > end:
            break
        rng = random.Random(f"{asked.seed} {kind} {number}")
        if kind == "stage":
            stage = stages[number % len(stages)]
            found = kill_stage(stage, asked.folder / "again", asked.folder / "one", rng, number)
        else:
            found = kill_workflow(asked.folder / "run", rng, number, wanted)
        journal.add({"kind": kind, "number": number} | found)
        if "wrong" in found:
            print(kind, number, found, flush=True)
    _report(journal.done)


def _report(done: list[dict[str, Any]]) -> None:
    by_stage: Counter[str] = Counter()
    for job in done:
        by_stage[job["stage"]] += job["killed"]
    content = {
        "killed": by_stage.total(),
        "killed_in_a_write": sum(job["in_write"] for job in done),
        "ended_before_the_kill": sum(job["runs"] - job["killed"] for job in done),
        "not_recovered": sum("wrong" in job for job in done),
        "by_stage": dict(sorted(by_stage.items())),
    }
    RESULT.write_text(json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
