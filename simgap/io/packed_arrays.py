"""Named arrays in a compressed .npz: equal bytes for equal arrays, and a checksum for each, to read some alone."""

from __future__ import annotations

import hashlib
import math
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.errors import UserError

Arrays = Mapping[str, NDArray[Any]]
_EPOCH = (1980, 1, 1, 0, 0, 0)
_PIECE = 2**20  # bytes unpacked at a time


def pack(path: Path, arrays: Arrays) -> None:
    """Write arrays in their order."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry._compresslevel = 1  # type: ignore[attr-defined]  # zipfile has no other way for an open entry
            with archive.open(entry, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)


def unpacked(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """One array of the file, a piece at a time into its place.

    Raises:
        UserError: a header that says something else than how many bytes there are. Damage raises what zipfile raises.
    """
    entry = archive.getinfo(f"{name}.npy")
    with archive.open(entry) as stream:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise UserError("it is of another version of numpy's format")
        shape, columns_first, kind = np.lib.format.read_array_header_1_0(stream)
        if kind.hasobject or columns_first:
            raise UserError("its arrays are laid out in another way")
        size = math.prod(shape) * kind.itemsize
        if stream.tell() + size != entry.file_size:
            raise UserError("an array has another size than it says")
        array = np.empty(shape, kind)
        place, done = array.reshape(-1).view(np.uint8).data, 0
        while piece := stream.read(_PIECE):  # to the end, where the archive's own checksum is compared
            place[done : done + len(piece)] = piece
            done += len(piece)
    return array


def checksum(arrays: Arrays) -> NDArray[np.uint8]:
    """A row for each array in the order of their names: of name, type, shape, bytes; so some can be read alone."""
    return np.stack([np.frombuffer(_hashed(arrays, [name]), np.uint8) for name in sorted(arrays)])


def fits(stated: NDArray[np.uint8], arrays: Arrays, names: Sequence[str]) -> bool:
    """Whether the checksum is that of the arrays that were read, of those `names` that the file has."""
    if stated.ndim == 1:
        return np.array_equal(stated, np.frombuffer(_hashed(arrays, sorted(arrays)), np.uint8))
    rows = [names.index(name) for name in sorted(arrays)]
    return len(stated) == len(names) and np.array_equal(stated[rows], checksum(arrays))


def _hashed(arrays: Arrays, names: Sequence[str]) -> bytes:
    found = hashlib.sha256()
    for name in names:
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape};".encode())
        found.update(array.reshape(-1).view(np.uint8).data)
    return found.digest()
