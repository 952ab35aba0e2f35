"""A checksum over every byte of a Parquet file, kept in the file's own metadata, so that other readers still read it.

The footer of the file has the key `simgap.sha256` with 64 hexadecimal digits: the SHA-256 of the whole file with these
digits taken as zeros. Page checksums would leave the footer open (schema, offsets, statistics, provenance).
"""

from __future__ import annotations

import hashlib
import re

KEY = b"simgap.sha256"
ZEROS = b"0" * 64
_PLACE = re.compile(re.escape(KEY) + rb".{2}([0-9a-f]{64})", re.DOTALL)  # two bytes of Thrift: field and length
_FOOTER_END = 8  # four bytes with the length of the footer, then PAR1


def stated(data: bytes) -> tuple[int, str] | None:
    """Where the checksum stands in the bytes of a file, and what it says; None for a file that carries none."""
    if len(data) < _FOOTER_END:
        return None
    footer = int.from_bytes(data[-_FOOTER_END:-4], "little")
    found = list(_PLACE.finditer(data, max(0, len(data) - _FOOTER_END - footer)))
    return (found[-1].start(1), found[-1].group(1).decode()) if found else None


def computed(data: bytes, place: int) -> str:
    """The checksum of a file whose digits stand at `place`."""
    view = memoryview(data)
    found = hashlib.sha256(view[:place])
    found.update(ZEROS)
    found.update(view[place + len(ZEROS) :])
    return found.hexdigest()


def holds(data: bytes) -> bool | None:
    """Whether the bytes of a file are those that were written; None if the file carries no checksum."""
    found = stated(data)
    return None if found is None else computed(data, found[0]) == found[1]
