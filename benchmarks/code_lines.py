"""Lines of code and files of each room of simgap, core and extras: no blank lines, comments or docstrings."""

from __future__ import annotations

import ast
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "simgap"
EXTRAS = "extras"
SILENT = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
    tokenize.ENCODING,
)


def code_lines(path: Path) -> int:
    """Number of lines of a file that hold a token of code; a string that stands alone is a docstring."""
    with tokenize.open(path) as file:
        text = file.read()
    lines = set[int]()
    for token in tokenize.generate_tokens(iter(text.splitlines(keepends=True)).__next__):
        if token.type not in SILENT:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - set(_docstring_lines(ast.parse(text))))


def _docstring_lines(tree: ast.Module) -> Iterator[int]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)


def room(path: Path) -> str:
    """Folder below the package, `extras/<folder>` for an optional one, or the name of a file that stands alone."""
    parts = path.relative_to(PACKAGE).parts
    return "/".join(parts[: 2 if parts[0] == EXTRAS else 1]) if len(parts) > 1 else "(top level)"


def main(rooms: list[str]) -> None:
    """Print a table of all rooms, or of the files of those that are named."""
    table = defaultdict[str, list[int]](lambda: [0, 0])
    for path in sorted(PACKAGE.rglob("*.py")):
        name = room(path)
        if rooms and name not in rooms:
            continue
        entry = table[str(path.relative_to(PACKAGE)) if rooms else name]
        entry[0] += code_lines(path)
        entry[1] += 1
    for name, (lines, files) in sorted(table.items()):
        print(f"{name:45} {lines:7,} {files:5}")
    for title, extras in (("core", (False,)), ("extras", (True,)), ("all", (False, True))):
        kept = [entry for name, entry in table.items() if name.startswith(EXTRAS) in extras]
        print(f"{title:45} {sum(e[0] for e in kept):7,} {sum(e[1] for e in kept):5}")


if __name__ == "__main__":
    main(sys.argv[1:])
