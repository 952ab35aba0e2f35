"""What a validator says, in the words of a person who writes case files: `(error) -> problem, remedy`."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

from simgap.errors import excerpt

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


def told(error: Mapping[str, Any]) -> tuple[str, str | None]:
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
