"""Pages that are made when the site is built: from README, notebook, and the messages and names of the package."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ERRORS = ("UserError", "BrokenPromise")
MESSAGES = """# Messages

Every mistake is one line: `file: key: what is wrong. What to do.`, exit status 2. A promise that does not hold is
status 1. These are all of them, by the room of the package that says them; `…` stands for what depends on the case. The
list is read from the sources.

"""
COMMANDS = """# Commands

`simgap COMMAND --help` prints the same. A stage of the workflow is a command too; `simgap run` calls them in order.

"""


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made here."""
    from mkdocs.structure.files import File

    made = {
        "index.md": from_root("README.md"),
        "contributing.md": from_root("CONTRIBUTING.md"),
        "changelog.md": from_root("CHANGELOG.md"),
        "tutorials/notebook.md": notebook(ROOT / "docs/tutorials/notebook.ipynb"),
        "reference/commands.md": commands(),
        "reference/messages.md": messages(ROOT / "simgap"),
    }
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_content(html: str, **_: Any) -> str:
    """Cells whose bars in code carry no backslash, which Markdown needs there and the site would show."""
    return re.sub(r"<td.*?</td>", lambda cell: cell[0].replace(r"\|", "|"), html, flags=re.DOTALL)


def on_post_page(output: str, **_: Any) -> str:
    """The page with a name for the theme's search, which has none for who cannot see it."""
    return output.replace('role="dialog">', 'role="dialog" aria-label="Search">')


def from_root(name: str) -> str:
    """A page that stands beside docs/, its links as they are inside."""
    text = (ROOT / name).read_text()
    text = text.replace("notebook.ipynb)", "notebook.md)")
    for outside, inside in (("docs/", ""), ("CHANGELOG.md", "changelog.md"), ("CONTRIBUTING.md", "contributing.md")):
        text = text.replace(f"]({outside}", f"]({inside}")
    return text


def notebook(path: Path) -> str:
    """The cells of a notebook: prose as it is, code in fences."""
    cells = json.loads(path.read_text())["cells"]
    parts = []
    for cell in cells:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    return "\n\n".join(parts) + "\n"


def messages(package: Path) -> str:
    """Every message that the package can end with, as tables by room."""
    rooms: dict[str, list[tuple[str, str, str]]] = {}
    for path in sorted(package.rglob("*.py")):
        room = path.relative_to(package).parts[0].removesuffix(".py")
        rooms.setdefault(room, []).extend(raised(ast.parse(path.read_text())))
    text = MESSAGES
    for room, rows in rooms.items():
        if rows:
            lines = "".join(f"| {what} | {key} | {remedy} |\n" for what, key, remedy in sorted(set(rows)))
            text += f"## {room}\n\n| what is wrong | key | what to do |\n|---|---|---|\n{lines}\n"
    return text


def raised(tree: ast.AST) -> Iterator[tuple[str, str, str]]:
    """Problem, key and remedy of each error that a module makes with words of its own."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or getattr(node.func, "id", "") not in ERRORS or not node.args:
            continue
        given = {word.arg: words(word.value) for word in node.keywords}
        problem = words(node.args[0])
        remedy = given.get("remedy") or (words(node.args[1]) if len(node.args) > 1 else "")
        if problem.strip("… "):
            yield problem, f"`{given['key']}`" if given.get("key", "").strip("… ") else "", remedy


def words(node: ast.expr) -> str:
    """The text of an expression as far as it is written out, `…` for the rest."""
    if isinstance(node, ast.Constant):
        text = "" if node.value is None else str(node.value)
    elif isinstance(node, ast.JoinedStr):
        text = "".join(words(part) for part in node.values)
    elif isinstance(node, ast.BinOp):
        text = words(node.left) + words(node.right)
    else:
        text = "…"
    return " ".join(text.replace("|", "\\|").replace("<", "&lt;").replace("[", "\\[").split(" "))


def commands() -> str:
    """Every subcommand with its arguments and options, as `--help` says them."""
    import typer

    from simgap.cli import app

    text = COMMANDS
    group = typer.main.get_command(app)
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        rows = "".join(
            f"| `{' '.join(p.opts) if p.param_type_name == 'option' else (p.name or '').upper()}` | "
            f"{words(ast.Constant(getattr(p, 'help', None) or ''))} |\n"
            for p in command.params
            if "--help" not in p.opts
        )
        text += f"## simgap {name}\n\n{command.help}\n\n" + (
            f"| argument | meaning |\n|---|---|\n{rows}\n" if rows else ""
        )
    return text
