"""Records that write themselves as plain data and read themselves back, by the types of their fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from types import NoneType, UnionType
from typing import Any, ClassVar, Self, get_args, get_origin, get_type_hints

import numpy as np


class JsonRecord:
    """A dataclass with `to_json` and `from_json`; class keywords are constants, such as `kind`, that it writes first.

    Fields are numbers, text, arrays, records, or tuples, mappings and optional values of these. `names` gives the keys
    of fields that are called otherwise in the file; one of `repr=False` has a default and is not written.
    """

    _first: ClassVar[Mapping[str, str]] = {}
    _names: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls, names: Mapping[str, str] | None = None, **first: str) -> None:
        super().__init_subclass__()
        cls._first, cls._names = first, names or {}

    def to_json(self) -> dict[str, Any]:
        """Plain data: the constants, then the fields in their order."""
        return {**self._first, **{key: _plain(getattr(self, name)) for name, key in self._keys().items()}}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """The inverse of `to_json`; KeyError, TypeError or ValueError for anything else."""
        hints = get_type_hints(cls)
        return cls(**{name: _read(hints[name], data[key]) for name, key in cls._keys().items()})

    @classmethod
    def _keys(cls) -> dict[str, str]:
        return {f.name: cls._names.get(f.name, f.name) for f in fields(cls) if f.repr}  # type: ignore[arg-type]


def _plain(value: Any) -> Any:
    if hasattr(value, "to_json"):
        return value.to_json()
    if isinstance(value, Mapping):
        return {name: _plain(own) for name, own in value.items()}
    if isinstance(value, tuple):
        return [_plain(own) for own in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def _read(kind: Any, value: Any) -> Any:
    origin, inner = get_origin(kind), get_args(kind)
    if origin is UnionType:
        (known,) = (k for k in inner if k is not NoneType)
        return None if value is None else _read(known, value)
    if origin is np.ndarray:
        return np.array(value, dtype=get_args(inner[1])[0])
    if origin is tuple:
        return tuple(_read(inner[0], own) for own in value)
    if origin is not None:
        return {name: _read(inner[1], own) for name, own in value.items()}
    return kind.from_json(value) if hasattr(kind, "from_json") else kind(value)
