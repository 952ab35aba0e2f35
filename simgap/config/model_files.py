"""Which keys of a case name model files: their bytes are part of what made a result, their paths move along."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

KEYS = ("urdf", "mjcf", "fmu")
"""Keys of `plant`, of `simulator` and of the engine that it is a twin of."""


def named_files(section: Any) -> Iterator[tuple[str, str]]:
    """Key and relative path of the model files that a section names, those of `twin.of` included."""
    if not isinstance(section, Mapping):
        return
    for key in KEYS:
        if isinstance(section.get(key), str):
            yield key, section[key]
    if isinstance(section.get("of"), Mapping):
        yield from ((f"of.{key}", path) for key, path in named_files(section["of"]))


def named_by(urdf: Path) -> Iterator[tuple[str, Path]]:
    """Files that a URDF names in turn, such as meshes, as far as they are there: how it names them, and where they lie.

    `package://` means the folder above that of the URDF. What is no XML names none; whoever loads it says why.
    """
    try:
        elements = ElementTree.parse(urdf).iter()
    except ElementTree.ParseError:
        return
    for name in dict.fromkeys(e.get("filename") for e in elements):
        scheme, _, rest = (name or "").rpartition("://")
        base, own = (urdf.parent.parent, rest.partition("/")[2]) if scheme == "package" else (urdf.parent, rest)
        if name and own and (base / own).is_file():
            yield name, base / own


def move_files(content: dict[str, Any], moved: Callable[[str], str]) -> None:
    """Rewrite in a case's content the relative paths of its model files."""
    twin = content.get("twin")
    for section in (content.get("plant"), content.get("simulator"), twin.get("of") if isinstance(twin, dict) else None):
        for key, path in list(named_files(section)):
            assert isinstance(section, dict)
            if not key.startswith("of."):
                section[key] = moved(path)
