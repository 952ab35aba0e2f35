"""Plug-in files of a case that is written again elsewhere: copied there, under names that hold their content."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simgap import reading
from simgap.config.case import Case
from simgap.config.function_file import KEY, FunctionFile
from simgap.config.plugged import used_plugins
from simgap.errors import UserError


@dataclass(frozen=True)
class CopiedPlugin:
    """A plug-in file under its new name, and the key of the case that names it."""

    section: tuple[str, ...]
    key: str
    named: str
    file: str
    content: bytes


def plugin_copies(case: Case, source: Path, folder: Path) -> tuple[CopiedPlugin, ...]:
    """Files that have to stand in `folder` so that a copy of the case in `source` finds its plug-ins there.

    A plug-in file may only stand beside the case that names it, so its path cannot be rewritten. The new name holds a
    hash of the content: it overwrites no other file, and an edited plug-in gets another name.
    """
    if reading.real(source) == reading.real(folder):
        return ()
    copies = []
    for plugin in used_plugins(case):
        file, _, attribute = plugin.name.rpartition(":")
        if file.endswith(".py"):
            content = reading.read_bytes(source / file)
            new = f"{Path(file).stem}-{hashlib.sha256(content).hexdigest()[:12]}.py"
            copies.append(CopiedPlugin(tuple(plugin.place.split(".")), plugin.tag, f"{new}:{attribute}", new, content))
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
    content = reading.read_bytes(found.path)
    new = f"{found.path.stem}-{hashlib.sha256(content).hexdigest()[:12]}.py"
    return (CopiedPlugin(("simulator",), "function", f"{new}:{found.name}", new, content),)


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
