"""Pages of docs/reference that are generated from what simgap itself reads: keys of a case, effects, faults."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from simgap.config.case import schema_text
from simgap.diagnosis.record.faults.registry import FAULTS
from simgap.effects import EFFECTS
from simgap.notation import axis_label

_WRITTEN = "Written by `simgap reference`; do not edit."
_KEYS = f"""# Keys of a case: {{}}

{_WRITTEN} `<name>` stands for a name of yours, `[]` for each entry of a list. {{}}
"""
_TABLE = """
## {}

| key | value | default | meaning |
|---|---|---|---|
"""
_PAGES = {
    "keys_system.md": ("plant and simulator", "What is done with them: [stages and recordings](keys_stages.md)."),
    "keys_stages.md": ("stages and recordings", "What they are applied to: [plant and simulator](keys_system.md)."),
}
_STAGES = ("grid", "gap", "synthesis", "validation", "audit", "budget", "measured")
"""Sections that say what is done with a plant and a simulator; all others say what these are."""
_TWIN = (
    "| `twin.*` | as `simulator.*` | | An engine that stands for the simulator; its keys are those of `simulator`. |\n"
)
_EFFECTS = f"""# Effects

{_WRITTEN} The diagnosis searches for these effects. `plant.effects` adds them to the nominal model, and
`simulator.effects` to a simulator that can act them out. Units are those of a rotation or a translation;
*input* and *state* are the units of what the effect acts on. `simgap effects CASE.yaml` prints those of a case.

The column *tried* says when the search takes an effect up: *first*; *second*, where the first leave more than noise, or
in place of an effect that was found and that it resembles; *last*, after all others. *Motion* is what makes it visible.

| effect | on | formula | parameters | tried | motion | source |
|---|---|---|---|---|---|---|
"""
_FAULTS = f"""# Recording faults

{_WRITTEN} Faults of the logging chain are reported apart from effects of the plant. Each is an entry of `recording`
in `diagnosis.json`, with its channel, a number, a sentence and the remedy. It has a row on the page and a clause in
the verdict's sentence. No fault enters the corrected case. If faults alone explain the data down to the noise, the
verdict is `none`.

| fault | meaning | how it is detected |
|---|---|---|
{{rows}}

## Coloured noise

Where the best answer leaves more than white noise, two spectra compete for what is left: noise with autocorrelation
exp(-t / tau), and the spectrum of a force, which falls with the fourth power of the frequency. Noise is named if it
is likelier by e^12, windows agree on its size, the residual does not follow the input (Ljung-Box test) and chi^2/dof
is at most 10. Residuals are then whitened and the search runs again. BIC, chi^2/dof, RMSE/sigma and intervals count
independent samples from there on.

## A plant that changed

The scores of the windows show from which time on another parameter value would fit best. If such a change promises
most of what is left, and no slow drift does as well, both sides are diagnosed separately. The fault is reported if
motion and commands are of similar size on both sides, both sides reach their noise, and a parameter's intervals do
not overlap. The answer describes the longer side.

## What a recording cannot tell

- With a linear plant and one sensor, a slow sensor looks like a slow input, and a sensor gain like an input gain.
  simgap names the input and lists the sensor as its equal.
- A sign error of the input looks like one of the only reading: the input is named. Of a unit error the column in
  smaller units (millimetres, degrees, thousandths) is named. The sentence lists the alternative.
- Where strong friction hides a unit error from the declared model, each unit is tried with friction, biases and
  gains.

Measured detection rates: [recording faults](../evidence/recording_faults.md).
"""
_DEEPEST = 8  # sections inside sections; none is inside itself


def reference() -> dict[str, str]:
    """The text of each page by its name in docs/reference."""
    schema = json.loads(schema_text())
    sections: dict[str, str] = {}
    for key, kind, default, what in _keys(schema, schema["$defs"], ""):
        name = key.split(".")[0]
        row = f"| `{key}` | {_cell(kind)} | {_cell(default)} | {_cell(what)} |\n"
        sections[name] = sections.get(name, "") + (row if name != "twin" or key == name else "")
    sections["twin"] += _TWIN
    pages = {name: _KEYS.format(*words) for name, words in _PAGES.items()}
    for name, rows in sections.items():
        pages["keys_stages.md" if name in _STAGES else "keys_system.md"] += _TABLE.format(f"`{name}`") + rows
    rows = ""
    for name, effect in EFFECTS.items():
        symbols = [f"`{p.symbol}` {axis_label(p.description, {p.description: p.unit})}" for p in effect.parameters]
        numbers = "; ".join(symbols if not effect.one_curve or len(symbols) < 4 else [symbols[0], "...", symbols[-1]])
        tried = "last" if effect.last else "second" if effect.second else "first"
        if effect.resembles:
            tried += "; in place of " + ", ".join(f"`{other}`" for other in effect.resembles)
        cells = (
            effect.kind,
            f"`{_cell(effect.formula)}`",
            _cell(numbers),
            tried,
            effect.excitation,
            _cell(effect.source),
        )
        rows += f"| `{name}` | {' | '.join(cells)} |\n"
    faults = "".join(f"| `{f.name}` | {' | '.join(f.said())} |\n" for f in FAULTS.values())
    return pages | {"effects.md": _EFFECTS + rows, "recording_faults.md": _FAULTS.format(rows=faults.rstrip())}


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
    """Kind of a value, in a word or two."""
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
