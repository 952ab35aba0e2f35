"""Keys of a case that name model files: their bytes are part of what made a result, their paths move along."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from simgap import reading

KEYS = ("urdf", "mjcf", "fmu")
"""Keys of `plant`, of `simulator` and of the engine that it is a twin of."""

ABOVE = 5
"""Folders in which PyBullet looks for a package, the model's own among them."""


def named_files(section: Any) -> Iterator[tuple[str, str]]:
    """Key and relative path of the model files that a section names, those of `twin.of` included."""
    if not isinstance(section, Mapping):
        return
    for key in KEYS:
        if isinstance(section.get(key), str):
            yield key, section[key]
    if isinstance(section.get("of"), Mapping):
        yield from ((f"of.{key}", path) for key, path in named_files(section["of"]))


def named_by(model: Path) -> Iterator[tuple[str, Path]]:
    """Files that a model file names in turn, such as meshes, as far as they are there: how it does, and where they lie.

    A URDF's files lie at `places_of`. An MJCF file is read with all that it includes; its files are told by their
    place beside it.
    What is no XML names none; whoever loads it says why.

    Raises:
        UserError: a file that `reading` does not open.
    """
    root = _root(model)
    if root is None:
        return
    if root.tag == "mujoco":
        yield from _named_by_mjcf(model, root)
        return
    for name in dict.fromkeys(e.get("filename") for e in root.iter()):
        for k, place in enumerate(found for found in places_of(model, name or "") if reading.is_file(found)):
            yield f"{name}{f' ({k})' if k else ''}", place


def places_of(model: Path, name: str) -> list[Path]:
    """Places of a file that a URDF names, the likeliest first; none for an empty name.

    `package://` means the folder above the model's own, or as PyBullet looks for it a folder of the package's name
    beside or above.
    """
    scheme, _, rest = name.rpartition("://")
    if scheme != "package":
        return [model.parent / rest] if rest else []
    own = Path(os.path.abspath(model))
    return [own.parent.parent / rest.partition("/")[2], *(folder / rest for folder in own.parents[:ABOVE])]


def _root(path: Path) -> ElementTree.Element | None:
    try:
        return reading.read_xml(path)
    except reading.NotXml:
        return None


def _named_by_mjcf(model: Path, root: ElementTree.Element) -> Iterator[tuple[str, Path]]:
    """Included files and those of assets, wherever MuJoCo may look for them.

    That is beside the file that names them, beside the model, and in the folders of <compiler>; with `strippath` there
    by the last part of the name alone.
    """
    folders, waiting, seen = [model.parent], [(model, root)], {reading.real(model)}
    read: list[ElementTree.Element] = []
    while waiting:
        path, own = waiting.pop()
        read.append(own)
        folders += [path.parent] if path.parent not in folders else []
        for element in own.iter():
            if element.tag not in ("include", "model"):
                continue
            for place in (base / str(element.get("file")) for base in (model.parent, path.parent)):
                if reading.is_file(place) and reading.real(place) not in seen:
                    seen.add(reading.real(place))
                    yield os.path.relpath(place, model.parent), place
                    found = _root(place)
                    waiting += [] if found is None else [(place, found)]
    compilers = [c for own in read for c in own.iter("compiler")]
    given = {str(c.get(k)) for c in compilers for k in ("meshdir", "texturedir", "assetdir") if c.get(k)}
    folders += [base / name for name in sorted(given) for base in tuple(folders)]
    for name in dict.fromkeys(v for own in read for e in own.iter() for k, v in e.items() if k.startswith("file")):
        for place in dict.fromkeys(base / part for base in folders for part in (name, Path(name).name)):
            if reading.is_file(place) and reading.real(place) not in seen:
                seen.add(reading.real(place))
                yield os.path.relpath(place, model.parent), place


def move_files(content: dict[str, Any], moved: Callable[[str], str]) -> None:
    """Rewrite in a case's content the relative paths of its model files."""
    twin = content.get("twin")
    for section in (content.get("plant"), content.get("simulator"), twin.get("of") if isinstance(twin, dict) else None):
        for key, path in list(named_files(section)):
            assert isinstance(section, dict)
            if not key.startswith("of."):
                section[key] = moved(path)
