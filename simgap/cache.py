"""Folders in which simgap keeps what can be made again at any time."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

PACKAGE = Path(__file__).parent


def cache_folder() -> Path | None:
    """`$XDG_CACHE_HOME/simgap`, else `~/.cache/simgap`; None without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "simgap"
    except RuntimeError:
        return None


@contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """A file to be written that appears under its name when it is whole."""
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", delete=False) as temporary:
        try:
            yield temporary
            temporary.flush()
            os.replace(temporary.name, path)
        except BaseException:
            os.unlink(temporary.name)
            raise


def recall(kind: str, question: str) -> Any:
    """What `remember` kept of this question; None if it is not there, damaged or from another hand."""
    from simgap import reading  # not before `keep_bytecode` has been called

    try:
        check, body = reading.read_text(_place(kind, question)).split("\n", 1)
        return json.loads(body) if check == _digest(body) else None
    except (OSError, ValueError, RecursionError):
        return None


def remember(kind: str, question: str, content: Any) -> None:
    """Keep plain data in the cache folder, whole or not at all; without a place to write, nothing is kept."""
    body = json.dumps(content)
    with suppress(OSError):
        path = _place(kind, question)
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with whole_file(path) as file:
            file.write(f"{_digest(body)}\n{body}".encode())


def _place(kind: str, question: str) -> Path:
    home = cache_folder()
    if home is None:
        raise FileNotFoundError("no home")
    return home / kind / f"{_digest(question)[:32]}.json"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def sources(root: Path = PACKAGE) -> dict[Path, tuple[str, bool]]:
    """SHA-256 of every source of the package, and whether there are compiled kernels in it; read once a process."""
    texts = {path: path.read_bytes() for path in sorted(root.rglob("*.py"))}
    return {path: (hashlib.sha256(text).hexdigest(), b"jit" in text) for path, text in texts.items()}


@cache
def kernel_sources(root: Path = PACKAGE) -> str:
    """Digest of every source of the package with compiled kernels in it."""
    kernels = "".join(found for found, compiled in sources(root).values() if compiled)
    return hashlib.sha256(kernels.encode()).hexdigest()[:16]


def machine_code() -> Path | None:
    """Folder in which numba keeps the machine code of this very package's kernels; None without a home.

    numba asks whether a function's own file has changed, and not those of what it calls: kept beside the sources, a
    kernel would go on with the old code of another file.
    """
    given, home = os.environ.get("NUMBA_CACHE_DIR"), cache_folder()
    folder = Path(given) if given else home / "machine_code" if home else None
    own = kernel_sources()
    return folder if folder is None or folder.name == own else folder / own  # a parent process may have seen to it


def keep_machine_code_by_sources() -> None:
    """Let numba keep it there, before any kernel is made."""
    folder = machine_code()
    if folder is None:
        return
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)


def keep_bytecode() -> None:
    """Write byte code to the cache folder, in this process and its children, if it may not stand beside the sources."""
    folder = cache_folder()
    if sys.dont_write_bytecode and sys.pycache_prefix is None and folder is not None:
        place = str(folder / "bytecode")
        sys.dont_write_bytecode, sys.pycache_prefix = False, place
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = place
