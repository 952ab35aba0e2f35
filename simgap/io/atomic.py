"""Files appear whole or not at all; what a killed process left half-written is removed by the next writer.

Results carry a checksum: 64 hexadecimal digits in the file itself, the SHA-256 of all its bytes with these digits as
zeros. They stand where other programs still read the file: in the last key of JSON, in the metadata of Parquet, in the
comment of a zip archive.

Nothing is written through a link: a folder may come from a stranger, and its links lead to files of others.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import platform
import re
import signal
import stat
import tempfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from simgap import reading
from simgap.errors import UserError

KILL_AT = "SIMGAP_KILL_AT"
"""Environment variable, for tests alone: the number of the place in a write at which the process group is killed."""
_REMOVE = "Remove it, or name the place that it leads to."
_NO_FOLDER = "is not a folder, but results go below it"
_passed = itertools.count(1)
_SEAL = b"sha256:"
_ZEROS = "0" * 64
SEAL = _SEAL.decode() + _ZEROS
"""Text that a writer leaves in a file for its checksum."""


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """A temporary neighbour of `path` that takes its place when the block ends well, and vanishes otherwise.

    Its bytes are on the disk before it takes the name: a machine that dies leaves the old file or the new one.
    """
    not_linked(path).parent.mkdir(parents=True, exist_ok=True)
    _remove_abandoned(path)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.{host()}-{os.getpid()}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        _may_be_killed()
        yield temporary
        _may_be_killed(half=temporary)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        with temporary.open("rb") as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
        _may_be_killed()
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def sealed(path: Path) -> Iterator[Path]:
    """A temporary neighbour, as `atomic`; the last `SEAL` in it becomes its checksum when the block ends."""
    with atomic(path) as temporary:
        yield temporary
        data = reading.read_bytes(temporary)
        place = data.rindex(SEAL.encode()) + len(_SEAL)
        with temporary.open("r+b") as stream:
            stream.seek(place)
            stream.write(_checksum(data, place))


def seal_holds(data: bytes) -> bool | None:
    """True if the bytes of a file are those that were written, by their checksum; None if they carry none."""
    place = data.rfind(_SEAL) + len(_SEAL)
    stated = data[place : place + len(_ZEROS)]
    if place < len(_SEAL) or not re.fullmatch(rb"[0-9a-f]{64}", stated):
        return None
    return stated == _checksum(data, place)


def _checksum(data: bytes, place: int) -> bytes:
    view = memoryview(data)
    found = hashlib.sha256(view[:place])
    found.update(_ZEROS.encode())
    found.update(view[place + len(_ZEROS) :])
    return found.hexdigest().encode()


def not_linked(path: Path) -> Path:
    """The path, if neither it nor a folder on the way to it is a link; of an absolute one, what lies below this folder.

    Raises:
        UserError: a link, or a file where a folder has to be.
    """
    own = Path(os.path.relpath(path)) if path.is_absolute() and path.is_relative_to(Path.cwd()) else path
    for place in (own, *(() if own.is_absolute() else own.parents)):
        if place.is_symlink():
            raise UserError("is a link, and nothing is written through one", file=place, remedy=_REMOVE)
        if place is not own and os.path.lexists(place) and not place.is_dir():
            raise UserError(_NO_FOLDER, file=place, remedy=_REMOVE)
    return path


def no_links_below(folder: Path, but: Collection[str] = ()) -> None:
    """Refuse a folder to which another program is to write where one of its entries leads to what lies elsewhere.

    Args:
        folder: may be missing; but: names of folders in it that are not looked at.

    Raises:
        UserError: a link, a benchmark that has a second name, or what is neither a file nor a folder.
    """
    if os.path.lexists(not_linked(folder)) and not folder.is_dir():
        raise UserError(_NO_FOLDER, file=folder, remedy=_REMOVE)
    for above, folders, files in os.walk(folder):
        if Path(above) == folder:
            folders[:] = [name for name in folders if name not in but]
        for place in (Path(above, name) for name in (*folders, *files)):
            about = not_linked(place).lstat()
            twice = about.st_nlink > 1 and place.suffix == ".tsv"  # Snakemake opens them where they stand
            if twice or not stat.S_ISREG(about.st_mode) | stat.S_ISDIR(about.st_mode):
                problem = "is one file under two names" if twice else "is neither a file nor a folder"
                raise UserError(f"{problem}, and results go there", file=place, remedy=_REMOVE)


def new_log(path: Path) -> None:
    """An empty file, in the place of one that is there; a device, such as /dev/null, stays.

    Raises:
        UserError: as `not_linked`, and a pipe.
    """
    not_linked(path).parent.mkdir(parents=True, exist_ok=True)
    if not path.is_char_device():
        if reading.is_file(path):
            path.unlink()
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))


def _may_be_killed(half: Path | None = None) -> None:
    """A place where tests cut a write: before it, half of it done, or just after it."""
    wanted = os.environ.get(KILL_AT)
    if wanted is not None and int(wanted) == next(_passed):
        if half is not None:
            os.truncate(half, half.stat().st_size // 2)
        os.killpg(os.getpgrp(), signal.SIGKILL)


def host() -> str:
    """Eight digits for this machine: process numbers of another one, on a shared disk, say nothing here."""
    return f"{zlib.crc32(platform.node().encode()):08x}"


def _remove_abandoned(path: Path) -> None:
    """Remove temporary neighbours of `path` whose process on this machine is gone."""
    own = re.compile(rf"\.{re.escape(path.stem)}\.{host()}-(\d+)-[^.]*{re.escape(path.suffix)}")
    for entry in os.scandir(path.parent):
        found = own.fullmatch(entry.name)
        if found is not None and not _alive(int(found.group(1))):
            with suppress(OSError):  # another writer was faster, or may and this one may not
                os.unlink(entry)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (OSError, OverflowError) as error:
        return not isinstance(error, ProcessLookupError)
    return True


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically."""
    with atomic(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically; bytes of a file's name that are no UTF-8 become `\\udcff`, as JSON has them."""
    write_bytes(path, text.encode(errors="backslashreplace"))
