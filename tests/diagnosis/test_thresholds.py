"""Numbers that decide are few, said to be so, and in one place."""

import ast
from pathlib import Path

ROOM = Path(__file__).parents[2] / "simgap" / "diagnosis"


def numbers(path: Path) -> list[tuple[str, bool]]:
    """Names that a module gives numbers of its own, and whether a text or a comment stands beside each."""
    text = path.read_text()
    body, lines = ast.parse(text).body, text.splitlines()
    found = []
    for k, node in enumerate(body):
        if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Name):
            continue
        own = node.value.operand if isinstance(node.value, ast.UnaryOp) else node.value
        if isinstance(own, ast.Constant) and isinstance(own.value, int | float) and not isinstance(own.value, bool):
            after = body[k + 1] if k + 1 < len(body) else None
            said = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            found.append((node.targets[0].id, said or "#" in lines[node.lineno - 1]))
    return found


def test_at_most_thirty_numbers_decide_and_each_says_why():
    found = numbers(ROOM / "thresholds.py")
    assert len(found) <= 30
    assert all(said for _, said in found)
