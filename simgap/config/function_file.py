"""A person's Python files beside the case: a function (`my_sim.py:step`) is found and hashed here, never run here.

Nothing of the file is executed: that it holds the function, and which neighbours it imports or names, is read from its
syntax tree. The neighbours count as part of it, so that editing one makes again what the function made.

Where a case is written again elsewhere, its plug-in files are copied there, under names that hold their content.
"""

from __future__ import annotations

import ast
import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simgap import reading
from simgap.config.case import Case
from simgap.config.plugged import used_plugins
from simgap.errors import UserError, excerpt

KEY = "simulator.function"
MOST_NAME = 256
"""Characters of a text that may name a file."""


@dataclass(frozen=True)
class FunctionFile:
    """Place of a function: its file and its name there."""

    path: Path
    name: str

    @staticmethod
    def find(named: str, folder: Path) -> FunctionFile:
        """The function that `file.py:name` means for a case in `folder`.

        Raises:
            UserError: another form of name, a file that is missing, broken or outside the folder, or that does not
                hold the function.
        """
        file, _, name = named.rpartition(":")
        if not file.endswith(".py") or not name.isidentifier():
            raise UserError(
                f"'{excerpt(named)}' does not name a function",
                key=KEY,
                remedy="Write file.py:name, such as my_sim.py:step.",
            )
        path = reading.real(folder / file)
        if not path.is_relative_to(reading.real(folder)):
            raise UserError(f"'{excerpt(file)}' lies outside the case's folder", key=KEY, remedy="Put it beside it.")
        if not reading.is_file(path):
            raise UserError(
                "the file of the function does not exist", file=path, key=KEY, remedy="Put it beside the case."
            )
        if name not in _defined(path):
            defined = ", ".join(sorted(n for n in _defined(path) if not n.startswith("_"))) or "nothing"
            raise UserError(
                f"the file has no function '{excerpt(name)}'", file=path, key=KEY,
                remedy=f"Check its spelling; it has {excerpt(defined)}.",
            )  # fmt: skip
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
