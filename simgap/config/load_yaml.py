"""Plain content from a YAML file that may come from a stranger: no key twice, no bombs, one line for each mistake.

Scalars follow YAML 1.2: `true` and `false` are the only booleans (`on` is a key of an effect, `y` may be a state),
`010` is ten, `1e-3` is a number, and nothing is a date.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml
from yaml.constructor import ConstructorError
from yaml.parser import ParserError
from yaml.scanner import ScannerError

from simgap import reading
from simgap.errors import UserError, excerpt

LARGEST = 1_000_000
"""Bytes of a YAML file."""
DEEPEST = 64
"""Levels of lists and mappings within each other."""
MOST_NODES = 200_000
"""Values of a file once its aliases are written out."""
_BOOL, _INT, _FLOAT, _NULL, _MERGE = (f"tag:yaml.org,2002:{kind}" for kind in ("bool", "int", "float", "null", "merge"))


class _Loader(yaml.SafeLoader):
    def fetch_more_tokens(self) -> None:
        if self.flow_level + len(self.indents) > DEEPEST:  # before the scanner grows slow and the composer recurses
            mark = self.get_mark()
            raise ScannerError(None, None, f"more than {DEEPEST} levels within each other", mark)
        super().fetch_more_tokens()

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
        remedy = "Look at that line and at the one above it: a colon, a quote or the indentation."
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
            told = f"the key {excerpt(repr(key.value))}" if isinstance(key, yaml.ScalarNode) else "a list or mapping"
            problem = f"{told} is no name; names that look like numbers need quotes"
            raise ConstructorError(None, None, problem, key.start_mark)
        if key.value in lines:
            first = lines[key.value]
            problem = f"the key {excerpt(repr(key.value))} stands there twice, first in line {first}"
            raise ConstructorError(None, None, problem, key.start_mark)
        lines[key.value] = line
