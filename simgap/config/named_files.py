"""Files that a case names: model files, and Python files of functions and plug-ins beside it.

Their bytes are part of what made a result. Where a case is written again elsewhere, paths of model files move along,
and plug-in files are copied there, under names that hold their content.

Nothing of a Python file (`my_sim.py:step`) is executed here: that it holds the function, and which neighbours it
imports or names, is read from its syntax tree. The neighbours count as part of it, so that editing one makes again what
the function made.
"""

from __future__ import annotations

import ast
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from simgap import reading
from simgap.config.case import Case
from simgap.config.plugged import used_plugins
from simgap.errors import UserError, excerpt, placed

KEYS = ("urdf", "mjcf", "fmu")
"""Keys of `plant`, of `simulator` and of the engine that it is a twin of."""

ABOVE = 5
"""Folders in which PyBullet looks for a package, the model's own among them."""


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
        for key in KEYS:
            if isinstance(section, dict) and isinstance(section.get(key), str):
                section[key] = moved(section[key])


KEY = "simulator.function"
MOST_NAME = 256
"""Characters of a text that may name a file."""


@dataclass(frozen=True)
class FunctionFile:
    """Place of a function: its file and its name there."""

    path: Path
    name: str

    @staticmethod
    def find(named: str, folder: Path, key: str = KEY) -> FunctionFile:
        """The function that `file.py:name` means for a case in `folder`; `key` is where it is named.

        Raises:
            UserError: another form of name, a file that is missing, broken or outside the folder, or that does not
                hold the function.
        """
        with placed(key=key):
            file, _, name = named.rpartition(":")
            if not file.endswith(".py") or not name.isidentifier():
                remedy = "Write file.py:name, such as my_sim.py:step."
                raise UserError(f"'{excerpt(named)}' does not name a function", remedy=remedy)
            path = reading.real(folder / file)
            if not path.is_relative_to(reading.real(folder)):
                raise UserError(f"'{excerpt(file)}' lies outside the case's folder", remedy="Put it beside it.")
            if not reading.is_file(path):
                raise UserError("the file of the function does not exist", file=path, remedy="Put it beside the case.")
            if name not in (defined := _defined(path)):
                listed = ", ".join(sorted(n for n in defined if not n.startswith("_"))) or "nothing"
                remedy = f"Check its spelling; it has {excerpt(listed)}."
                raise UserError(f"the file has no function '{excerpt(name)}'", file=path, remedy=remedy)
            return FunctionFile(path, name)

    def digests(self) -> dict[str, str]:
        """A short hash of the file and of each neighbour, by its place beside it."""
        found = (self.path, *self.neighbours)
        return {path.relative_to(self.path.parent).as_posix(): reading.sha256(path)[:16] for path in found}

    @property
    def neighbours(self) -> tuple[Path, ...]:
        """Files of the same folder that it imports or names, however indirectly."""
        found, waiting = {self.path}, [self.path]
        while waiting:
            path = waiting.pop()
            new = {*_needed(path, self.path.parent)} - found if path.suffix == ".py" else set()
            found |= new
            waiting += new
        return tuple(sorted(found - {self.path}))


def _needed(path: Path, folder: Path) -> Iterator[Path]:
    """Files in `folder` that a file of it imports, as Python would find them there, or names in a text.

    A folder without an `__init__.py` is a package as well. Which of its modules are used is not looked for.
    """
    for node in ast.walk(_tree(path)):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        tops = [name.partition(".")[0] for name in names]
        found = [place for top in tops for place in (*folder.glob(f"{top}.*"), *(folder / top).rglob("*.py"))]
        text = node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""
        if len(text) < MOST_NAME and not Path(text).is_absolute():
            found.append(Path(os.path.normpath(folder / text)))
        code = (".py", ".so", ".pyd") if tops else (Path(text).suffix,)
        yield from (p for p in found if p.suffix in code and p.is_relative_to(folder) and reading.is_file(p))


def _defined(path: Path) -> set[str]:
    """Names that the file defines, assigns or imports at its top."""
    found: set[str] = set()
    for node in _tree(path).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign):
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {a.asname or a.name for a in node.names}
    return found


def _tree(path: Path) -> ast.Module:
    try:
        return ast.parse(reading.read_bytes(path), filename=path.name)
    except (SyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None)
        raise UserError(
            f"the file is not valid Python: {error.args[0] if error.args else error}"
            + (f" (line {line})" if line is not None else ""),
            file=path,
        ) from None


@dataclass(frozen=True)
class CopiedPlugin:
    """A plug-in file under its new name, and the key of the case that names it."""

    section: tuple[str, ...]
    key: str
    named: str
    file: str
    content: bytes

    @staticmethod
    def of(path: Path, section: tuple[str, ...], key: str, attribute: str) -> CopiedPlugin:
        """The file under a name that holds its content: it overwrites no other, and an edited one gets another name."""
        content = reading.read_bytes(path)
        new = f"{path.stem}-{hashlib.sha256(content).hexdigest()[:12]}.py"
        return CopiedPlugin(section, key, f"{new}:{attribute}", new, content)


def plugin_copies(case: Case, source: Path, folder: Path) -> tuple[CopiedPlugin, ...]:
    """Files that have to stand in `folder` so that a copy of the case in `source` finds its plug-ins there.

    A plug-in file may only stand beside the case that names it, so its path cannot be rewritten.
    """
    if reading.real(source) == reading.real(folder):
        return ()
    copies = []
    for plugin in used_plugins(case):
        file, _, attribute = plugin.name.rpartition(":")
        if file.endswith(".py"):
            copies.append(CopiedPlugin.of(source / file, tuple(plugin.place.split(".")), plugin.tag, attribute))
    return (*copies, *_function(case, source))


def _function(case: Case, source: Path) -> tuple[CopiedPlugin, ...]:
    """The file of a simulator that is a Python function, under a name of its own.

    Raises:
        UserError: a file that needs others beside it: their names cannot be changed.
    """
    if case.simulator is None or case.simulator.engine != "python":
        return ()
    found = FunctionFile.find(getattr(case.simulator, "function", ""), source)
    if found.neighbours:
        raise UserError(
            f"the simulator's file needs {', '.join(p.name for p in found.neighbours)}, which would be missing "
            "beside a corrected case", file=found.path, key=KEY, remedy="Put what it needs into the one file.",
        )  # fmt: skip
    return (CopiedPlugin.of(found.path, ("simulator",), "function", found.name),)


def with_plugin_copies(content: Mapping[str, Any], copies: tuple[CopiedPlugin, ...]) -> dict[str, Any]:
    """The plain content of a case with the new names."""
    new: dict[str, Any] = dict(content)
    for copy in copies:
        inner = new
        for part in copy.section:
            inner[part] = dict(inner[part])
            inner = inner[part]
        inner[copy.key] = copy.named
    return new
