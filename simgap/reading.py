"""The one door through which files are opened to be read: what is opened is a regular file, and its size is known.

A folder may come from a stranger: a case may be a link to a device that never ends or to itself, a pipe that nobody
writes to, a file larger than memory. Nothing else in the package opens a file (`tests/test_reading_files.py` looks).
"""

from __future__ import annotations

import errno
import hashlib
import io
import itertools
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO
from xml.etree import ElementTree
from xml.parsers import expat

from simgap.errors import UserError, excerpt, placed

MOST = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4
"""Most bytes of a file that is held whole, or unpacked: a quarter of the machine's memory, for readers hold it up to
three times (measured for controllers: 3.9 times, their own bytes included)."""
MOST_LINE = 1_000_000
"""Characters of a line of a table."""
MOST_XML = 20_000_000
"""Bytes of an XML file: engines take seconds for one of this size, and half a minute for three times as much."""
DEEPEST_XML = 200
"""Elements within each other; libraries walk them by recursion."""
_NO_FILE = {errno.ENOENT, errno.ENOTDIR}
_KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


class NotXml(UserError):
    """A file that no parser takes for XML."""


def is_file(path: Path) -> bool:
    """True if a regular file is there, or a link that leads to one.

    Raises:
        UserError: what is neither a file nor a folder, or links in a circle.
    """
    try:
        return _regular(path)
    except OSError as error:
        if error.errno in _NO_FILE:
            return False
        raise
    except ValueError:  # a name that no file can have
        return False


def checked(path: Path, most: int | None = None) -> Path:
    """The path, for a library that opens it by itself.

    Raises:
        UserError: as `opened`. OSError: a file that is missing or may not be read.
    """
    opened(path, most).close()
    return path


def opened(path: Path, most: int | None = None) -> io.BufferedReader | io.BytesIO:
    """A regular file, opened for reading as bytes.

    Raises:
        UserError: no regular file, links in a circle, or more than `most` bytes.
        OSError: a file that is missing or may not be read, or a folder.
    """
    if not _regular(path):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    # Whatever it has been made in the meantime, opening it does not wait.
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        about = os.fstat(descriptor)
        _check_kind(about.st_mode, path)
        if most is not None and about.st_size > most:
            raise UserError(f"has {about.st_size} bytes; the most are {most}", file=path, remedy="Give a smaller file.")
    except BaseException:
        os.close(descriptor)
        raise
    if about.st_size == 0:  # files of the system that have no size may never end
        os.close(descriptor)
        return io.BytesIO()
    return os.fdopen(descriptor, "rb")


def opened_text(path: Path, encoding: str = "utf-8", errors: str = "strict", newline: str | None = None) -> TextIO:
    """A regular file, opened for reading as text. Raises as `opened`."""
    return io.TextIOWrapper(opened(path), encoding, errors, newline)


def lines(path: Path, most: int = MOST_LINE, errors: str = "strict") -> Iterator[str]:
    """The lines of a UTF-8 text, of which one is held at a time.

    Raises:
        UserError: as `opened`, and a line of more than `most` characters, without file.
    """
    with opened_text(path, "utf-8-sig", errors) as stream:
        for number in itertools.count(1):
            line = stream.readline(most + 1)
            if len(line) > most:
                raise UserError(f"has a line of more than {most} characters", key=f"line {number}")
            if not line:
                return
            yield line


def read_bytes(path: Path, most: int = MOST) -> bytes:
    """All of a file, no more than it had when it was opened. Raises as `opened`."""
    with opened(path, most) as stream:
        return stream.read(most)


def read_text(path: Path, most: int = MOST, errors: str = "strict") -> str:
    """All of a UTF-8 text. Raises as `opened`, and UnicodeDecodeError."""
    return read_bytes(path, most).decode("utf-8", errors)


def sha256(path: Path) -> str:
    """Hash of a file's bytes, of which few are held at a time. Raises as `opened`."""
    with opened(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_xml(path: Path) -> ElementTree.Element:
    """The root of an XML file without a document type: entities multiply, and no model file needs them.

    Raises:
        UserError: as `opened`, and a file that is no XML, has a document type, or is nested too deeply.
        OSError: as `opened`.
    """
    return xml_of(read_bytes(path, MOST_XML), path)


def xml_of(data: bytes, path: Path) -> ElementTree.Element:
    """The root of XML that is at hand as bytes, as `read_xml`. Raises UserError, which names `path`."""
    try:
        with placed(file=path):
            root = _tree(data)
    except (expat.ExpatError, LookupError, ValueError) as error:  # the others: unknown encodings
        raise NotXml(f"not well-formed XML: {excerpt(error)}", file=path) from None
    level, depth = [root], 0
    while level := [child for element in level for child in element]:
        depth += 1
        if depth > DEEPEST_XML:
            raise UserError(f"has more than {DEEPEST_XML} elements within each other", file=path)
    return root


def _tree(data: bytes) -> ElementTree.Element:
    """The root as engines read it: a prefix is part of a name, declared or not; blanks before, zeros behind are cut."""
    built, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = built.start, built.end
    parser.CharacterDataHandler = built.data
    parser.StartDoctypeDeclHandler = _refuse_document_type
    parser.Parse(data.strip(b"\0\t\n\r ") if data[:1] in b"\t\n\r <" and data[1:2] != b"\0" else data, True)
    return built.close()


def _refuse_document_type(*_: object) -> None:
    raise UserError("has a document type (<!DOCTYPE>), which is not read", remedy="Take it out.")


def real(path: Path) -> Path:
    """The path without links; with those that lead in a circle, of which opening it tells."""
    return Path(os.path.realpath(path))


def relative(path: Path, folder: Path) -> str:
    """The path from a folder, without links: how files and results name it, the same on every machine."""
    return Path(os.path.relpath(real(path), real(folder))).as_posix()


def _regular(path: Path) -> bool:
    """False for a folder."""
    try:
        mode = os.stat(path).st_mode
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise UserError("links that lead in a circle", file=path, remedy="Remove them.") from None
        raise
    if stat.S_ISDIR(mode):
        return False
    _check_kind(mode, path)
    return True


def _check_kind(mode: int, path: Path) -> None:
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "something else")
        raise UserError(f"is {kind}, not a file", file=path, remedy="Give a regular file.")


JSON_HELD = 30  # bytes in memory for one of the text: lists of the shortest objects take 20 to 30


class TooLarge(UserError):
    """A file that does not fit into memory; the name is for those who know a better remedy."""


_CELL = 8  # bytes of a number


def table_size(metadata: Any, columns: int) -> int:
    """Bytes that so many columns of numbers of a Parquet file take as arrays: its pages may repeat one value.

    Rows are counted by groups. What the file says of single columns is not asked for: where that is damaged, pyarrow
    ends the process.
    """
    return sum(metadata.row_group(g).num_rows for g in range(metadata.num_row_groups)) * columns * _CELL


def require_room(size: int) -> None:
    """Refuse what is too large.

    Raises:
        TooLarge: without file.
    """
    if size > MOST:
        raise TooLarge(
            f"holds {size / 1e9:.3g} GB unpacked, more than a quarter of this machine's memory",
            remedy="Use a machine with more memory, or less data in a file.",
        )
