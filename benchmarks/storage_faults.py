"""The faults of storage.py: how each is brought about, and how it is taken away again."""

from __future__ import annotations

import errno
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from stage_runs import Stage, environment, finish, fork

Ended = tuple[tuple[int, str] | None, set[str]]
MOUNTED = ("full", "read-only")
BALLAST = "ballast"
RESULTS = (".parquet", ".json", ".npz")


def faketime() -> str:
    """Where libfaketime stands, if it does."""
    found = sorted(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"))
    return str(found[0]) if found else ""


def results_read(stage: Stage) -> list[str]:
    """Results among the files that were there before and that the command names, or that lie in a folder it names."""
    named = [Path(word) for word in stage.command]
    return [n for n in stage.before if n.endswith(RESULTS) and any(Path(n).is_relative_to(p) for p in named if p.parts)]


def plan(stages: Sequence[Stage]) -> list[tuple[str, int, str]]:
    """Every fault with the number of the stage that meets it, and what of it is meant; a part of it has some of all."""
    every = sorted(_every(stages))
    random.Random(14).shuffle(every)
    return every


def _every(stages: Sequence[Stage]) -> Iterator[tuple[str, int, str]]:
    for number, stage in enumerate(stages):
        for name in results_read(stage):
            yield "cut", number, name
            yield "flipped", number, name
        if stage.makes:
            yield from (("full", number, ""), ("read-only", number, ""))
            yield from (("quota", number, "disk"), ("quota", number, "size of a file"))
        yield "twice", number, ""
        if results_read(stage):
            yield "rewritten", number, ""
        yield "clock", number, ""


@contextmanager
def ground(fault: str, stage: Stage, source: Path, place: Path) -> Iterator[bool]:
    """The folder of a stage; for some faults a disk of its own with what was there before."""
    shutil.rmtree(place, ignore_errors=True)
    if fault not in MOUNTED:
        yield True
        return
    place.mkdir(parents=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={_room(stage, source) // 4096 + 2048}k", "simgap", str(place)]
    if os.geteuid() or subprocess.run(mount, capture_output=True, check=False).returncode:
        yield False
        return
    try:
        for name in stage.before:
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / name, place / name)
        yield True
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)


def _room(stage: Stage, source: Path) -> int:
    return 4 * sum((source / n).stat().st_size for n in (*stage.before, *stage.makes, *stage.recordings))


def relieve(fault: str, place: Path) -> None:
    """Room on the full disk, the right to write on the other."""
    if fault == "full":
        (place / BALLAST).unlink(missing_ok=True)
    if fault == "read-only":
        subprocess.run(["mount", "-o", "remount,rw", str(place)], check=True)


def cut(stage: Stage, detail: str, source: Path, place: Path, rng: random.Random, clock: str) -> Ended:
    """A file that ends too early."""
    data = (source / detail).read_bytes()
    return _damaged(stage, detail, place, data[: rng.randrange(len(data))])


def flipped(stage: Stage, detail: str, source: Path, place: Path, rng: random.Random, clock: str) -> Ended:
    """A file with one bit flipped."""
    data = bytearray((source / detail).read_bytes())
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return _damaged(stage, detail, place, bytes(data))


def _damaged(stage: Stage, name: str, place: Path, data: bytes) -> Ended:
    (place / name).unlink()  # a hard link of the whole one
    (place / name).write_bytes(data)
    return finish(fork(place, stage.command)), {name}


def full(stage: Stage, detail: str, source: Path, place: Path, rng: random.Random, clock: str) -> Ended:
    """All of the disk is taken but for less than the stage writes."""
    writes = sum((source / n).stat().st_size for n in (*stage.makes, *stage.recordings))
    left = rng.randrange(max(1, writes))
    free = os.statvfs(place).f_bavail * os.statvfs(place).f_frsize
    with (place / BALLAST).open("wb") as stream:
        os.posix_fallocate(stream.fileno(), 0, max(4096, free - left))
    return finish(fork(place, stage.command)), set()


def read_only(stage: Stage, detail: str, source: Path, place: Path, rng: random.Random, clock: str) -> Ended:
    """A disk that takes no files."""
    subprocess.run(["mount", "-o", "remount,ro", str(place)], check=True)
    return finish(fork(place, stage.command)), set()


def quota(stage: Stage, detail: str, source: Path, place: Path, rng: random.Random, clock: str) -> Ended:
    """The system says no: to the n-th file that is forced to the disk, or to what is longer than a limit."""
    largest = max((source / n).stat().st_size for n in stage.makes)
    number, limit = rng.randrange(len(stage.makes)), rng.randrange(max(1, largest))

    def refuse() -> None:
        if detail == "disk":
            left, real = iter(range(number)), os.fsync

            def fsync(descriptor: int) -> None:
                if next(left, None) is None:
                    raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))
                real(descriptor)

            os.fsync = fsync  # type: ignore[assignment]
        else:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return finish(fork(place, stage.command, refuse)), set()


def twice(stage: Stage, detail: str, source: Path, place: Path, rng: random.Random, clock: str) -> Ended:
    """Two at once in one folder; the worse end of the two counts."""
    first, second = fork(place, stage.command), fork(place, stage.command)
    return max((finish(first), finish(second)), key=lambda ended: abs(ended[0])), set()


def rewritten(stage: Stage, detail: str, source: Path, place: Path, rng: random.Random, clock: str) -> Ended:
    """What the stage reads is replaced, and written over in place, by damaged and whole content in turns."""
    over, names = threading.Event(), results_read(stage)
    process = fork(place, stage.command)  # before there are threads here

    def rewrite() -> None:
        while not over.wait(rng.uniform(0.0, 0.01)):
            name = rng.choice(names)
            data = (source / name).read_bytes()
            damaged = data[: rng.randrange(len(data))]
            new = place / f"{name}.new"
            new.write_bytes(damaged if rng.random() < 0.3 else data)
            os.replace(new, place / name)
            if rng.random() < 0.3:
                (place / name).write_bytes(data)
        for name in names:
            (place / f"{name}.new").unlink(missing_ok=True)

    thread = threading.Thread(target=rewrite)
    thread.start()
    try:
        return finish(process), set(names)
    finally:
        over.set()
        thread.join()


def clock_jumps(stage: Stage, detail: str, source: Path, place: Path, rng: random.Random, clock: str) -> Ended:
    """A clock set forward and back by up to three years while the stage runs; a process as a person starts it."""
    if not clock:
        return None, set()
    told = place.with_suffix(".clock")
    told.write_text("+0")
    jumping = {"LD_PRELOAD": clock, "FAKETIME_TIMESTAMP_FILE": str(told), "FAKETIME_NO_CACHE": "1"}
    jumping |= {"FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1"}
    command = [sys.executable, "-m", "simgap.cli", *stage.command]
    with place.with_suffix(".out").open("w") as out:
        run = subprocess.Popen(command, cwd=place, env=environment(**jumping), stdout=out, stderr=out)
        end = time.monotonic() + 120
        while run.poll() is None and time.monotonic() < end:
            told.write_text(f"{rng.randint(-(10**8), 10**8):+d}")
            time.sleep(0.2)
        if run.poll() is None:
            run.kill()
    return (run.wait(), f"status {run.returncode}"), set()


FAULTS: Mapping[str, Callable[[Stage, str, Path, Path, random.Random, str], Ended]] = {
    "cut": cut,
    "flipped": flipped,
    "full": full,
    "read-only": read_only,
    "quota": quota,
    "twice": twice,
    "rewritten": rewritten,
    "clock": clock_jumps,
}
