"""Whole commands in folders that somebody else prepared: what a command must not do there, whatever it is given."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import random
import resource
import shutil
import signal
import stat
import subprocess
import sys
import time
import traceback
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from hostile import folders
from hostile.folders import FOLDERS, INGREDIENTS, Ingredient, Place

Commands = Sequence[tuple[int, tuple[str, ...]]]
COMMANDS: Commands = (
    (2, ("new", "arm", "--urdf", "rod.urdf", "--out", "new", "--seconds", "1")),
    (2, ("new", "eq", "--equations", "--out", "new")),
    (5, ("check", "cart.yaml")),
    (4, ("check", "rod.yaml")),
    (4, ("check", "fmu.yaml")),
    (1, ("run", "cart.yaml", "--dry-run")),
    (6, ("diagnose", "cart.yaml")),
    (3, ("diagnose", "cart.yaml", "run.json", "--log", "a.log")),
    (4, ("certify", "cart.yaml", "--out", "results/cart/certificate")),
    (3, ("export", "whole.npz", "--out", "law.py")),
    (2, ("export", "rod.yaml", "--out", "law.urdf")),
    (3, ("view", "results/cart", "--print")),
    (1, ("view", "diagnosis", "--print")),
)
"""Each with how often it is drawn."""
CPU, WALL = 60, 300  # seconds of a command, with its processes: at work, and of the clock
SAID = 1 << 20  # bytes that a command says at most
MEMORY = 3 << 30  # bytes that one holds at most
LONGEST = 1500  # characters of a line that tells why


@dataclass(frozen=True)
class Tried:
    """A command and its end: what is wrong with it, None where it kept every promise."""

    number: int
    command: tuple[str, ...]
    done: list[str]
    status: int
    seconds: float
    told: str
    wrong: str | None


def warm() -> None:
    """Import what commands import, once, before processes are forked off."""


def one(
    number: int,
    seed: str,
    root: Path,
    kept: Path,
    commands: Commands = COMMANDS,
    ingredients: Sequence[Ingredient] = INGREDIENTS,
) -> Tried:
    """Prepare folder `number`, run a command in it, and judge."""
    rng = random.Random(f"{seed} {number}")
    words = rng.choices([words for _, words in commands], [weight for weight, _ in commands])[0]
    base = root / f"t{number}-{os.getpid()}"  # a run that was killed may have left another
    place = Place(base / rng.choice(FOLDERS), base / "outside", kept)
    folders.whole(place, kept)
    chosen = rng.sample(ingredients, min(len(ingredients), rng.choice((1, 1, 2, 3))))
    for ingredient in [folders.disk] if folders.disk in chosen else chosen:
        ingredient(rng, place)
        place.done.append(ingredient.__name__)
    if place.done == ["named"] and words[:2] == ("diagnose", "cart.yaml"):
        words = words[:2]
    try:
        with _mounted(place, rng):
            before = _tree(place.outside)
            began = time.monotonic()
            status, told = _run(place, words)
            spent = time.monotonic() - began
            wrong = _wrong(place, words, status, told, before)
        return Tried(number, words, place.done, status, round(spent, 2), told[-400:], wrong)
    finally:
        shutil.rmtree(base, ignore_errors=True)


@contextlib.contextmanager
def _mounted(place: Place, rng: random.Random):
    """The folder on a disk of its own that is full or read-only, if it is to be; without the right to mount, not."""
    if not place.mounted or os.getuid():
        yield
        return
    aside = place.here.with_name("aside")
    place.here.rename(aside)
    place.here.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(place.here)], check=True)
    try:
        shutil.copytree(aside, place.here, dirs_exist_ok=True)
        if rng.random() < 0.5:
            with contextlib.suppress(OSError), (place.here / "full").open("wb") as stream:
                while True:
                    stream.write(bytes(4096))
                    stream.flush()
        else:
            subprocess.run(["mount", "-o", "remount,ro", str(place.here)], check=True)
        yield
    finally:
        subprocess.run(["umount", "-l", str(place.here)], check=True)


def _run(place: Place, words: tuple[str, ...]) -> tuple[int, str]:
    """Exit status (a signal as its negative number) and what was said, on both streams."""
    # A pipe: a file would be under the limits of the command. It holds more than any command has to say.
    reader, writer = os.pipe()
    fcntl.fcntl(reader, fcntl.F_SETPIPE_SZ, SAID)
    os.set_blocking(reader, False)
    others = [_forked(place, words, writer) for _ in range(2 if place.twice else 1)]
    os.close(writer)
    ends = []
    for child in others:
        late = time.monotonic() + WALL
        while True:
            done, status, used = os.wait4(child, os.WNOHANG)
            if done:
                break
            if time.monotonic() > late:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(child, signal.SIGKILL)
                done, status, used = os.wait4(child, 0)
                break
            time.sleep(0.02)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        held = used.ru_maxrss * 1024
        ends.append(os.waitstatus_to_exitcode(status) if held < MEMORY else -1000)
    said = b""
    with contextlib.suppress(BlockingIOError):
        while piece := os.read(reader, SAID):
            said += piece
    os.close(reader)
    return min(ends) if min(ends) < 0 else max(ends), said.decode(errors="surrogateescape")


def _forked(place: Place, words: tuple[str, ...], output: int) -> int:
    child = os.fork()
    if child:
        return child
    status = 70
    try:
        os.setsid()
        os.chdir(place.here)
        nowhere = os.open(os.devnull, os.O_RDONLY)
        for old, new in ((nowhere, 0), (output, 1), (output, 2)):
            os.dup2(old, new)
        sys.stdout = open(1, "w", errors="surrogateescape", buffering=1)  # noqa: SIM115
        sys.stderr = open(2, "w", errors="surrogateescape", buffering=1)  # noqa: SIM115
        for key, value in place.environment.items():
            os.environ.pop(key, None) if value is None else os.environ.update({key: value})
        import tempfile

        tempfile.tempdir = None
        resource.setrlimit(resource.RLIMIT_CPU, (CPU, CPU + 5))
        size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        for name, most in place.limits.items():
            most += size if name == "RLIMIT_AS" else 0
            if name == "RLIMIT_FSIZE":
                signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(getattr(resource, name), (most, most))
        for act in place.first:
            act()
        from simgap.cli import main

        main(list(words))
    except SystemExit as ended:
        status = ended.code if isinstance(ended.code, int) else 0 if ended.code is None else 1
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _tree(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}


def _wrong(place: Place, words: tuple[str, ...], status: int, told: str, before: dict[str, str]) -> str | None:
    """The promise that was broken, if one was."""
    lines = told.splitlines()
    if status == -1000:
        return "more memory than a command may hold"
    if status < 0:
        return f"ended by signal {-status}"
    if status not in (0, 1, 2):
        return f"status {status}: {told[-300:]}"
    if "Traceback (most recent call last)" in told:
        return f"a traceback: {told[-600:]}"
    if _tree(place.outside) != before:
        return f"files of somebody else were changed: {sorted(set(_tree(place.outside).items()) ^ set(before.items()))}"
    if (place.outside.parent / "ran").exists() or (place.here / "ran").exists():
        return "code of the folder ran"
    said = [line for line in lines if line.startswith("simgap: ")]
    if status and not said:
        return f"status {status} without a reason: {told[-300:]}"
    if any(len(line) > LONGEST for line in said):
        return "a reason of more characters than anybody reads"
    if any(ord(c) < 32 and c not in "\n\r\t" for c in told):
        return f"characters that steer a terminal: {told[-200:]!r}"
    left = [p for p in _entries(place.here) if p.name.startswith(".") and f"-{os.getpid()}-" in p.name]
    if left:
        return f"half-written files are left: {left[:3]}"
    if status == 2 and words[0] == "diagnose" and (place.here / "diagnosis/diagnosis.json").is_file():
        return "a refused diagnosis has left a result"
    return None


def _entries(folder: Path) -> list[Path]:
    found = []
    for above, _, files in os.walk(folder):
        found += [Path(above, name) for name in files]
    return [path for path in found if stat.S_ISREG(path.lstat().st_mode)]


def plain(tried: Tried) -> dict[str, object]:
    """As it is kept."""
    return asdict(tried)
