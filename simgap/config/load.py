"""From a YAML file to a checked `Case`; every mistake becomes one line with file, key and remedy."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from simgap.config.case import Case
from simgap.config.load_yaml import read_yaml
from simgap.config.plugged import INNER
from simgap.errors import UserError, excerpt


def load_case(path: Path | str) -> Case:
    """Read a case file.

    Raises:
        UserError: missing file, broken YAML, unknown, missing or wrong key.
    """
    path = Path(path)
    return parse_case(case_content(path), path)


def case_content(path: Path, above: tuple[Path, ...] = ()) -> Any:
    """The plain content of a case file; with `extends`, on top of the case that it names.

    Keys that are given are laid over those of the other case (`overlay`). The other case stands in the same folder, so
    that its relative paths hold.

    Raises:
        UserError: missing file, broken YAML, a base that is no case of the same folder or that leads back here.
    """
    content = read_yaml(path)
    if not isinstance(content, dict) or "extends" not in content:
        return content
    name = content.pop("extends")
    if not isinstance(name, str) or Path(name).name != name:
        raise UserError(
            f"{excerpt(repr(name))} is no case file of this folder",
            file=path,
            key="extends",
            remedy="Give its file name, such as pendulum.yaml.",
        )
    base, above = path.parent / name, (*above, path)
    if base in above:
        raise UserError("a case cannot extend itself", file=path, key="extends")
    inherited = case_content(base, above)
    parse_case(inherited, base)  # a mistake in it is told with its own file
    return overlay(inherited, content)


TAGS = ("engine", "kind")
"""Keys that say which keys stand beside them."""
INSTEAD = ({"values"}, {"min", "max", "step"})
"""Keys of which one group stands instead of the other."""


def overlay(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Keys of `above` on those of `below`: sections are merged key by key, a list or a number is replaced, `null`
    leaves a key out. A section of another engine or kind, an empty one, and a range instead of values (or the other way
    round) replace the whole section."""
    merged = dict(below)
    for key, value in above.items():
        under = below.get(key)
        if isinstance(value, dict) and isinstance(under, dict) and not _of_another_kind(under, value):
            merged[key] = overlay(under, value)
        else:
            merged[key] = value
    return {key: value for key, value in merged.items() if value is not None}


def _of_another_kind(under: dict[str, Any], value: dict[str, Any]) -> bool:
    other = any(own & value.keys() and rest & under.keys() for own, rest in (INSTEAD, INSTEAD[::-1]))
    return not value or other or any(tag in value and value[tag] != under.get(tag) for tag in TAGS)


def parse_case(content: Any, path: Path, plugins_beside: Path | None = None) -> Case:
    """Check the content of a case file; plug-in files stand beside `path`, or beside `plugins_beside`."""
    if not isinstance(content, dict):
        raise UserError(
            "this is no case: it holds no keys", file=path,
            remedy="A case starts with `name:` and `plant:`; `simgap new NAME --urdf FILE` writes one.",
        )  # fmt: skip
    try:
        return Case.model_validate(content, context={"folder": (plugins_beside or path).parent})
    except ValidationError as error:
        found = [mistake for e in error.errors(include_url=False) for mistake in _unfolded(e)]
        first = next((m for m in found if m.error["type"] == "extra_forbidden"), found[0])  # a typo leaves a gap
        raise _user_error(first, len(found), path) from None


@dataclass(frozen=True)
class _Mistake:
    """A validator's error, where it stands below `model`, and the keys that lead to that model."""

    error: Any
    model: type[BaseModel] = Case
    above: tuple[Any, ...] = ()


def _unfolded(error: Any) -> list[_Mistake]:
    """The errors inside the section of a plug-in, instead of the one that stands for them."""
    if error["type"] != INNER:
        return [_Mistake(error)]
    return [_Mistake(e, error["ctx"]["model"], error["loc"]) for e in error["ctx"]["errors"]]


def _user_error(mistake: _Mistake, count: int, path: Path) -> UserError:
    first = mistake.error
    key = ".".join(str(part) for part in (*mistake.above, *first["loc"])) or None
    kind, problem, remedy = first["type"], str(first["msg"]), None
    if kind == "extra_forbidden":
        problem, remedy = "unknown key", _suggestion(mistake.model, first["loc"])
    elif kind == "missing":
        problem, remedy = "this key is missing", "Add it."
    elif kind == "value_error":
        problem = problem.removeprefix("Value error, ")
    elif key == "name" and kind == "string_pattern_mismatch":
        problem = f"{excerpt(repr(first['input']))} is no name of a case: results are kept in a folder of that name"
        remedy = "Use lower-case letters a to z, digits, - and _, beginning with a letter; `title` may hold anything."
    else:
        problem, remedy = problem_and_remedy(first)
    if count > 1:
        remedy = f"{remedy or ''} ({count - 1} more after this one)".strip()
    return UserError(problem, file=path, key=key, remedy=remedy)


def _suggestion(top: type[BaseModel], loc: tuple[Any, ...]) -> str:
    """The nearest key that is known at this place below a model."""
    model: Any = top
    for part in loc[:-1]:
        model = _inside(model, part)
        if model is None:
            return "Remove it."
    known = [*model.model_fields, *(["extends"] if model is Case else [])]
    near = difflib.get_close_matches(str(loc[-1]), known, n=1)
    return f"Did you mean '{near[0]}'?" if near else f"Known: {', '.join(known)}."


def _inside(model: Any, part: Any) -> Any:
    from typing import get_args

    if not (isinstance(model, type) and issubclass(model, BaseModel)):
        return None
    field = model.model_fields.get(str(part))
    if field is None:
        return model  # the name of a state, an index or a union's tag: the loc says it, the model stays
    todo = [field.annotation]
    while todo:
        kind = todo.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
        todo.extend(get_args(kind))
    return None


_WANTED: Mapping[str, tuple[str, str]] = {
    "string": ("a text is needed", "Write a word or a text, in quotes if it looks like a number."),
    "float": ("a number is needed", "Write a number such as 0.5."),
    "int": ("a whole number is needed", "Write a number without a fraction."),
    "bool": ("true or false is needed", "Write one of them."),
    "list": ("a list is needed", "Write [a, b, ...]."),
    "tuple": ("a list is needed", "Write [a, b, ...]."),
    "dict": ("keys with values are needed", "Write one `name: value` a line below it."),
    "model": ("keys with values are needed", "Write one `key: value` a line below it."),
    "finite": ("a finite number is needed", "Write a number that is neither infinite nor nan."),
}
_LIMITS = {
    "greater_than": ("above", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("below", "lt"),
    "less_than_equal": ("at most", "le"),
}


def problem_and_remedy(error: Mapping[str, Any]) -> tuple[str, str | None]:
    """Problem and remedy of an error of pydantic; its own words only for what no case file of today can ask."""
    kind, context, got = str(error["type"]), error.get("ctx") or {}, excerpt(repr(error["input"]))
    if kind in _LIMITS:
        limit = f"{_LIMITS[kind][0]} {context[_LIMITS[kind][1]]:g}"
        return f"the number must be {limit}, not {got}", f"Give one that is {limit}."
    if kind == "literal_error":
        return _choice(str(context["expected"]), error["input"], got)
    if kind in ("too_short", "too_long"):
        word, count = ("at least", "min_length") if kind == "too_short" else ("at most", "max_length")
        return f"{word} {context[count]} entries are needed, got {context['actual_length']}", "Complete or shorten it."
    wanted = _WANTED.get(kind.partition("_")[0])
    if wanted is not None and kind.rpartition("_")[2] in ("type", "parsing", "float", "number"):
        return f"{wanted[0]}, got {got}", wanted[1]
    return f"{error['msg']}, got {got}", None


def _choice(expected: str, given: Any, got: str) -> tuple[str, str]:
    known = [word.strip().strip("'") for part in expected.split(" or ") for word in part.split(",")]
    near = difflib.get_close_matches(str(given), known, n=1)
    return f"no choice is called {got}", f"Did you mean '{near[0]}'?" if near else f"Known: {', '.join(known)}."
