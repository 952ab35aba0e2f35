"""Pages of docs/reference that are generated from what simgap itself reads: keys of a case, effects, faults."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from simgap.config.case import schema_text
from simgap.diagnosis.record.faults.registry import FAULTS
from simgap.effects import EFFECTS, Effect
from simgap.io.pages import text
from simgap.notation import axis_label

_PAGES = {
    "keys_system.md": ("plant and simulator", "What is done with them: [stages and recordings](keys_stages.md)."),
    "keys_stages.md": ("stages and recordings", "What they are applied to: [plant and simulator](keys_system.md)."),
}
_STAGES = ("grid", "gap", "synthesis", "validation", "audit", "budget", "measured")
"""Sections that say what is done with a plant and a simulator; all others say what these are."""
_DEEPEST = 8  # sections inside sections; none is inside itself


def reference() -> dict[str, str]:
    """The text of each page by its name in docs/reference."""
    schema = json.loads(schema_text())
    sections: dict[str, list[list[str]]] = {}
    for key, *cells in _keys(schema, schema["$defs"], ""):
        name = key.split(".")[0]
        if name != "twin" or key == name:  # its keys are those of `simulator`
            sections.setdefault(name, []).append([f"`{key}`", *map(_cell, cells)])
    pages = {}
    for page, (title, about) in _PAGES.items():
        own = {name: rows for name, rows in sections.items() if (name in _STAGES) == (page == "keys_stages.md")}
        pages[page] = text("keys.md.j2", title=title, about=about, sections=own)
    pages["effects.md"] = text("effects.md.j2", rows=[_effect(name, effect) for name, effect in EFFECTS.items()])
    faults = [[f"`{f.name}`", *f.said()] for f in FAULTS.values()]
    return pages | {"recording_faults.md": text("recording_faults.md.j2", rows=faults)}


def _effect(name: str, effect: Effect) -> list[str]:
    symbols = [f"`{p.symbol}` {axis_label(p.description, {p.description: p.unit})}" for p in effect.parameters]
    numbers = "; ".join(symbols if not effect.one_curve or len(symbols) < 4 else [symbols[0], "...", symbols[-1]])
    tried = "last" if effect.last else "second" if effect.second else "first"
    if effect.resembles:
        tried += "; in place of " + ", ".join(f"`{other}`" for other in effect.resembles)
    formula = f"`{_cell(effect.formula)}`"
    return [f"`{name}`", effect.kind, formula, _cell(numbers), tried, effect.excitation, _cell(effect.source)]


def _keys(schema: Mapping[str, Any], defs: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str, str, str]]:
    """Dotted key, value, default and description of everything below a section."""
    for name, own in schema.get("properties", {}).items():
        key = f"{prefix}{name}"
        kinds = list(_kinds(own, defs))
        default = "" if own.get("default") is None else json.dumps(own["default"])
        words = own.get("description") or next((k["description"] for k, _ in kinds if "description" in k), "")
        yield key, " or ".join(dict.fromkeys(filter(None, (_words(k) for k, _ in kinds)))), default, words
        if key.count(".") < _DEEPEST:
            listed: dict[str, set[tuple[str, ...]]] = {}
            for kind, step in kinds:
                engine = kind.get("properties", {}).get("engine", {}).get("const", "")
                for row in _keys(kind, defs, f"{key}{step}."):
                    before = listed.setdefault(row[0], set())
                    if not before:
                        yield row
                    elif engine and row not in before and row[0] != f"{key}.engine":
                        yield *row[:3], f"`{engine}`: {row[3]}"
                    before.add(row)


def _kinds(
    schema: Mapping[str, Any], defs: Mapping[str, Any], step: str = ""
) -> Iterator[tuple[Mapping[str, Any], str]]:
    """Every kind of value that a key may have, with what leads from the key to it (`[]`, `.<name>`)."""
    if "$ref" in schema:
        yield from _kinds(defs[schema["$ref"].rsplit("/", 1)[-1]], defs, step)
        return
    choices = [*schema.get("anyOf", ()), *schema.get("oneOf", ())]
    for choice in choices:
        yield from _kinds(choice, defs, step)
    if choices:
        return
    yield schema, step
    if isinstance(schema.get("items"), Mapping):
        yield from ((k, s) for k, s in _kinds(schema["items"], defs, f"{step}[]") if "properties" in k)
    if isinstance(schema.get("additionalProperties"), Mapping):
        inner = _kinds(schema["additionalProperties"], defs, f"{step}.<name>")
        yield from ((k, s) for k, s in inner if "properties" in k)


def _words(schema: Mapping[str, Any]) -> str:
    """Kind of a value, in a word or two."""
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    limits = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
    said = " ".join(f"{sign} {schema[name]:.10g}" for name, sign in limits.items() if name in schema)
    names = {"object": "section", "array": "list", "string": "text", "boolean": "true or false", "null": ""}
    kind = str(schema.get("type", ""))
    return f"{names.get(kind, kind)} {said}".strip()


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())
