"""docs/reference.md: every key of a case file and every effect, generated from what simgap itself reads."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from simgap.config.schema import schema_text
from simgap.effects import EFFECTS
from simgap.notation import axis_label

_HEAD = """# Reference

Written by `simgap reference`; do not edit. `<name>` stands for a name of yours, `[]` for each entry of a list.

## Keys of a case

| key | value | default | what it is |
|---|---|---|---|
"""
_EFFECTS = """
## Effects

What a diagnosis looks for, `plant.effects` adds to the nominal model, and `simulator.effects` to the simulator where it
can act them out. In a unit, force and position are those of the coordinate
(N m and rad, or N and m), input and state those of what the effect acts on.

| effect | on | formula | parameters | source |
|---|---|---|---|---|
"""
_DEEPEST = 8  # sections inside sections; none is inside itself


def reference() -> str:
    """The text of docs/reference.md."""
    schema = json.loads(schema_text())
    keys = "".join(f"| `{key}` | {_cell(kind)} | {_cell(default)} | {_cell(what)} |\n" for key, kind, default, what in
                   _keys(schema, schema["$defs"], ""))  # fmt: skip
    rows = ""
    for name, kind in EFFECTS.items():
        numbers = "; ".join(
            f"`{p.symbol}` {axis_label(p.description, {p.description: p.unit})}" for p in kind.parameters
        )
        rows += f"| `{name}` | {kind.kind} | `{_cell(kind.formula)}` | {_cell(numbers)} | {_cell(kind.source)} |\n"
    return _HEAD + keys + _EFFECTS + rows


def _keys(schema: Mapping[str, Any], defs: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str, str, str]]:
    """Dotted key, value, default and description of everything below a section."""
    for name, own in schema.get("properties", {}).items():
        key = f"{prefix}{name}"
        kinds = list(_kinds(own, defs))
        default = "" if own.get("default") is None else json.dumps(own["default"])
        words = own.get("description") or next((k["description"] for k, _ in kinds if "description" in k), "")
        yield key, " or ".join(dict.fromkeys(filter(None, (_words(k) for k, _ in kinds)))), default, words
        if key.count(".") < _DEEPEST:
            seen: set[str] = set()
            for kind, step in kinds:
                for row in _keys(kind, defs, f"{key}{step}."):
                    if row[0] not in seen:
                        seen.add(row[0])
                        yield row


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
    """What a value is, in a word or two."""
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    limits = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
    said = " ".join(f"{sign} {schema[name]:g}" for name, sign in limits.items() if name in schema)
    names = {"object": "section", "array": "list", "string": "text", "boolean": "true or false", "null": ""}
    kind = str(schema.get("type", ""))
    return f"{names.get(kind, kind)} {said}".strip()


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())
