"""Hostile and damaged inputs by the hundred thousand: each is read, or refused by one short line.

    python benchmarks/fuzz.py [--only WORD] [--share 1.0] [--minutes 4] [--folder DIR]

Input number n of a kind is made from these two alone (folder hostile). Blocks of inputs run in processes of their own
with alarms for each input (10 s at work, 90 s in all) and a limit of memory; an audit hook sees every file opened for
writing, every process and every socket. A finding is: an exception that is no SimgapError, a message of several lines
or with characters that cannot be printed, an input that takes longer or more memory, a file outside the folder, a
process, a socket. With `--minutes` it stops and goes on where it was when it is called again.
Results: benchmarks/results/fuzz.json.
"""

from __future__ import annotations

import argparse
import json
import mmap
import os
import random
import resource
import signal
import struct
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

from hostile import KINDS, ROOT, prepare

RESULT = ROOT / "benchmarks/results/fuzz.json"
BLOCK = 1000
LONGEST = 10  # seconds of this process, at work
ASLEEP = 90  # seconds of the clock, on a machine that has other work too
MEMORY = 2 << 30  # bytes beyond those of the process at its start
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
FORBIDDEN = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "socket.bind", "socket.connect"}


def watch(folder: Path, seen: list[str]) -> None:
    """Note what an input must not do; reading is allowed."""
    # Byte code has a place of its own; whether /proc, which a command line names, takes files is tried and refused.
    allowed = (str(folder), "/dev/null", "/dev/full", "/proc", *filter(None, [sys.pycache_prefix]))

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in FORBIDDEN:
            seen.append(f"{event} {arguments!r:.100}")
        if event == "open" and isinstance(arguments[2], int) and arguments[2] & WRITING:
            path = arguments[0]
            where = os.path.abspath(os.fsdecode(path)) if isinstance(path, str | bytes | os.PathLike) else ""
            if where and not where.startswith(allowed) and "__pycache__" not in where:
                seen.append(f"opened {where:.200} for writing")

    sys.addaudithook(hook)


def block(kind: str, first: int, last: int, folder: Path, place: mmap.mmap) -> list[dict[str, Any]]:
    """Inputs first..last-1 of a kind, in this process: -> what was found."""
    from simgap.errors import SimgapError

    seen: list[str] = []
    watch(folder, seen)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
    found = []
    for n in range(first, last):
        place[:8] = struct.pack("q", n)
        signal.setitimer(signal.ITIMER_PROF, LONGEST)  # ends the process, even within C code
        signal.alarm(ASLEEP)
        wrong = None
        try:
            KINDS[kind][1](random.Random(f"{kind} {n}"), folder)
        except SimgapError as error:
            text = str(error).replace(str(folder), "")
            if not text.isprintable() or len(text) > 1500:
                wrong = f"a message of {len(text)} characters: {text[:100]!r}"
        except BaseException:
            wrong = traceback.format_exc()[-1500:]
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        if seen:
            wrong = "; ".join(seen)
            seen.clear()
        if wrong:
            found.append({"kind": kind, "number": n, "wrong": wrong})
    return found


def in_child(kind: str, first: int, last: int, folder: Path) -> list[dict[str, Any]]:
    """A block in a fork; where that dies, the input it was at is the finding, and the rest runs in another."""
    found: list[dict[str, Any]] = []
    place, report = mmap.mmap(-1, 8), folder / "findings.json"
    while first < last:
        report.unlink(missing_ok=True)
        child = os.fork()
        if child == 0:
            status = 1
            try:
                os.chdir(folder)
                warnings.simplefilter("ignore")
                content = block(kind, first, last, folder, place)
                report.write_text(json.dumps(content))
                status = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(status)
        _, status = os.waitpid(child, 0)
        if status == 0:
            return found + json.loads(report.read_text())
        at = struct.unpack("q", place[:8])[0]
        late = {signal.SIGPROF: f"over {LONGEST} s of work", signal.SIGALRM: f"over {ASLEEP} s"}
        how = late.get(status, f"the process ended with {status}")
        found.append({"kind": kind, "number": at, "wrong": how})
        first = at + 1
    return found


def main() -> None:
    """Fuzz, count, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--folder", type=Path, default=Path("/tmp/simgap-fuzz"))
    asked = parser.parse_args()
    end = time.monotonic() + 60 * asked.minutes
    os.environ |= dict.fromkeys(("TMPDIR", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"), str(asked.folder))
    prepare(asked.folder)
    warnings.simplefilter("ignore")
    journal = asked.folder / "blocks.jsonl"
    done = [json.loads(line) for line in journal.read_text().splitlines()] if journal.exists() else []
    blocks = []
    for kind, (count, read) in KINDS.items():
        blocks += [
            (kind, k, min(k + BLOCK, int(count * asked.share))) for k in range(0, int(count * asked.share), BLOCK)
        ]
        if asked.only in kind:
            try:  # import what it imports, once
                read(random.Random(0), asked.folder)
            except Exception as error:
                print(kind, "warm:", str(error)[:100])
    blocks.sort(key=lambda b: b[1] / KINDS[b[0]][0])  # every kind gets its share of a short run
    ran = {(d["kind"], d["first"], d["last"]) for d in done}
    for kind, first, last in blocks:
        if time.monotonic() > end:
            break
        if asked.only not in kind or (kind, first, last) in ran:
            continue
        began = time.process_time() + sum(os.times()[2:4])
        found = in_child(kind, first, last, asked.folder)
        spent = time.process_time() + sum(os.times()[2:4]) - began
        done.append({"kind": kind, "first": first, "last": last, "found": found, "cpu_s": round(spent, 1)})
        with journal.open("a") as stream:
            stream.write(json.dumps(done[-1]) + "\n")
        for one in found[:3]:
            print(one["kind"], one["number"], one["wrong"][-400:], flush=True)
    report(done)


def report(done: list[dict[str, Any]]) -> None:
    """Counts by kind."""
    counts = {kind: sum(d["last"] - d["first"] for d in done if d["kind"] == kind) for kind in KINDS}
    found = {kind: sum(len(d["found"]) for d in done if d["kind"] == kind) for kind in KINDS}
    cpu = {kind: round(sum(d["cpu_s"] for d in done if d["kind"] == kind)) for kind in KINDS}
    content = {
        "inputs": sum(counts.values()),
        "findings": sum(found.values()),
        "by_kind": counts,
        "found": found,
        "cpu_s": cpu,
    }
    RESULT.write_text(json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
