"""What made a result: the sections that its stage read, the code that computed it, the engines, the seeds."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from simgap.config.case import Case
from simgap.stages.reads import READS

PACKAGE = Path(__file__).parent
# What the typing of a case file does shows in the sections that are hashed; its code would invalidate everything.
UNHASHED = ("simgap.config.case", "simgap.config.load", "simgap.provenance")


def digest(content: Any) -> str:
    """A short hash of plain content."""
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def sections_digest(case: Case, sections: Iterable[str], folder: Path) -> str:
    """A hash of what a stage reads: sections by dotted name ('plant.states'), model files by their bytes.

    Of 'gap.padding=inflate' no more is read than whether the key has the value.
    """
    content: dict[str, Any] = {}
    for name in sections:
        section, _, asked = name.partition("=")
        value: Any = case.model_dump(mode="json")
        for part in section.split("."):
            value = value.get(part) if isinstance(value, dict) else None
        content[name] = value == asked if asked else value
        urdf = value.get("urdf") if isinstance(value, dict) else value if section.endswith("urdf") else None
        if urdf and (folder / urdf).is_file():
            content[f"{section}: bytes"] = file_digest(folder / urdf)
    return digest(content)


def file_digest(path: Path) -> str:
    """A short hash of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def code_digest(module: str) -> str:
    """A hash of a module of this package and all that it imports from the package, however late."""
    return digest({str(p.relative_to(PACKAGE)): file_digest(p) for p in sorted(_closure(module))})


@lru_cache(maxsize=64)
def _closure(module: str) -> frozenset[Path]:
    seen: set[Path] = set()
    todo = [module]
    while todo:
        name = todo.pop()
        path = _file(name)
        if path is None or path in seen or name.startswith(UNHASHED):
            continue
        seen.add(path)
        todo.extend(_imports(path))
    return frozenset(seen)


def _imports(path: Path) -> list[str]:
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [a.name for a in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
            names += [f"{node.module}.{a.name}" for a in node.names]
    return [n for n in names if n.split(".")[0] == "simgap"]


def _file(module: str) -> Path | None:
    base = PACKAGE.joinpath(*module.split(".")[1:])
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file() and path != PACKAGE / "__init__.py":
            return path
    return None


def versions(*distributions: str) -> dict[str, str]:
    """Versions of installed distributions."""
    return {name: metadata.version(name) for name in distributions}


def provenance(
    stage: str, case: Case, folder: Path, seeds: Mapping[str, int] | None = None, **more: Any
) -> dict[str, Any]:
    """The record that every result carries; it holds no absolute path and no date, so equal runs are equal bytes."""
    sections = list(READS[stage])
    return {
        "stage": stage,
        "case": case.name,
        "reads": {"sections": sections, "sha256": sections_digest(case, sections, folder)},
        "code": code_digest(f"simgap.stages.{stage}"),
        "versions": versions("simgap", "drake", "pybullet", "numpy", "numba", "clarabel"),
        "seeds": dict(seeds or {}),
        **more,
    }
