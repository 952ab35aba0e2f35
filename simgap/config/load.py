"""From a YAML file, of a stranger perhaps, to a checked `Case`; every mistake becomes a line with file, key and remedy.

Scalars follow YAML 1.2: `true` and `false` are the only booleans (`on` is a key of an effect, `y` may be a state),
`010` is ten, `1e-3` is a number, and nothing is a date.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError
from yaml.constructor import ConstructorError
from yaml.parser import ParserError
from yaml.scanner import ScannerError

from simgap import reading
from simgap.config.case import Case
from simgap.config.plugged import INNER
from simgap.errors import UserError, excerpt, nearest

M = TypeVar("M", bound=BaseModel)
LARGEST = 1_000_000
"""Bytes of a YAML file."""
DEEPEST = 64
"""Levels of lists and mappings within each other."""
MOST_NODES = 200_000
"""Values of a file once its aliases are written out."""
_BOOL, _INT, _FLOAT, _NULL, _MERGE = (f"tag:yaml.org,2002:{kind}" for kind in ("bool", "int", "float", "null", "merge"))


_QUOTE = "A comma ends an entry within [ ] and { }: put a text that has one in quotes, as in 'atan2(a, b)'."


class _Loader(yaml.SafeLoader):
    def fetch_more_tokens(self) -> None:
        if self.flow_level + len(self.indents) > DEEPEST:  # before the scanner grows slow and the composer recurses
            mark = self.get_mark()
            raise ScannerError(None, None, f"more than {DEEPEST} levels within each other", mark)
        super().fetch_more_tokens()

    def scan_plain(self) -> Any:
        token = super().scan_plain()
        if self.peek() == "," and token.value.count("(") > token.value.count(")"):
            raise ScannerError(None, None, f"{excerpt(repr(token.value))} is cut at a comma", token.start_mark, _QUOTE)
        return token

    def parse_flow_mapping_empty_value(self) -> Any:
        mark: Any = self.peek_token().start_mark  # type: ignore[no-untyped-call]
        word = re.split("[,{]", mark.buffer[: mark.pointer])[-1].strip()
        raise ParserError(None, None, f"{excerpt(repr(word))} has no value", mark, _QUOTE)

    def construct_document(self, node: yaml.Node) -> Any:
        _check_graph(node)
        return super().construct_document(node)

    def construct_yaml_int(self, node: Any) -> int:
        return int(self.construct_scalar(node))


_Loader.yaml_implicit_resolvers = {}
_Loader.add_implicit_resolver(_BOOL, re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF"))
_Loader.add_implicit_resolver(_NULL, re.compile(r"^(?:~|null|Null|NULL|)$"), ["~", "n", "N", ""])
_Loader.add_implicit_resolver(_INT, re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789"))
_Loader.add_implicit_resolver(
    _FLOAT,
    re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+0123456789."),
)
_Loader.add_implicit_resolver(_MERGE, re.compile(r"^(?:<<)$"), ["<"])
_Loader.add_constructor(_INT, _Loader.construct_yaml_int)


def read_yaml(path: Path) -> Any:
    """The plain content of a YAML file.

    Raises:
        UserError: a file that is missing, no text, no YAML, too large or too deep, or that has a key twice.
    """
    try:
        text = reading.read_bytes(path, LARGEST).decode("utf-8-sig")
        return plain_content(text)
    except FileNotFoundError:
        where = "" if path.is_absolute() else f" below {Path.cwd()}"
        raise UserError(f"the file does not exist{where}", file=path, remedy="Give the path of a case file.") from None
    except IsADirectoryError:
        raise UserError("is a folder, not a file", file=path, remedy="Give the path of a case file.") from None
    except UnicodeDecodeError:
        raise UserError("is not UTF-8 text", file=path, remedy="Give the path of a case file.") from None
    except OSError as error:
        raise UserError(f"cannot be read: {excerpt(error.strerror)}", file=path) from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}" if mark else None
        problem = excerpt(getattr(error, "problem", None) or error)
        general = "Look at that line and at the one above it: a colon, a quote or the indentation."
        remedy = getattr(error, "note", None) or general
        tabs = [k for k, own in enumerate(text.splitlines(), 1) if "\t" in own[: len(own) - len(own.lstrip())]]
        if tabs and isinstance(error, ScannerError | ParserError):
            line, problem, remedy = f"line {tabs[0]}", "a tab in the indentation", "Indent with spaces."
        raise UserError(f"not valid YAML: {problem}", file=path, key=line, remedy=remedy) from None
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise UserError(f"not valid YAML: {excerpt(error)}", file=path) from None


def plain_content(text: str) -> Any:
    """Plain content of a YAML text, by the rules above.

    Raises:
        yaml.YAMLError: a text that is none, or has a key twice.
    """
    return yaml.load(text, Loader=_Loader)


def _check_graph(top: yaml.Node) -> None:
    """Refuse a key that stands twice, a key that is no text, an alias inside itself, and aliases that multiply."""
    sizes: dict[int, int] = {}
    open_nodes: set[int] = set()

    def size(node: yaml.Node) -> int:
        if id(node) in open_nodes:
            raise ConstructorError(None, None, "an alias within itself", node.start_mark)
        if id(node) not in sizes:
            open_nodes.add(id(node))
            if isinstance(node, yaml.MappingNode):
                _check_keys(node)
            sizes[id(node)] = 1 + sum(size(child) for child in _children(node))
            open_nodes.remove(id(node))
            if sizes[id(node)] > MOST_NODES:
                raise ConstructorError(None, None, f"more than {MOST_NODES} values, aliases included", node.start_mark)
        return sizes[id(node)]

    size(top)


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return list(node.value) if isinstance(node, yaml.SequenceNode) else []


def _check_keys(node: yaml.MappingNode) -> None:
    lines: dict[str, int] = {}
    for key, _ in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode) or key.tag in (_NULL, _BOOL, _INT, _FLOAT):
            named = f"the key {excerpt(repr(key.value))}" if isinstance(key, yaml.ScalarNode) else "a list or mapping"
            problem = f"{named} is not a name; names that look like numbers need quotes"
            raise ConstructorError(None, None, problem, key.start_mark)
        if key.value in lines:
            first = lines[key.value]
            problem = f"the key {excerpt(repr(key.value))} appears twice, first in line {first}"
            raise ConstructorError(None, None, problem, key.start_mark)
        lines[key.value] = line


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
        problem = f"{excerpt(repr(name))} is not a case file of this folder"
        raise UserError(problem, file=path, key="extends", remedy="Give its file name, such as pendulum.yaml.")
    base, above = path.parent / name, (*above, path)
    if base in above:
        raise UserError("a case cannot extend itself", file=path, key="extends")
    inherited = case_content(base, above)
    parse_case(inherited, base)  # a mistake in it is named with its own file
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
        remedy = "A case starts with `name:` and `plant:`; `simgap new NAME --urdf FILE` writes one."
        raise UserError("this is not a case: it has no keys", file=path, remedy=remedy)
    return validated(Case, content, path, (plugins_beside or path).parent)


def validated(model: type[M], content: Any, file: Path | str, folder: Path | None = None) -> M:
    """Content as a section of that model; plug-in files stand in `folder`.

    Raises:
        UserError: an unknown, missing or wrong key, the first of them.
    """
    try:
        return model.model_validate(content, context={"folder": folder})
    except ValidationError as error:
        found = [mistake for e in error.errors(include_url=False) for mistake in _unfolded(e, model)]
        found.sort(key=lambda m: m.error["type"] != "extra_forbidden")  # a typo leaves a gap
        raise _user_error(found, file) from None


@dataclass(frozen=True)
class _Mistake:
    """A validator's error, where it stands below `model`, and the keys that lead to that model."""

    error: Any
    model: type[BaseModel]
    above: tuple[Any, ...] = ()

    @property
    def key(self) -> str:
        """Where it stands in the file."""
        return ".".join(str(part) for part in (*self.above, *self.error["loc"]))


def _unfolded(error: Any, model: type[BaseModel]) -> list[_Mistake]:
    """The errors inside the section of a plug-in, instead of the one that stands for them."""
    if error["type"] != INNER:
        return [_Mistake(error, model)]
    return [_Mistake(e, error["ctx"]["model"], error["loc"]) for e in error["ctx"]["errors"]]


def _user_error(mistakes: Sequence[_Mistake], file: Path | str) -> UserError:
    """The first mistake with its remedy; the keys of the others, so that one pass mends all."""
    first, (key, *others) = mistakes[0].error, dict.fromkeys(m.key for m in mistakes)
    kind, problem, remedy = first["type"], str(first["msg"]), None
    if kind == "extra_forbidden":
        problem, remedy = "unknown key", _suggestion(mistakes[0].model, first["loc"])
    elif kind == "missing":
        problem, remedy = "this key is missing", "Add it."
    elif kind == "value_error":
        problem = problem.removeprefix("Value error, ")
    elif key == "name" and kind == "string_pattern_mismatch":
        problem = f"{excerpt(repr(first['input']))} is not a valid case name: results go to a folder of that name"
        remedy = "Use lower-case letters a to z, digits, - and _, beginning with a letter; `title` may hold anything."
    else:
        problem, remedy = _problem_and_remedy(first)
    if others:
        remedy = f"{remedy or ''} Also wrong: {excerpt(', '.join(others), 400)}.".strip()
    return UserError(problem, file=file, key=key or None, remedy=remedy)


def _suggestion(top: type[BaseModel], loc: tuple[Any, ...]) -> str:
    """The nearest key that is known at this place below a model."""
    model: Any = top
    for part in loc[:-1]:
        model = _inside(model, part)
        if model is None:
            return "Remove it."
    return nearest(str(loc[-1]), [*model.model_fields, *(["extends"] if model is Case else [])])


def _inside(model: Any, part: Any) -> Any:
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


def _problem_and_remedy(error: Mapping[str, Any]) -> tuple[str, str | None]:
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
    return f"there is no choice {got}", nearest(str(given), known)
